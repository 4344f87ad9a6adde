INSERT INTO probe (owner, position, body)
VALUES ('em-0123456789abcdef', 0, '{"seconds":31.0}');
