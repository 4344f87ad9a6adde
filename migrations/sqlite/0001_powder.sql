-- Times are milliseconds since 1970-01-01 UTC. Names of states, kinds and methods are those of the API.
-- `seq` orders a table for paging; `id` is what callers see.

CREATE TABLE powder (
    seq        INTEGER PRIMARY KEY,
    id         TEXT NOT NULL UNIQUE CHECK (length(id) BETWEEN 1 AND 64),
    name       TEXT NOT NULL CHECK (length(name) BETWEEN 1 AND 100),
    created_at INTEGER NOT NULL CHECK (created_at >= 0)
) STRICT;

CREATE TABLE measurement (
    seq        INTEGER PRIMARY KEY,
    id         TEXT NOT NULL UNIQUE,
    powder     TEXT NOT NULL REFERENCES powder (id),
    method     TEXT NOT NULL CHECK (method IN ('automated', 'manual')),
    repose_deg REAL NOT NULL CHECK (repose_deg BETWEEN 5 AND 85),
    sd_deg     REAL NOT NULL CHECK (sd_deg BETWEEN 0 AND 45),
    n          INTEGER NOT NULL CHECK (n BETWEEN 1 AND 10000),
    source     TEXT NOT NULL CHECK (length(source) <= 500),
    created_at INTEGER NOT NULL CHECK (created_at >= 0)
) STRICT;

CREATE INDEX measurement_of_powder ON measurement (powder, seq);

-- A powder and the flowability to calibrate to: automated before manual, newest first.
CREATE VIEW powder_now AS
SELECT p.seq, p.id, p.name, p.created_at, m.repose_deg, m.sd_deg, m.n
FROM powder p LEFT JOIN measurement m ON m.seq = (
    SELECT seq FROM measurement WHERE powder = p.id ORDER BY method = 'automated' DESC, seq DESC LIMIT 1
);
