-- The graphics card of a process that computes jobs, as it is called; null without one.
ALTER TABLE worker ADD COLUMN card TEXT COLLATE "C";
