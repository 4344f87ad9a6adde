-- Tokens end: on a day, or when a person revokes them. Revoked ones stay, because records name them.
ALTER TABLE token ADD COLUMN expires_at INTEGER CHECK (expires_at >= 0);
ALTER TABLE token ADD COLUMN revoked_at INTEGER CHECK (revoked_at >= 0);
-- Written now and then, not at every request.
ALTER TABLE token ADD COLUMN last_used_at INTEGER CHECK (last_used_at >= 0);
-- Whether its holder may clear a latched bench; an admin always may.
ALTER TABLE token ADD COLUMN may_clear INTEGER NOT NULL DEFAULT 0 CHECK (may_clear IN (0, 1));
-- Who has the token of the first start has the whole data folder; until now it was an operator's.
UPDATE token SET may_clear = 1 WHERE role = 'admin' OR name = 'first start';
