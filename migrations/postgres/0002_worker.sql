-- Processes that compute jobs.
CREATE TABLE worker (
    id         TEXT COLLATE "C" NOT NULL PRIMARY KEY,
    name       TEXT COLLATE "C" NOT NULL CHECK (length(name) BETWEEN 1 AND 100),
    version    TEXT COLLATE "C" NOT NULL,
    -- The kinds of jobs that it takes, a JSON array.
    kinds      TEXT COLLATE "C" NOT NULL,
    threads    BIGINT NOT NULL CHECK (threads > 0),
    -- Whether it answers requests, too.
    serves     BOOLEAN NOT NULL,
    started_at BIGINT NOT NULL CHECK (started_at >= 0),
    heard_at   BIGINT NOT NULL CHECK (heard_at >= 0),
    ended_at   BIGINT
);
