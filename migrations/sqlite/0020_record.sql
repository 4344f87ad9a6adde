-- That the rows from before each had a record of its own have been written into the audit trail: once, by the first start that knew how.
CREATE TABLE stock (
    one INTEGER PRIMARY KEY CHECK (one = 1),
    at  INTEGER NOT NULL CHECK (at >= 0)
) STRICT;

-- Records that lie in an archive: which of them, and where in its file. The hashes let the chain go on where a file is lost.
CREATE TABLE audit_away (
    first    INTEGER PRIMARY KEY CHECK (first >= 1),
    last     INTEGER NOT NULL CHECK (last >= first),
    weighing TEXT NOT NULL,
    -- Hash of the record before the first.
    before   TEXT NOT NULL CHECK (length(before) = 64),
    -- Hash of the last.
    hash     TEXT NOT NULL CHECK (length(hash) = 64),
    -- The record that names the file.
    archive  INTEGER NOT NULL CHECK (archive > last),
    -- Where they begin in it, and how long they are, compressed, bytes.
    start    INTEGER NOT NULL CHECK (start >= 0),
    bytes    INTEGER NOT NULL CHECK (bytes > 0)
) STRICT;
CREATE INDEX audit_away_by_weighing ON audit_away (weighing, first);
CREATE INDEX audit_away_by_last ON audit_away (last);
CREATE TRIGGER audit_away_stays BEFORE UPDATE ON audit_away BEGIN SELECT RAISE(ABORT, 'the audit trail is only ever added to'); END;
CREATE TRIGGER audit_away_keeps BEFORE DELETE ON audit_away BEGIN SELECT RAISE(ABORT, 'the audit trail is only ever added to'); END;

-- What lies in an archive may go; everything else stays.
DROP TRIGGER audit_keeps;
CREATE TRIGGER audit_keeps BEFORE DELETE ON audit
WHEN coalesce((SELECT last FROM audit_away WHERE first <= OLD.seq ORDER BY first DESC LIMIT 1), 0) < OLD.seq
BEGIN SELECT RAISE(ABORT, 'the audit trail is only ever added to'); END;
