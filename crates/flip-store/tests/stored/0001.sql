INSERT INTO powder (seq, id, name, created_at)
VALUES (1, 'salt', 'Salt', 1790856000000),
       (3, 'chalk', 'Chalk, ''fine''', 1790856000001);
INSERT INTO measurement (seq, id, powder, method, repose_deg, sd_deg, n, source, created_at)
VALUES (1, 'm-1', 'salt', 'automated', 36.03, 2.29, 5, 'table', 1790856000000),
       (2, 'm-2', 'salt', 'manual', 37.0, 0.0, 1, '', 1790856000002),
       (5, 'm-5', 'chalk', 'manual', 52.5, 1.25, 3, 'by hand', 1790856000003);
