-- Which version of the simulator is taken where none is named, choice by choice: the newest counts. No row, or NULL: the base.
CREATE TABLE current_simulator (
    seq       INTEGER PRIMARY KEY,
    version   TEXT REFERENCES simulator_version (id),
    chosen_at INTEGER NOT NULL CHECK (chosen_at >= 0)
) STRICT;
