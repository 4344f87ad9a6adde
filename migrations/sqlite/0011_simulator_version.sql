-- Versions of the simulator that investigations made: a base, what extends it, and where that comes from. Named by what they were made from,
-- never changed.
CREATE TABLE simulator_version (
    seq           INTEGER PRIMARY KEY,
    id            TEXT NOT NULL UNIQUE CHECK (id GLOB 'sv-*'),
    base          TEXT NOT NULL,
    investigation TEXT NOT NULL REFERENCES job (id),
    body          TEXT NOT NULL CHECK (json_valid(body)),
    created_at    INTEGER NOT NULL CHECK (created_at >= 0)
) STRICT;
