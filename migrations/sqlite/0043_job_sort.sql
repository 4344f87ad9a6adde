-- What a queue is asked for, beside the specifications that say it: the method of a calibration, and what a job computes on.
ALTER TABLE job ADD COLUMN method TEXT;
ALTER TABLE job ADD COLUMN device TEXT NOT NULL DEFAULT 'cpu';
UPDATE job SET method = spec ->> '$.calibration.settings.method' WHERE kind = 'calibration';
UPDATE job SET device = subject ->> '$.device' WHERE subject ->> '$.device' IS NOT NULL;

-- The first of each sort, however long the queue is.
CREATE INDEX job_waiting ON job (kind, device, seq) WHERE state IN ('queued', 'running');
CREATE INDEX job_of_worker ON job (owner) WHERE state = 'running';
-- How long jobs took, the newest first.
CREATE INDEX job_timed ON job (seq) WHERE state = 'succeeded' AND attempts = 1;
