INSERT INTO powder (seq, id, name, created_at, soluble)
VALUES (21, 'fines', 'Quartz fines', 1792584000000, 0),
       (22, 'brine', 'Salt of the sea', 1792584000001, 1);
