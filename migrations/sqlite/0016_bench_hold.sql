-- Weighings that wait for their vial. A CHECK cannot be changed, so the table is made anew under its name; nothing refers to it.
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
    state              TEXT NOT NULL CHECK (state IN ('planned', 'awaiting_vial', 'armed', 'dosing', 'settling', 'done', 'aborted', 'unknown')),
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
    -- Whether somebody has to say that the vial is in, where the bench cannot exchange it; null: yes.
    vial_check         TEXT CHECK (vial_check IN ('confirm', 'skip')),
    CHECK ((state IN ('done', 'aborted', 'unknown')) = (outcome IS NOT NULL)),
    CHECK ((outcome IS NULL) = (finished_at IS NULL))
) STRICT;

INSERT INTO weighing (seq, id, idempotency_key, request_sha256, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, policy, parameter_set, seed,
                      state, outcome, dispensed_mg, reading_mg, error_mg, shakes, seconds, trace, error, created_at, started_at, finished_at, under, patch,
                      bench, asked, measured)
SELECT seq, id, idempotency_key, request_sha256, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, policy, parameter_set, seed,
       state, outcome, dispensed_mg, reading_mg, error_mg, shakes, seconds, trace, error, created_at, started_at, finished_at, under, patch,
       bench, asked, measured
FROM weighing_kept;
DROP TABLE weighing_kept;

-- One bench: at most one weighing moves.
CREATE UNIQUE INDEX weighing_moving ON weighing ((1)) WHERE state IN ('armed', 'dosing', 'settling');
CREATE INDEX weighing_waiting ON weighing (seq) WHERE state IN ('planned', 'awaiting_vial');

-- What the latched bench was made of: only a process that has such a bench can clear it. Null of latches from before it was kept.
ALTER TABLE latch ADD COLUMN bench TEXT CHECK (bench IN ('simulated', 'emulated', 'devices'));

-- A bench that begins nothing until a person resumes. Open is what has not been resumed.
CREATE TABLE bench_hold (
    seq        INTEGER PRIMARY KEY,
    at         INTEGER NOT NULL CHECK (at >= 0),
    reason     TEXT NOT NULL,
    -- Who held it, where that is known.
    held_by    TEXT,
    resumed_at INTEGER,
    resumed_by TEXT,
    note       TEXT,
    CHECK ((resumed_at IS NULL) = (resumed_by IS NULL))
) STRICT;
CREATE UNIQUE INDEX bench_hold_open ON bench_hold ((1)) WHERE resumed_at IS NULL;

-- What stands on the pan of a bench that cannot exchange vials, as far as it is known.
CREATE TABLE bench_pan (
    one  INTEGER PRIMARY KEY CHECK (one = 1),
    body TEXT NOT NULL CHECK (json_valid(body))
) STRICT;

-- Who has the bench for himself, and until when. It ends by itself.
CREATE TABLE bench_reservation (
    one         INTEGER PRIMARY KEY CHECK (one = 1),
    id          TEXT NOT NULL UNIQUE CHECK (id GLOB 'rs-*'),
    owner       TEXT NOT NULL,
    until       INTEGER NOT NULL CHECK (until >= 0)
) STRICT;
