CREATE TABLE parameter_set (
    seq           INTEGER PRIMARY KEY,
    id            TEXT NOT NULL UNIQUE CHECK (id GLOB 'ps-*'),
    powder        TEXT REFERENCES powder (id),
    -- The calibration that found it first; calibration_set names every one that kept it.
    calibration   TEXT NOT NULL REFERENCES job (id),
    parameters    TEXT NOT NULL CHECK (json_valid(parameters)),
    repose_deg    REAL NOT NULL CHECK (repose_deg BETWEEN 0 AND 90),
    repose_sd_deg REAL CHECK (repose_sd_deg BETWEEN 0 AND 90),
    runs          INTEGER NOT NULL CHECK (runs >= 1),
    error_deg     REAL NOT NULL CHECK (error_deg BETWEEN 0 AND 90),
    created_at    INTEGER NOT NULL CHECK (created_at >= 0)
) STRICT;

CREATE INDEX parameter_set_of_powder ON parameter_set (powder, seq);

CREATE TABLE calibration_set (
    calibration   TEXT NOT NULL REFERENCES job (id),
    position      INTEGER NOT NULL CHECK (position >= 0),
    parameter_set TEXT NOT NULL REFERENCES parameter_set (id),
    PRIMARY KEY (calibration, position)
) STRICT, WITHOUT ROWID;
