-- Pieces of running jobs that any worker may compute.
CREATE TABLE portion (
    id          TEXT COLLATE "C" NOT NULL PRIMARY KEY,
    job         TEXT COLLATE "C" NOT NULL REFERENCES job (id),
    -- The attempt at the job that cut it: the fence of its lease.
    attempt     BIGINT NOT NULL,
    -- Portions of an attempt are taken in this order.
    number      BIGINT NOT NULL,
    -- What kind of experiments it holds, and these, in CBOR.
    kind        TEXT COLLATE "C" NOT NULL,
    experiments BYTEA NOT NULL,
    -- Who computes it, the number of the claim, and how long that holds.
    owner       TEXT COLLATE "C",
    fence       BIGINT NOT NULL DEFAULT 0,
    lease_until BIGINT,
    -- What the experiments gave, in CBOR.
    outcomes    BYTEA,
    done_at     BIGINT,
    CHECK ((outcomes IS NULL) = (done_at IS NULL)),
    UNIQUE (job, attempt, number)
);
-- Other processes hear that there is work, that it is done, and that it is wanted no more. Not of leases that are renewed.
CREATE FUNCTION tell_portion() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    PERFORM pg_notify('flip_portion', '');
    RETURN NULL;
END
$$;
CREATE TRIGGER portion_told AFTER INSERT OR DELETE OR UPDATE OF owner, done_at ON portion FOR EACH ROW EXECUTE FUNCTION tell_portion();
