-- Addresses that are told when a weighing or a job has ended, or the bench is latched.
CREATE TABLE webhook (
    id            TEXT NOT NULL PRIMARY KEY CHECK (id GLOB 'wh-*'),
    url           TEXT NOT NULL CHECK (length(url) BETWEEN 8 AND 2000),
    -- What its messages are signed with: it must be known to sign, so it is stored as it is.
    secret        BLOB NOT NULL CHECK (length(secret) = 32),
    created_at    INTEGER NOT NULL CHECK (created_at >= 0),
    -- The last event that it needs no message of.
    seq           INTEGER NOT NULL CHECK (seq >= 0),
    failing_since INTEGER,
    error         TEXT
) STRICT;
