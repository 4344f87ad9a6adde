-- Whether a powder dissolves in the water it takes up from humid air: 1 or 0, NULL where nobody said.
ALTER TABLE powder ADD COLUMN soluble INTEGER CHECK (soluble IN (0, 1));

DROP VIEW powder_now;
CREATE VIEW powder_now AS
SELECT p.seq, p.id, p.name, p.created_at, p.soluble, m.repose_deg, m.sd_deg, m.n
FROM powder p LEFT JOIN measurement m ON m.seq = (
    SELECT seq FROM measurement WHERE powder = p.id ORDER BY method = 'automated' DESC, seq DESC LIMIT 1
);
