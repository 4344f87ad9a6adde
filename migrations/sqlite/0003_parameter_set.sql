CREATE TABLE parameter_set (
    seq           INTEGER PRIMARY KEY,
    -- A content address, not unique: two calibrations may keep the same nine values, each with its own angle and error.
    id            TEXT NOT NULL CHECK (id GLOB 'ps-*'),
    powder        TEXT REFERENCES powder (id),
    calibration   TEXT NOT NULL REFERENCES job (id),
    position      INTEGER NOT NULL CHECK (position >= 0),
    parameters    TEXT NOT NULL CHECK (json_valid(parameters)),
    repose_deg    REAL NOT NULL CHECK (repose_deg BETWEEN 0 AND 90),
    repose_sd_deg REAL CHECK (repose_sd_deg BETWEEN 0 AND 90),
    runs          INTEGER NOT NULL CHECK (runs >= 1),
    error_deg     REAL NOT NULL CHECK (error_deg BETWEEN 0 AND 90),
    created_at    INTEGER NOT NULL CHECK (created_at >= 0),
    UNIQUE (calibration, position)
) STRICT;

CREATE INDEX parameter_set_of_powder ON parameter_set (powder, seq);
CREATE INDEX parameter_set_by_id ON parameter_set (id, seq);
