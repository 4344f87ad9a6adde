-- What the queue library left in the folders of its time: its tables, a delivery, a worker, and its migrations.

CREATE TABLE Workers (id TEXT NOT NULL UNIQUE, worker_type TEXT NOT NULL, storage_name TEXT NOT NULL, layers TEXT, last_seen INTEGER NOT NULL DEFAULT (strftime('%s', 'now')) , started_at INTEGER);
CREATE INDEX Idx ON Workers(id);
CREATE INDEX LSIdx ON Workers(last_seen);
CREATE INDEX WTIdx ON Workers(worker_type);
CREATE TABLE Jobs (job BLOB NOT NULL, id TEXT NOT NULL UNIQUE, job_type TEXT NOT NULL, status TEXT NOT NULL DEFAULT 'Pending', attempts INTEGER NOT NULL DEFAULT 0, max_attempts INTEGER NOT NULL DEFAULT 25, run_at INTEGER NOT NULL DEFAULT (strftime('%s', 'now')), last_result TEXT, lock_at INTEGER, lock_by TEXT, done_at INTEGER, priority INTEGER NOT NULL DEFAULT 0, metadata TEXT, idempotency_key TEXT, PRIMARY KEY(id), FOREIGN KEY(lock_by) REFERENCES Workers(id));
CREATE INDEX LIdx ON Jobs(lock_by);
CREATE INDEX idx_jobs_claimable ON Jobs(status, attempts) WHERE status IN ('Queued', 'Pending', 'Failed');
CREATE INDEX idx_jobs_completed_done_at ON Jobs(status, done_at, run_at) WHERE status IN ('Done', 'Failed', 'Killed') AND done_at IS NOT NULL;
CREATE INDEX idx_jobs_failed ON Jobs (job_type, priority DESC, run_at ASC, id ASC) WHERE status = 'Failed' AND attempts < max_attempts;
CREATE UNIQUE INDEX idx_jobs_idempotency_key ON Jobs(job_type, idempotency_key);
CREATE INDEX idx_jobs_job_type_status_run_at ON Jobs(job_type, status, run_at);
CREATE INDEX idx_jobs_pending ON Jobs (job_type, priority DESC, run_at ASC, id ASC) WHERE status = 'Pending' AND lock_by IS NULL;
CREATE INDEX idx_jobs_running ON Jobs(run_at) WHERE status = 'Running';
CREATE INDEX idx_jobs_status_run_at ON Jobs(status, run_at);

INSERT INTO Workers (id, worker_type, storage_name, layers, last_seen, started_at)
VALUES ('flip-a', 'flip', 'SqliteStorage', '', 1790856000, 1790856000);
INSERT INTO Jobs (job, id, job_type, status, attempts, max_attempts, run_at, lock_at, lock_by, metadata, idempotency_key)
VALUES (CAST('{"job":"c-2","kind":"calibration"}' AS BLOB), '01M8BZ7RSDRWSK820DHYQMPS26', 'flip', 'Running', 1, 1, 1790856000, 1790856000, 'flip-a', '{}', 'job:c-2:3'),
       (CAST('{"job":"t-1","kind":"training"}' AS BLOB), '01M8BZ7RSDRWSK820DHYQMPS27', 'flip', 'Pending', 0, 1, 1790856000, NULL, NULL, '{}', 'job:t-1:0');
INSERT INTO _sqlx_migrations (version, description, installed_on, success, checksum, execution_time)
VALUES (20220530084123, 'jobs workers', '2026-10-02 00:00:00', TRUE, x'b19ec23f8b3cc6bf58cf007de25caf8e1dc56c4d2f859eb16e5705a3d7daf7c7617488febca4176711315af15db30cc6', 0),
       (20250313213411, 'add job priority', '2026-10-02 00:00:00', TRUE, x'9835686824b5d2c0d731251db2abe438385f4b0c9b1394d80e232cb3c07e9fe9c968e3907312bc96847431907870f583', 0),
       (20251013233016, 'stats indexes', '2026-10-02 00:00:00', TRUE, x'f35935a093cba646f77d20a11fc49f5ddfc513747e33ae7bd17b6312536e4ba685a6196e1d7cba5ec19af540ada41b06', 0),
       (20251017150712, 'rename last error', '2026-10-02 00:00:00', TRUE, x'a7330edf1c6d2e41491a2d60e0cc23482e1db8dd26f490937ba1c73059205a1ff285b9044e1b7fc8b5abd1e0cdd6e4a0', 0),
       (20251017162501, 'worker started at', '2026-10-02 00:00:00', TRUE, x'5a7728698fe2e0d252b2c5d463f94a19bb1732dfac113e5119dfb91ee71a7de208bd56d535418c9e6a59e58caecabc4f', 0),
       (20251018162501, 'metadata', '2026-10-02 00:00:00', TRUE, x'93d306ba6e3197ee989f8055331770e9124dd89e0550d57227ff3f1a721d0aece2e961a61a288f7bddf665f819a85d4d', 0),
       (20251018164941, 'move to bytes', '2026-10-02 00:00:00', TRUE, x'f8a0946bc4deaec4af175cd2d8e797c93e56024d6c09d4878d30270601e161dc2c36c171f4f4895e2a43b63672596fb3', 0),
       (20260506101935, 'idempotency key', '2026-10-02 00:00:00', TRUE, x'6952899955188ad49c73728e3a38673701e6865d4701cf5646d54e6b89e668c63dc2b3c032060557d1682688bb582890', 0),
       (20260726081359, 'add fetch next indices', '2026-10-02 00:00:00', TRUE, x'fbc86be95fcb5041f9282274bc2a4c69bb07315271d7389efc508eba5f14ed7079ff2d08f62423aa70bf0bcec30ec4cf', 0),
       (20260803223031, 'add lock indices', '2026-10-02 00:00:00', TRUE, x'828c9c27b34a398f2c45a91f4b0c04e56956a36ffc2ef57156d1b9d07441c899c510bc62ac046149674a23ca99155a10', 0),
       (20260804103122, 'drop unneeded indices', '2026-10-02 00:00:00', TRUE, x'9148867e3e96ad9dc30083c465ae061ac20e05b20303dd7585fae574fa27a5199b52d178a26314449e562b1cf26ceeb8', 0);
