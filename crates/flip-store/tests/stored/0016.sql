INSERT INTO weighing (seq, id, idempotency_key, request_sha256, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, policy, parameter_set, seed, state, outcome, dispensed_mg, reading_mg, error_mg, shakes, seconds, trace, error, created_at, started_at, finished_at, bench, asked, measured, vial_check)
VALUES (8, 'w-8', 'key 8', x'b61bae2c1c5d192e6b0d6bb456688fac0b1ca66b950d1dcac7d32db316ad39eb', 'salt', 18.0, 1.0, 0.5, 'p-1', 'ps-e401c642e771fe5f', 8, 'awaiting_vial', NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL, 1792152000000, NULL, NULL, NULL, '{"lot":"L1","vial":"v-8","operator":"Ada","on_overdose":{"action":"discard_and_retry","max":2}}', NULL, 'confirm'),
       (9, 'w-9', 'key 9', x'01de42bc98706a85710c5316db05558ebdc0191c0c0fa1680b41fc5b0f7720d4', 'salt', 19.0, 1.0, 0.5, 'p-1', 'ps-e401c642e771fe5f', 9, 'dosing', NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL, 1792152000000, 1792152000001, NULL, 'devices', NULL, NULL, 'skip');
INSERT INTO latch (seq, at, reason, weighing, cleared_at, cleared_by, note, bench)
VALUES (2, 1792152000002, 'a vial fell', NULL, NULL, NULL, NULL, 'devices');
INSERT INTO bench_hold (seq, at, reason, held_by, resumed_at, resumed_by, note)
VALUES (1, 1792152000003, 'stopped', 'Ada', 1792152000004, 'Ben', 'goes on'),
       (2, 1792152000005, 'restored', NULL, NULL, NULL, NULL);
INSERT INTO bench_pan (one, body)
VALUES (1, '{"vial":null,"zero_mg":1000.5,"shown_mg":16.0,"empties_mg":[1000.25]}');
INSERT INTO bench_reservation (one, id, owner, until)
VALUES (1, 'rs-1', 'Ada', 1792152000006);
INSERT INTO audit (seq, at, weighing, kind, body, hash)
VALUES (7, 1792152000000, 'w-8', 'intent', '{"id":"w-8","powder":"salt","target_mg":18.0,"tolerance_lower_mg":1.0,"tolerance_upper_mg":0.5,"policy":"p-1","parameter_set":"ps-e401c642e771fe5f","seed":8,"asked":{"lot":"L1","vial":"v-8","operator":"Ada","on_overdose":{"action":"discard_and_retry","max":2}},"state":"planned","outcome":null,"dispensed_mg":null,"reading_mg":null,"error_mg":null,"shakes":null,"seconds":null,"error":null,"created_at":"2026-10-16T12:00:00Z","started_at":null,"finished_at":null,"idempotency_key":"key 8","request_sha256":"b61bae2c1c5d192e6b0d6bb456688fac0b1ca66b950d1dcac7d32db316ad39eb"}', '042432fd1deba133ee45a809212cc9497f987afcb07a583c0897d6ef676992dc'),
       (8, 1792152000001, 'w-9', 'intent', '{"id":"w-9","powder":"salt","target_mg":19.0,"tolerance_lower_mg":1.0,"tolerance_upper_mg":0.5,"policy":"p-1","parameter_set":"ps-e401c642e771fe5f","seed":9,"vial_check":"skip","state":"planned","outcome":null,"dispensed_mg":null,"reading_mg":null,"error_mg":null,"shakes":null,"seconds":null,"error":null,"created_at":"2026-10-16T12:00:00Z","started_at":null,"finished_at":null,"idempotency_key":"key 9","request_sha256":"01de42bc98706a85710c5316db05558ebdc0191c0c0fa1680b41fc5b0f7720d4"}', '7d1c62745f4162f6e0b61e969a00da979bf85d5ef5de46805450a8d015d8c1bc');
