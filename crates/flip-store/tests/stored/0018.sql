INSERT INTO token (seq, id, name, role, sha256, created_at, expires_at, revoked_at, last_used_at, may_clear)
VALUES (5, 'tk-5', 'for a day', 'operator', x'51a449a0fd6d4608bf5497ec8ad798872a0f01611b2d408ec75cbea83f4c9bf4', 1792324800000, 1792411200000, 1792324800005, 1792324800004, 1);
