INSERT INTO job (seq, id, kind, spec, spec_sha256, state, fence, attempts, failures, deaths, owner, lease_until, cancel_requested, fraction, message, checkpoint, result, error, created_at, started_at, finished_at)
VALUES (15, 'r-1', 'repose', '{"repose":{"powder":"chalk"}}', x'0ed72e58aa7d643b1b9f8e682e7d4cce559752cb8cd787a9eeece21fde414f71', 'succeeded', 1, 1, 0, 0, NULL, NULL, 0, 1.0, 'done', NULL, '{"piles":1}', NULL, 1792065600015, 1792065600001, 1792065600002);
INSERT INTO pile (seq, job, number, body)
VALUES (1, 'r-1', 1, '{"number":1,"at":"2026-10-15T12:00:00Z","measured":null,"refusal":"no flank","frames":[]}');
