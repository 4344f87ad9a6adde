-- What callers write on weighings and jobs so that their own programs find them: values by key. NULL: nothing.
ALTER TABLE weighing ADD COLUMN labels TEXT CHECK (json_valid(labels));
ALTER TABLE job ADD COLUMN labels TEXT CHECK (json_valid(labels));
