"""Copies the one weighing and the one job of a data folder many times over: `page_report_rows.py FOLDER WEIGHINGS JOBS`."""

import sqlite3
import sys
from pathlib import Path

folder, weighings, jobs = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
store = sqlite3.connect(folder / "flip.db", timeout=60)
# SQLite before 3.45 takes no null for JSON.
store.execute("PRAGMA ignore_check_constraints = on")
NUMBERS = "WITH RECURSIVE k (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM k WHERE n < ?)"
# A row a minute, the last one now; a fixed mixture of everything that can be asked for.
store.execute(
    NUMBERS
    + """
    INSERT INTO weighing (id, idempotency_key, request_sha256, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg,
        policy, parameter_set, seed, state, outcome, dispensed_mg, reading_mg, error_mg, shakes, seconds, bench, asked,
        created_at, started_at, finished_at)
    SELECT printf('w%06d', n), printf('w%06d', n), request_sha256,
        CASE n % 4 WHEN 0 THEN 'salt' WHEN 1 THEN 'sand' WHEN 2 THEN 'sugar' ELSE 'semolina' END,
        5 + n * 7 % 16, 1, 1, policy, parameter_set, n, 'done',
        CASE n * 13 % 10 WHEN 0 THEN 'over' WHEN 1 THEN 'under' ELSE 'within' END,
        5 + n * 7 % 16 + (n * 31 % 4000 - 2000) / 1000.0, 5 + n * 7 % 16 + (n * 31 % 4000 - 2000) / 1000.0,
        (n * 31 % 4000 - 2000) / 1000.0, 5 + n % 25, 40 + n * 17 % 90, 'emulated',
        json_object('lot', 'L' || (n * 11 % 50), 'vial', 'V' || n,
            'operator', CASE n % 3 WHEN 0 THEN 'Ada' WHEN 1 THEN 'Bo' ELSE 'Cy' END),
        created_at - (?1 - n) * 60000, created_at - (?1 - n) * 60000, created_at - (?1 - n) * 60000
    FROM k, (SELECT * FROM weighing LIMIT 1)""",
    (weighings,),
)
store.execute(
    NUMBERS
    + """
    INSERT INTO job (id, kind, spec, spec_sha256, state, fraction, result, created_at, started_at, finished_at)
    SELECT printf('j%05d', n), kind, spec, randomblob(32), state, fraction, result, created_at, started_at, finished_at
    FROM k, (SELECT * FROM job WHERE state = 'succeeded' LIMIT 1)""",
    (jobs,),
)
store.commit()
print(*(store.execute(f"SELECT count(*) FROM {table}").fetchone()[0] for table in ("weighing", "job")))
