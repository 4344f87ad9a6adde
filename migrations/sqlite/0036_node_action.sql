-- Names this data folder to other systems, for as long as it exists.
CREATE TABLE installation (
    id TEXT NOT NULL PRIMARY KEY CHECK (length(id) = 36)
) STRICT;
INSERT INTO installation
SELECT substr(h, 1, 8) || '-' || substr(h, 9, 4) || '-4' || substr(h, 14, 3) || '-a' || substr(h, 18, 3) || '-' || substr(h, 21)
FROM (SELECT lower(hex(randomblob(16))) AS h);

-- What a workcell (MADSci) asked of this node: an action is created first and started once. It then is a weighing or a job, or it was refused.
CREATE TABLE node_action (
    id         TEXT NOT NULL PRIMARY KEY CHECK (length(id) = 26),
    name       TEXT NOT NULL,
    args       TEXT NOT NULL CHECK (json_valid(args)),
    created_at INTEGER NOT NULL CHECK (created_at >= 0),
    -- Id of the weighing or job; of the action itself if it was done at once.
    made       TEXT,
    refused    TEXT CHECK (refused IS NULL OR json_valid(refused)),
    CHECK (made IS NULL OR refused IS NULL)
) STRICT;
CREATE INDEX node_action_made ON node_action (made) WHERE made IS NOT NULL;
