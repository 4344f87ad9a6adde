INSERT INTO policy (seq, id, kind, training, manifest, bytes, sha256, created_at)
VALUES (1, 'p-1', 'paced', NULL, '{"kind":"paced"}', x'706f6c696379', '823412d1eacb67956220e532959f0104603057c88704863ca38e7cd188fda812', 1791115200000),
       (2, 'p-2', 'actor', 't-1', '{"kind":"actor","seed":1}', x'00ff', '06eb7d6a69ee19e5fbdf749018d3d2abfa04bcbd1365db312eb86dc7169389b8', 1791115200001);
INSERT INTO dose (job, key, body)
VALUES ('e-1', 'paced/salt/10/0', '{"dispensed_mg":9.5}');
INSERT INTO evaluation_row (evaluation, position, policy, powder, n, mae_mg, body)
VALUES ('e-1', 0, 'p-1', 'salt', 5, 0.5, '{"controller":"policy","powder":"salt","target_mg":10.0,"n":5,"mae_mg":0.5,"sd_mg":0.25,"bias_mg":-0.1,"over_share":0.0,"zero_share":0.2,"shakes_mean":12.0}'),
       ('e-1', 1, NULL, 'chalk', 5, 2.0, '{"controller":"fixed","powder":"chalk","target_mg":10.0,"n":5,"mae_mg":2.0,"sd_mg":0.25,"bias_mg":-0.1,"over_share":0.0,"zero_share":0.2,"shakes_mean":12.0}');
