-- What a powder was weighed with, where it was weighed here: display, spoon and strokes. Its shakes are read from the trace.
ALTER TABLE weighing ADD COLUMN apparatus TEXT CHECK (json_valid(apparatus));

-- Spoonfuls that were shaken elsewhere, one row each. `body` is the spoonful with its shakes in order.
CREATE TABLE spoonful (
    seq        INTEGER PRIMARY KEY,
    id         TEXT NOT NULL UNIQUE,
    powder     TEXT NOT NULL REFERENCES powder (id),
    lot        TEXT,
    body       TEXT NOT NULL CHECK (json_valid(body)),
    source     TEXT NOT NULL CHECK (length(source) <= 500),
    created_at INTEGER NOT NULL CHECK (created_at >= 0)
) STRICT;

CREATE INDEX spoonful_of_powder ON spoonful (powder, seq);

-- From when on the shakes of a powder count, or those of one of its lots: what was shaken or imported until then stays as evidence, and is not used.
CREATE TABLE forgotten (
    seq    INTEGER PRIMARY KEY,
    id     TEXT NOT NULL UNIQUE,
    powder TEXT NOT NULL REFERENCES powder (id),
    lot    TEXT,
    at     INTEGER NOT NULL CHECK (at >= 0)
) STRICT;

CREATE INDEX forgotten_of_powder ON forgotten (powder, at);
