-- Any number of benches, each of one process. What was there until now is of the one named `bench`.
CREATE TABLE bench (
    name        TEXT NOT NULL PRIMARY KEY CHECK (length(name) BETWEEN 1 AND 100),
    -- Its chain of the audit trail: records 1 + chain * 2^40 and on. 0 is the chain of the bench named `bench`, and of what belongs to no bench.
    chain       INTEGER NOT NULL UNIQUE CHECK (chain BETWEEN 0 AND 8191),
    kind        TEXT,
    -- The worker that has it, and where that runs; null once it was given back.
    owner       TEXT,
    machine     TEXT,
    -- Raised whenever it changes hands. Who carries an older one can record nothing.
    fence       INTEGER NOT NULL DEFAULT 0 CHECK (fence >= 0),
    lease_until INTEGER,
    since       INTEGER,
    -- What its container holds, if it was said.
    powder      TEXT REFERENCES powder (id),
    lot         TEXT,
    loaded_at   INTEGER,
    CHECK ((powder IS NULL) = (loaded_at IS NULL))
) STRICT;

-- What other processes ask of a bench's owner.
CREATE TABLE bench_request (
    seq         INTEGER PRIMARY KEY,
    id          TEXT NOT NULL UNIQUE,
    bench_name  TEXT NOT NULL,
    -- The request, and who made it, as JSON; the answer too.
    body        TEXT NOT NULL CHECK (json_valid(body)),
    asked_at    INTEGER NOT NULL CHECK (asked_at >= 0),
    -- Later than this it is not carried out.
    until       INTEGER NOT NULL,
    answer      TEXT CHECK (json_valid(answer)),
    answered_at INTEGER
) STRICT;
CREATE INDEX bench_request_open ON bench_request (bench_name, seq) WHERE answered_at IS NULL;

ALTER TABLE weighing ADD COLUMN bench_name TEXT NOT NULL DEFAULT 'bench';
ALTER TABLE latch ADD COLUMN bench_name TEXT NOT NULL DEFAULT 'bench';
ALTER TABLE bench_hold ADD COLUMN bench_name TEXT NOT NULL DEFAULT 'bench';
ALTER TABLE bench_check ADD COLUMN bench_name TEXT NOT NULL DEFAULT 'bench';

-- Of each bench: one weighing moves at most, one latch and one hold are open at most.
DROP INDEX weighing_moving;
DROP INDEX weighing_waiting;
DROP INDEX latch_open;
DROP INDEX bench_hold_open;
DROP INDEX bench_check_by_kind;
CREATE UNIQUE INDEX weighing_moving ON weighing (bench_name) WHERE state IN ('armed', 'dosing', 'settling');
CREATE INDEX weighing_waiting ON weighing (bench_name, seq) WHERE state IN ('planned', 'awaiting_vial');
CREATE UNIQUE INDEX latch_open ON latch (bench_name) WHERE cleared_at IS NULL;
CREATE UNIQUE INDEX bench_hold_open ON bench_hold (bench_name) WHERE resumed_at IS NULL;
CREATE INDEX bench_check_by_kind ON bench_check (bench_name, kind, seq);

-- One pan and one reservation of each bench: `one` is 1 + the number of its chain. A CHECK cannot be dropped, so the tables are made anew.
CREATE TABLE bench_pan_kept AS SELECT * FROM bench_pan;
DROP TABLE bench_pan;
CREATE TABLE bench_pan (
    one  INTEGER PRIMARY KEY CHECK (one >= 1),
    body TEXT NOT NULL CHECK (json_valid(body))
) STRICT;
INSERT INTO bench_pan (one, body) SELECT one, body FROM bench_pan_kept;
DROP TABLE bench_pan_kept;

CREATE TABLE bench_reservation_kept AS SELECT * FROM bench_reservation;
DROP TABLE bench_reservation;
CREATE TABLE bench_reservation (
    one         INTEGER PRIMARY KEY CHECK (one >= 1),
    id          TEXT NOT NULL UNIQUE CHECK (id GLOB 'rs-*'),
    owner       TEXT NOT NULL,
    until       INTEGER NOT NULL CHECK (until >= 0)
) STRICT;
INSERT INTO bench_reservation (one, id, owner, until) SELECT one, id, owner, until FROM bench_reservation_kept;
DROP TABLE bench_reservation_kept;
