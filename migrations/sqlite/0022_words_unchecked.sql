-- Words leave the schema: kinds, states, outcomes and the like are checked where they are read, so that a new one rebuilds no table. A CHECK
-- cannot be changed, so each table that lists words is made anew under its name, once. Ranges, JSON and NOT NULL stay as they were, and so
-- do columns, their order, indexes and rows.
--
-- What a state says about the rest of its row stays too, for the states that are known here: a CASE without ELSE is NULL for any other, which
-- passes.
--
-- Rows that refer to a job refer to nothing until it is back, which is looked at when the migration is committed.
PRAGMA defer_foreign_keys = ON;

CREATE TABLE measurement_kept AS SELECT * FROM measurement;
DROP TABLE measurement;

CREATE TABLE measurement (
    seq        INTEGER PRIMARY KEY,
    id         TEXT NOT NULL UNIQUE,
    powder     TEXT NOT NULL REFERENCES powder (id),
    method     TEXT NOT NULL,
    repose_deg REAL NOT NULL CHECK (repose_deg BETWEEN 5 AND 85),
    sd_deg     REAL NOT NULL CHECK (sd_deg BETWEEN 0 AND 45),
    n          INTEGER NOT NULL CHECK (n BETWEEN 1 AND 10000),
    source     TEXT NOT NULL CHECK (length(source) <= 500),
    created_at INTEGER NOT NULL CHECK (created_at >= 0)
) STRICT;

INSERT INTO measurement (seq, id, powder, method, repose_deg, sd_deg, n, source, created_at)
SELECT seq, id, powder, method, repose_deg, sd_deg, n, source, created_at FROM measurement_kept;
DROP TABLE measurement_kept;

CREATE INDEX measurement_of_powder ON measurement (powder, seq);

CREATE TABLE job_kept AS SELECT * FROM job;
DROP TABLE job;

CREATE TABLE job (
    seq              INTEGER PRIMARY KEY,
    id               TEXT NOT NULL UNIQUE,
    kind             TEXT NOT NULL,
    spec             TEXT NOT NULL CHECK (json_valid(spec)),
    spec_sha256      BLOB NOT NULL CHECK (length(spec_sha256) = 32),
    state            TEXT NOT NULL,
    -- Grows by one with every claim; a writer with an older number is a zombie.
    fence            INTEGER NOT NULL DEFAULT 0 CHECK (fence >= 0),
    -- Claims in all, for people.
    attempts         INTEGER NOT NULL DEFAULT 0 CHECK (attempts >= 0),
    -- Attempts that ended in an error or a panic since something was last saved.
    failures         INTEGER NOT NULL DEFAULT 0 CHECK (failures >= 0),
    -- Attempts whose process ended since something was last saved.
    deaths           INTEGER NOT NULL DEFAULT 0 CHECK (deaths >= 0),
    owner            TEXT,
    lease_until      INTEGER,
    cancel_requested INTEGER NOT NULL DEFAULT 0 CHECK (cancel_requested IN (0, 1)),
    fraction         REAL NOT NULL DEFAULT 0 CHECK (fraction BETWEEN 0 AND 1),
    message          TEXT NOT NULL DEFAULT '',
    -- SHA-256 of the artifact to resume from.
    checkpoint       TEXT CHECK (length(checkpoint) = 64),
    result           TEXT CHECK (json_valid(result)),
    error            TEXT,
    created_at       INTEGER NOT NULL CHECK (created_at >= 0),
    started_at       INTEGER,
    finished_at      INTEGER,
    CHECK (CASE state
        WHEN 'queued'    THEN (owner IS NULL OR lease_until IS NULL) AND finished_at IS NULL AND result IS NULL
        WHEN 'running'   THEN owner IS NOT NULL AND lease_until IS NOT NULL AND finished_at IS NULL AND result IS NULL
        WHEN 'succeeded' THEN (owner IS NULL OR lease_until IS NULL) AND finished_at IS NOT NULL AND result IS NOT NULL
        WHEN 'failed'    THEN (owner IS NULL OR lease_until IS NULL) AND finished_at IS NOT NULL AND result IS NULL
        WHEN 'cancelled' THEN (owner IS NULL OR lease_until IS NULL) AND finished_at IS NOT NULL AND result IS NULL
    END)
) STRICT;

INSERT INTO job (seq, id, kind, spec, spec_sha256, state, fence, attempts, failures, deaths, owner, lease_until, cancel_requested, fraction,
                 message, checkpoint, result, error, created_at, started_at, finished_at)
SELECT seq, id, kind, spec, spec_sha256, state, fence, attempts, failures, deaths, owner, lease_until, cancel_requested, fraction,
       message, checkpoint, result, error, created_at, started_at, finished_at
FROM job_kept;
DROP TABLE job_kept;

