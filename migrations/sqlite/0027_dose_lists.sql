-- The weighings of a list of doses.
CREATE INDEX weighing_by_list ON weighing (asked ->> 'list', seq);
