INSERT INTO observation (seq, id, powder, body, source, created_at)
VALUES (1, 'o-1', 'salt', '{"observable":{"kind":"flow_time","mass_g":50.0,"orifice_mm":2.54},"mean":31.5,"sd":0.4,"n":3}', 'by hand', 1791460800000);
