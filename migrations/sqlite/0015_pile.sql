-- Jobs of a fifth kind: the angle of repose of a powder, measured by camera. A CHECK cannot be changed, so the table is made anew under its name:
-- everything but the list of kinds is as in 0010.
PRAGMA defer_foreign_keys = ON;

CREATE TABLE job_kept AS SELECT * FROM job;
DROP TABLE job;

CREATE TABLE job (
    seq              INTEGER PRIMARY KEY,
    id               TEXT NOT NULL UNIQUE,
    kind             TEXT NOT NULL CHECK (kind IN ('calibration', 'training', 'evaluation', 'investigation', 'repose')),
    spec             TEXT NOT NULL CHECK (json_valid(spec)),
    spec_sha256      BLOB NOT NULL CHECK (length(spec_sha256) = 32),
    state            TEXT NOT NULL CHECK (state IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    -- Grows by one with every claim; a writer with an older number is a zombie.
    fence            INTEGER NOT NULL DEFAULT 0 CHECK (fence >= 0),
    -- Claims in all, for people.
    attempts         INTEGER NOT NULL DEFAULT 0 CHECK (attempts >= 0),
    -- Attempts that ended in an error or a panic since something was last saved.
    failures         INTEGER NOT NULL DEFAULT 0 CHECK (failures >= 0),
    -- Attempts whose process ended since something was last saved.
    deaths           INTEGER NOT NULL DEFAULT 0 CHECK (deaths >= 0),
    owner            TEXT,
    lease_until      INTEGER,
    cancel_requested INTEGER NOT NULL DEFAULT 0 CHECK (cancel_requested IN (0, 1)),
    fraction         REAL NOT NULL DEFAULT 0 CHECK (fraction BETWEEN 0 AND 1),
    message          TEXT NOT NULL DEFAULT '',
    -- SHA-256 of the artifact to resume from.
    checkpoint       TEXT CHECK (length(checkpoint) = 64),
    result           TEXT CHECK (json_valid(result)),
    error            TEXT,
    created_at       INTEGER NOT NULL CHECK (created_at >= 0),
    started_at       INTEGER,
    finished_at      INTEGER,
    CHECK ((state = 'running') = (owner IS NOT NULL AND lease_until IS NOT NULL)),
    CHECK ((state IN ('succeeded', 'failed', 'cancelled')) = (finished_at IS NOT NULL)),
    CHECK ((state = 'succeeded') = (result IS NOT NULL))
) STRICT;

INSERT INTO job SELECT * FROM job_kept;
DROP TABLE job_kept;

-- Asking for the same thing again finds the job that does it or has done it.
CREATE UNIQUE INDEX job_by_spec ON job (spec_sha256) WHERE state NOT IN ('failed', 'cancelled');
CREATE INDEX job_by_kind ON job (kind, seq);
CREATE INDEX job_unfinished ON job (seq) WHERE state IN ('queued', 'running');

-- Piles that were photographed, measured or not.
CREATE TABLE pile (
    seq        INTEGER PRIMARY KEY,
    job        TEXT NOT NULL REFERENCES job (id),
    -- From 1 within the job.
    number     INTEGER NOT NULL CHECK (number >= 1),
    -- What the frames say of it, or why they say nothing; each frame's parts by SHA-256.
    body       TEXT NOT NULL CHECK (json_valid(body)),
    UNIQUE (job, number)
) STRICT;