-- Asking for the same thing again finds the job that does it or has done it.
CREATE UNIQUE INDEX job_by_spec ON job (spec_sha256) WHERE state NOT IN ('failed', 'cancelled');
CREATE INDEX job_by_kind ON job (kind, seq);
CREATE INDEX job_unfinished ON job (seq) WHERE state IN ('queued', 'running');

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
    state              TEXT NOT NULL,
    outcome            TEXT,
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
    bench              TEXT,
    -- What else was asked: lot, vial, operator, what follows an overdose.
    asked              TEXT CHECK (json_valid(asked)),
    -- What was measured beside the net mass: gross, tare, uncertainty, drift, stability, devices, air.
    measured           TEXT CHECK (json_valid(measured)),
    -- Whether somebody has to say that the vial is in, where the bench cannot exchange it; null: yes.
    vial_check         TEXT,
    CHECK (CASE
        WHEN state IN ('planned', 'awaiting_vial', 'armed', 'dosing', 'settling') THEN outcome IS NULL
        WHEN state IN ('done', 'aborted', 'unknown') THEN outcome IS NOT NULL
    END),
    CHECK ((outcome IS NULL) = (finished_at IS NULL))
) STRICT;

INSERT INTO weighing (seq, id, idempotency_key, request_sha256, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, policy, parameter_set, seed,
                      state, outcome, dispensed_mg, reading_mg, error_mg, shakes, seconds, trace, error, created_at, started_at, finished_at, under, patch,
                      bench, asked, measured, vial_check)
SELECT seq, id, idempotency_key, request_sha256, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, policy, parameter_set, seed,
       state, outcome, dispensed_mg, reading_mg, error_mg, shakes, seconds, trace, error, created_at, started_at, finished_at, under, patch,
       bench, asked, measured, vial_check
FROM weighing_kept;
DROP TABLE weighing_kept;

-- One bench: at most one weighing moves.
CREATE UNIQUE INDEX weighing_moving ON weighing ((1)) WHERE state IN ('armed', 'dosing', 'settling');
CREATE INDEX weighing_waiting ON weighing (seq) WHERE state IN ('planned', 'awaiting_vial');

CREATE TABLE token_kept AS SELECT * FROM token;
DROP TABLE token;

CREATE TABLE token (
    seq          INTEGER PRIMARY KEY,
    id           TEXT NOT NULL UNIQUE,
    name         TEXT NOT NULL CHECK (length(name) BETWEEN 1 AND 100),
    role         TEXT NOT NULL,
    sha256       BLOB NOT NULL CHECK (length(sha256) = 32),
    created_at   INTEGER NOT NULL CHECK (created_at >= 0),
    -- Tokens end: on a day, or when a person revokes them. Revoked ones stay, because records name them.
    expires_at   INTEGER CHECK (expires_at >= 0),
    revoked_at   INTEGER CHECK (revoked_at >= 0),
    -- Written now and then, not at every request.
    last_used_at INTEGER CHECK (last_used_at >= 0),
    -- Whether its holder may clear a latched bench; an admin always may.
    may_clear    INTEGER NOT NULL DEFAULT 0 CHECK (may_clear IN (0, 1))
) STRICT;

INSERT INTO token (seq, id, name, role, sha256, created_at, expires_at, revoked_at, last_used_at, may_clear)
SELECT seq, id, name, role, sha256, created_at, expires_at, revoked_at, last_used_at, may_clear FROM token_kept;
DROP TABLE token_kept;

CREATE TABLE latch_kept AS SELECT * FROM latch;
DROP TABLE latch;

-- A bench that nobody may use until a person has looked at it. Open is what has not been cleared.
CREATE TABLE latch (
    seq        INTEGER PRIMARY KEY,
    at         INTEGER NOT NULL CHECK (at >= 0),
    reason     TEXT NOT NULL,
    weighing   TEXT,
    cleared_at INTEGER,
    cleared_by TEXT,
    note       TEXT,
    -- What the latched bench was made of: only a process that has such a bench can clear it. Null of latches from before it was kept.
    bench      TEXT,
    CHECK ((cleared_at IS NULL) = (cleared_by IS NULL))
) STRICT;

INSERT INTO latch (seq, at, reason, weighing, cleared_at, cleared_by, note, bench)
SELECT seq, at, reason, weighing, cleared_at, cleared_by, note, bench FROM latch_kept;
DROP TABLE latch_kept;

CREATE UNIQUE INDEX latch_open ON latch ((1)) WHERE cleared_at IS NULL;

CREATE TABLE bench_check_kept AS SELECT * FROM bench_check;
DROP TABLE bench_check;

-- Checks of the bench that later weighings refer to: repeatability, shake calibration, conformance.
CREATE TABLE bench_check (
    seq  INTEGER PRIMARY KEY,
    at   INTEGER NOT NULL CHECK (at >= 0),
    kind TEXT NOT NULL,
    body TEXT NOT NULL CHECK (json_valid(body))
) STRICT;

INSERT INTO bench_check (seq, at, kind, body) SELECT seq, at, kind, body FROM bench_check_kept;
DROP TABLE bench_check_kept;

CREATE INDEX bench_check_by_kind ON bench_check (kind, seq);
