-- What people call a thing, and whether lists show it. `kind` and `id` say which; a powder's name is in its own row.
CREATE TABLE label (
    seq         INTEGER PRIMARY KEY,
    kind        TEXT NOT NULL,
    id          TEXT NOT NULL,
    name        TEXT NOT NULL CHECK (length(name) <= 100),
    note        TEXT NOT NULL CHECK (length(note) <= 4000),
    tags        TEXT NOT NULL CHECK (json_valid(tags)),
    archived_at INTEGER CHECK (archived_at >= 0),
    changed_at  INTEGER NOT NULL CHECK (changed_at >= 0),
    changed_by  TEXT,
    UNIQUE (kind, id)
) STRICT;

-- Measurements and observations that no longer count, and why; `replaced_by` is the corrected one. Their rows stay.
CREATE TABLE withdrawal (
    seq         INTEGER PRIMARY KEY,
    id          TEXT NOT NULL UNIQUE,
    reason      TEXT NOT NULL CHECK (length(reason) BETWEEN 1 AND 500),
    replaced_by TEXT UNIQUE,
    at          INTEGER NOT NULL CHECK (at >= 0),
    by          TEXT
) STRICT;

CREATE VIEW measurement_all AS
SELECT m.*, w.at AS withdrawn_at, w.by AS withdrawn_by, w.reason, w.replaced_by
FROM measurement m LEFT JOIN withdrawal w ON w.id = m.id;

CREATE VIEW observation_all AS
SELECT o.*, w.at AS withdrawn_at, w.by AS withdrawn_by, w.reason, w.replaced_by
FROM observation o LEFT JOIN withdrawal w ON w.id = o.id;

DROP VIEW powder_now;
CREATE VIEW powder_now AS
SELECT p.seq, p.id, p.name, p.created_at, p.soluble, m.repose_deg, m.sd_deg, m.n
FROM powder p LEFT JOIN measurement m ON m.seq = (
    SELECT seq FROM measurement_all WHERE powder = p.id AND withdrawn_at IS NULL
    ORDER BY method = 'automated' DESC, seq DESC LIMIT 1
);

-- What a job is about (powders, policy, angle), the job that it starts again, and where its present attempt began.
ALTER TABLE job ADD COLUMN subject TEXT CHECK (json_valid(subject));
ALTER TABLE job ADD COLUMN again_of TEXT;
ALTER TABLE job ADD COLUMN claimed_at INTEGER;
ALTER TABLE job ADD COLUMN claimed_fraction REAL;

UPDATE job SET subject = CASE kind
    WHEN 'calibration' THEN json_object(
        'powders', json((SELECT json_group_array(value) FROM json_each(json_array(spec ->> '$.calibration.powder')) WHERE value IS NOT NULL)),
        'repose_deg', spec ->> '$.calibration.target.repose_deg')
    WHEN 'training' THEN json_object(
        'powders', json((SELECT json_group_array(value ->> '$.powder') FROM json_each(spec, '$.training.levels'))))
    WHEN 'evaluation' THEN json_object(
        'powders', json((SELECT json_group_array(value ->> '$.powder') FROM json_each(spec, '$.evaluation.powders'))),
        'policy', spec ->> '$.evaluation.policy')
    WHEN 'investigation' THEN json_object(
        'powders', json((SELECT json_group_array(value) FROM json_each(spec, '$.investigation.campaign.powders'))))
    WHEN 'repose' THEN json_object('powders', json_array(spec ->> '$.repose.powder'))
END;
