-- The job table is the queue. What the library that used to deliver jobs left here goes: its two tables, which named jobs and held nothing else,
-- and its own migrations.
DROP TABLE IF EXISTS Jobs;
DROP TABLE IF EXISTS Workers;
DELETE FROM _sqlx_migrations WHERE version >= 20000000000000;
