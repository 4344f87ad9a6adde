INSERT INTO simulator_version (seq, id, base, investigation, body, created_at)
VALUES (1, 'sv-0123456789abcdef', 'pbd-3', 'i-1', '{"extensions":[]}', 1791720000000);
