-- Networks that played a training's episodes 1, 10, 100 and 1000, as policies. They are not among the policies: nobody weighs with them.
CREATE TABLE kept_policy (
    job     TEXT NOT NULL REFERENCES job (id),
    episode INTEGER NOT NULL CHECK (episode >= 1),
    id      TEXT NOT NULL CHECK (id GLOB 'p-*'),
    bytes   BLOB NOT NULL CHECK (length(bytes) BETWEEN 1 AND 16777216),
    sha256  TEXT NOT NULL CHECK (length(sha256) = 64),
    PRIMARY KEY (job, episode)
) STRICT;
CREATE INDEX kept_policy_id ON kept_policy (id);
