INSERT INTO evaluation_row (evaluation, position, policy, powder, n, mae_mg, body, under)
VALUES ('e-1', 2, 'p-1', 'salt', 5, 0.5, '{"controller":"paced","powder":"salt","target_mg":10.0,"n":5,"mae_mg":0.5,"sd_mg":0.25,"bias_mg":-0.1,"over_share":0.0,"zero_share":0.2,"shakes_mean":12.0}', '{"simulator":"sv-0123456789abcdef"}'),
       ('e-1', 3, 'p-2', 'salt', 5, 0.25, '{"controller":"policy","powder":"salt","target_mg":10.0,"n":5,"mae_mg":0.25,"sd_mg":0.25,"bias_mg":-0.1,"over_share":0.0,"zero_share":0.2,"shakes_mean":12.0}', '{"simulator":"sv-0123456789abcdef"}');
