-- A list of 100 000 weighings is found by what people ask for.
CREATE INDEX weighing_by_powder ON weighing (powder, seq);
CREATE INDEX weighing_by_outcome ON weighing (outcome, seq);
CREATE INDEX weighing_by_lot ON weighing (asked ->> 'lot', seq);
CREATE INDEX weighing_by_vial ON weighing (asked ->> 'vial', seq);
CREATE INDEX weighing_by_operator ON weighing (asked ->> 'operator', seq);
CREATE INDEX weighing_by_error ON weighing (coalesce(abs(error_mg), -1), seq);
CREATE INDEX weighing_by_created ON weighing (created_at);
