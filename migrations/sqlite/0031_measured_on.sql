-- The day of a measurement, as far as known; `created_at` is when it was registered.
ALTER TABLE measurement ADD COLUMN measured_on TEXT CHECK (measured_on GLOB '[0-9][0-9][0-9][0-9]-[0-9][0-9]-[0-9][0-9]');
ALTER TABLE observation ADD COLUMN measured_on TEXT CHECK (measured_on GLOB '[0-9][0-9][0-9][0-9]-[0-9][0-9]-[0-9][0-9]');
