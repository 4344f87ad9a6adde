-- What a powder was measured by beside its angle of repose. `body` is the observation: observable with its settings, mean, SD and repeats.
-- The newest row of an equal observable counts; older ones stay, as with measurements.
CREATE TABLE observation (
    seq        INTEGER PRIMARY KEY,
    id         TEXT NOT NULL UNIQUE,
    powder     TEXT NOT NULL REFERENCES powder (id),
    body       TEXT NOT NULL CHECK (json_valid(body)),
    source     TEXT NOT NULL CHECK (length(source) <= 500),
    created_at INTEGER NOT NULL CHECK (created_at >= 0)
) STRICT;

CREATE INDEX observation_of_powder ON observation (powder, seq);
