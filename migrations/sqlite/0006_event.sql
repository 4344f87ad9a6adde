-- AUTOINCREMENT: numbers are never used again, so that a follower who resumes cannot miss an event.
CREATE TABLE event (
    seq   INTEGER PRIMARY KEY AUTOINCREMENT,
    topic TEXT NOT NULL,
    kind  TEXT NOT NULL,
    data  TEXT NOT NULL CHECK (json_valid(data)),
    at    INTEGER NOT NULL CHECK (at >= 0)
) STRICT;

CREATE INDEX event_of_topic ON event (topic, seq);

CREATE TABLE token (
    seq        INTEGER PRIMARY KEY,
    id         TEXT NOT NULL UNIQUE,
    name       TEXT NOT NULL CHECK (length(name) BETWEEN 1 AND 100),
    role       TEXT NOT NULL CHECK (role IN ('viewer', 'operator', 'admin')),
    sha256     BLOB NOT NULL CHECK (length(sha256) = 32),
    created_at INTEGER NOT NULL CHECK (created_at >= 0)
) STRICT;
