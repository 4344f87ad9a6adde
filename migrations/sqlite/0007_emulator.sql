-- Heaps of the emulators that calibrations share. `emulator` is the content address of the design and the simulator's version, so a heap is
-- simulated once for all calibrations, whichever job came first.
CREATE TABLE emulator_run (
    emulator TEXT NOT NULL CHECK (emulator GLOB 'em-*'),
    position INTEGER NOT NULL CHECK (position >= 0),
    body     TEXT NOT NULL CHECK (json_valid(body)),
    PRIMARY KEY (emulator, position)
) STRICT, WITHOUT ROWID;
