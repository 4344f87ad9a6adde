-- The version of the simulator that a row is evidence for, with its conditions; none is the base.
ALTER TABLE evaluation_row ADD COLUMN under TEXT CHECK (json_valid(under));
