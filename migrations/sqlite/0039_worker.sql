-- Processes that compute jobs.
CREATE TABLE worker (
    id         TEXT NOT NULL PRIMARY KEY,
    name       TEXT NOT NULL CHECK (length(name) BETWEEN 1 AND 100),
    version    TEXT NOT NULL,
    -- The kinds of jobs that it takes, a JSON array.
    kinds      TEXT NOT NULL,
    threads    INTEGER NOT NULL CHECK (threads > 0),
    -- Whether it answers requests, too.
    serves     INTEGER NOT NULL CHECK (serves IN (0, 1)),
    started_at INTEGER NOT NULL CHECK (started_at >= 0),
    heard_at   INTEGER NOT NULL CHECK (heard_at >= 0),
    ended_at   INTEGER
) STRICT;
