-- Who logged in with an account of the lab: the provider, and its name for the person, which never changes.
ALTER TABLE token ADD COLUMN issuer TEXT;
ALTER TABLE token ADD COLUMN subject TEXT;
