CREATE TABLE weighing (
    seq                INTEGER PRIMARY KEY,
    id                 TEXT NOT NULL UNIQUE,
    -- The same key with the same request finds the same weighing: a retried call never pours twice.
    idempotency_key    TEXT NOT NULL UNIQUE CHECK (length(idempotency_key) BETWEEN 1 AND 255),
    request_sha256     BLOB NOT NULL CHECK (length(request_sha256) = 32),
    powder             TEXT NOT NULL REFERENCES powder (id),
    target_mg          REAL NOT NULL CHECK (target_mg > 0 AND target_mg <= 1e6),
    tolerance_lower_mg REAL NOT NULL CHECK (tolerance_lower_mg >= 0 AND tolerance_lower_mg <= 1e6),
    tolerance_upper_mg REAL NOT NULL CHECK (tolerance_upper_mg >= 0 AND tolerance_upper_mg <= 1e6),
    policy             TEXT NOT NULL REFERENCES policy (id),
    -- The nine values on the simulated bench, by content address.
    parameter_set      TEXT NOT NULL CHECK (parameter_set GLOB 'ps-*'),
    seed               INTEGER NOT NULL,
    state              TEXT NOT NULL CHECK (state IN ('planned', 'armed', 'dosing', 'done', 'aborted', 'unknown')),
    outcome            TEXT CHECK (outcome IN ('within', 'under', 'over', 'stopped', 'aborted', 'unknown')),
    dispensed_mg       REAL,
    reading_mg         REAL,
    error_mg           REAL,
    shakes             INTEGER,
    seconds            REAL,
    -- SHA-256 of the artifact that holds the ticks.
    trace              TEXT CHECK (length(trace) = 64),
    error              TEXT,
    created_at         INTEGER NOT NULL CHECK (created_at >= 0),
    started_at         INTEGER,
    finished_at        INTEGER,
    CHECK ((state IN ('done', 'aborted', 'unknown')) = (outcome IS NOT NULL)),
    CHECK ((outcome IS NULL) = (finished_at IS NULL))
) STRICT;

-- One bench: at most one weighing moves.
CREATE UNIQUE INDEX weighing_moving ON weighing ((1)) WHERE state IN ('armed', 'dosing');
CREATE INDEX weighing_planned ON weighing (seq) WHERE state = 'planned';
