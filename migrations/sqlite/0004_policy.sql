CREATE TABLE policy (
    seq        INTEGER PRIMARY KEY,
    id         TEXT NOT NULL UNIQUE CHECK (id GLOB 'p-*'),
    kind       TEXT NOT NULL,
    training   TEXT REFERENCES job (id),
    manifest   TEXT NOT NULL CHECK (json_valid(manifest)),
    bytes      BLOB NOT NULL CHECK (length(bytes) BETWEEN 1 AND 16777216),
    sha256     TEXT NOT NULL CHECK (length(sha256) = 64),
    created_at INTEGER NOT NULL CHECK (created_at >= 0)
) STRICT;

-- Without the bytes, which are read only to be sent or used.
CREATE VIEW policy_card AS
SELECT seq, id, kind, training, manifest, sha256, length(bytes) AS size_bytes, created_at FROM policy;

-- Doses of an evaluation as they come: one that was killed does not weigh them again.
CREATE TABLE dose (
    job  TEXT NOT NULL REFERENCES job (id),
    key  TEXT NOT NULL,
    body TEXT NOT NULL CHECK (json_valid(body)),
    PRIMARY KEY (job, key)
) STRICT, WITHOUT ROWID;

CREATE TABLE evaluation_row (
    evaluation TEXT NOT NULL REFERENCES job (id),
    position   INTEGER NOT NULL CHECK (position >= 0),
    -- The policy that the row is about; NULL for rows of simple controllers.
    policy     TEXT REFERENCES policy (id),
    powder     TEXT NOT NULL REFERENCES powder (id),
    n          INTEGER NOT NULL CHECK (n >= 1),
    mae_mg     REAL NOT NULL CHECK (mae_mg >= 0),
    body       TEXT NOT NULL CHECK (json_valid(body)),
    PRIMARY KEY (evaluation, position)
) STRICT, WITHOUT ROWID;

CREATE INDEX evaluation_of_policy ON evaluation_row (policy, powder) WHERE policy IS NOT NULL;
