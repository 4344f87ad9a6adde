INSERT INTO current_simulator (seq, version, chosen_at)
VALUES (1, 'sv-0123456789abcdef', 1791806400000),
       (2, NULL, 1791806400001);
