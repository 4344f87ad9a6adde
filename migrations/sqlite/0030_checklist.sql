-- Why a version of the simulator was chosen, where someone said so.
ALTER TABLE current_simulator ADD COLUMN reason TEXT;

-- What a person checks before a dose. The newest row counts; without one, the list that ships.
CREATE TABLE checklist (
    seq        INTEGER PRIMARY KEY,
    items      TEXT NOT NULL CHECK (json_valid(items)),
    changed_at INTEGER NOT NULL CHECK (changed_at >= 0)
) STRICT;
