-- Weighings that settle, and two more ways to end. A CHECK cannot be changed, so the table is made anew under its name; nothing refers to it.
CREATE TABLE weighing_kept AS SELECT * FROM weighing;
DROP TABLE weighing;

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
    -- The nine values of the simulated powder, by content address.
    parameter_set      TEXT NOT NULL CHECK (parameter_set GLOB 'ps-*'),
    seed               INTEGER NOT NULL,
    state              TEXT NOT NULL CHECK (state IN ('planned', 'armed', 'dosing', 'settling', 'done', 'aborted', 'unknown')),
    outcome            TEXT CHECK (outcome IN ('within', 'under', 'over', 'not_stable', 'blocked', 'stopped', 'aborted', 'unknown')),
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
    -- The version on the simulated bench with its conditions, and what they change about the powder; none is the base.
    under              TEXT CHECK (json_valid(under)),
    patch              TEXT CHECK (json_valid(patch)),
    -- The bench that was armed for it; null until then, and of weighings from before there were others: the simulator.
    bench              TEXT CHECK (bench IN ('simulated', 'emulated', 'devices')),
    -- What else was asked: lot, vial, operator, what follows an overdose.
    asked              TEXT CHECK (json_valid(asked)),
    -- What was measured beside the net mass: gross, tare, uncertainty, drift, stability, devices, air.
    measured           TEXT CHECK (json_valid(measured)),
    CHECK ((state IN ('done', 'aborted', 'unknown')) = (outcome IS NOT NULL)),
    CHECK ((outcome IS NULL) = (finished_at IS NULL))
) STRICT;

INSERT INTO weighing (seq, id, idempotency_key, request_sha256, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, policy, parameter_set, seed,
                      state, outcome, dispensed_mg, reading_mg, error_mg, shakes, seconds, trace, error, created_at, started_at, finished_at, under, patch)
SELECT seq, id, idempotency_key, request_sha256, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, policy, parameter_set, seed,
       state, outcome, dispensed_mg, reading_mg, error_mg, shakes, seconds, trace, error, created_at, started_at, finished_at, under, patch
FROM weighing_kept;
DROP TABLE weighing_kept;

-- One bench: at most one weighing moves.
CREATE UNIQUE INDEX weighing_moving ON weighing ((1)) WHERE state IN ('armed', 'dosing', 'settling');
CREATE INDEX weighing_planned ON weighing (seq) WHERE state = 'planned';

-- A bench that nobody may use until a person has looked at it. Open is what has not been cleared.
CREATE TABLE latch (
    seq        INTEGER PRIMARY KEY,
    at         INTEGER NOT NULL CHECK (at >= 0),
    reason     TEXT NOT NULL,
    weighing   TEXT,
    cleared_at INTEGER,
    cleared_by TEXT,
    note       TEXT,
    CHECK ((cleared_at IS NULL) = (cleared_by IS NULL))
) STRICT;
CREATE UNIQUE INDEX latch_open ON latch ((1)) WHERE cleared_at IS NULL;

-- What happened on the bench, in order. Each record's hash covers the one before it, so that nothing can be changed or taken out unseen.
CREATE TABLE audit (
    seq      INTEGER PRIMARY KEY,
    at       INTEGER NOT NULL CHECK (at >= 0),
    weighing TEXT CHECK (weighing NOT GLOB '*' || char(10) || '*'),
    kind     TEXT NOT NULL CHECK (kind NOT GLOB '*' || char(10) || '*'),
    -- As it was hashed, to the byte.
    body     TEXT NOT NULL CHECK (json_valid(body)),
    hash     TEXT NOT NULL UNIQUE CHECK (length(hash) = 64)
) STRICT;
CREATE INDEX audit_by_weighing ON audit (weighing, seq);
CREATE TRIGGER audit_stays BEFORE UPDATE ON audit BEGIN SELECT RAISE(ABORT, 'the audit trail is only ever added to'); END;
CREATE TRIGGER audit_keeps BEFORE DELETE ON audit BEGIN SELECT RAISE(ABORT, 'the audit trail is only ever added to'); END;

-- Checks of the bench that later weighings refer to: repeatability, shake calibration, conformance.
CREATE TABLE bench_check (
    seq  INTEGER PRIMARY KEY,
    at   INTEGER NOT NULL CHECK (at >= 0),
    kind TEXT NOT NULL CHECK (kind IN ('repeatability', 'shakes', 'conformance')),
    body TEXT NOT NULL CHECK (json_valid(body))
) STRICT;
CREATE INDEX bench_check_by_kind ON bench_check (kind, seq);
