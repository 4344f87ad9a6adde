-- Pieces of running jobs that any worker may compute.
CREATE TABLE portion (
    id          TEXT NOT NULL PRIMARY KEY,
    job         TEXT NOT NULL REFERENCES job (id),
    -- The attempt at the job that cut it: the fence of its lease.
    attempt     INTEGER NOT NULL,
    -- Portions of an attempt are taken in this order.
    number      INTEGER NOT NULL,
    -- What kind of experiments it holds, and these, in CBOR.
    kind        TEXT NOT NULL,
    experiments BLOB NOT NULL,
    -- Who computes it, the number of the claim, and how long that holds.
    owner       TEXT,
    fence       INTEGER NOT NULL DEFAULT 0,
    lease_until INTEGER,
    -- What the experiments gave, in CBOR.
    outcomes    BLOB,
    done_at     INTEGER,
    CHECK ((outcomes IS NULL) = (done_at IS NULL)),
    UNIQUE (job, attempt, number)
) STRICT;
