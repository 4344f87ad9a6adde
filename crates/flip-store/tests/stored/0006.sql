INSERT INTO event (seq, topic, kind, data, at)
VALUES (4, 'job:c-1', 'state', '{"id":"c-1"}', 1791288000000),
       (7, 'weighing:w-1', 'tick', '{"step":1}', 1791288000001);
INSERT INTO token (seq, id, name, role, sha256, created_at)
VALUES (1, 'tk-1', 'first start', 'operator', x'5485cb5d03981cc3bd989290a6be33ca392c013279a5c3c3fd10a1cae57e1460', 1791288000000),
       (2, 'tk-2', 'Ada', 'admin', x'ded6c02a4bc1fb712f3b71efcb883ad5b31f4cef6a327b079573143ec9c71fb3', 1791288000001),
       (4, 'tk-4', 'page', 'viewer', x'c8ce10bdf3f64984a2bb9e3b0535ce13f8bc0b62716428944ac4bdeb2c158bd1', 1791288000002);
