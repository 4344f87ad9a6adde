-- The version of the simulator at whose reference a set was calibrated; none is the base, whose sets stay apart.
ALTER TABLE parameter_set ADD COLUMN simulator TEXT REFERENCES simulator_version (id);

-- The version on the simulated bench with its conditions, and what they change about the powder; none is the base.
ALTER TABLE weighing ADD COLUMN under TEXT CHECK (json_valid(under));
ALTER TABLE weighing ADD COLUMN patch TEXT CHECK (json_valid(patch));
