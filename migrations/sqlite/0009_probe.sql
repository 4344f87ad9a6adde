-- Simulations of observables beside the angle of repose. `owner` is the content address of an observable's emulator, which calibrations
-- share, or the calibration whose sets were checked.
CREATE TABLE probe (
    owner    TEXT NOT NULL,
    position INTEGER NOT NULL CHECK (position >= 0),
    body     TEXT NOT NULL CHECK (json_valid(body)),
    PRIMARY KEY (owner, position)
) STRICT, WITHOUT ROWID;
