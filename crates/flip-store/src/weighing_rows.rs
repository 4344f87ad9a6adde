//! Rows of weighings, as they are read.

use super::Result;
use super::benches::DEFAULT_BENCH;
use super::row::Columns;
use super::weighings::{Weighing, WeighingRow};
use sqlx::any::AnyRow;

pub(super) fn weighing_row(row: &AnyRow) -> Result<WeighingRow> {
    let weighing = weighing(row)?;
    let patch: Option<serde_json::Value> = row.maybe_json("patch")?;
    Ok(WeighingRow {
        patch_is_ours: patch
            == (!weighing.patch.is_none()).then(|| serde_json::json!(weighing.patch)),
        weighing,
        idempotency_key: row.plain("idempotency_key")?,
        request_sha256: row.plain("request_sha256")?,
        trace: row.plain("trace")?,
    })
}

pub(super) fn weighing(row: &AnyRow) -> Result<Weighing> {
    let shakes: Option<i64> = row.plain("shakes")?;
    Ok(Weighing {
        id: row.plain("id")?,
        powder: row.plain("powder")?,
        target_mg: row.plain("target_mg")?,
        tolerance_lower_mg: row.plain("tolerance_lower_mg")?,
        tolerance_upper_mg: row.plain("tolerance_upper_mg")?,
        policy: row.plain("policy")?,
        parameter_set: row.plain("parameter_set")?,
        seed: row.plain::<i64>("seed")?.cast_unsigned(),
        under: row.maybe_json("under")?,
        patch: row.maybe_json("patch")?.unwrap_or_default(),
        asked: row.maybe_json("asked")?.unwrap_or_default(),
        labels: row.maybe_json("labels")?.unwrap_or_default(),
        vial_check: row.maybe_word("weighing", "vial_check")?.unwrap_or_default(),
        bench: row.maybe_word("weighing", "bench")?,
        bench_name: row.maybe_plain("bench_name").filter(|name: &String| name != DEFAULT_BENCH),
        state: row.word("weighing", "state")?,
        outcome: row.maybe_word("weighing", "outcome")?,
        dispensed_mg: row.plain("dispensed_mg")?,
        reading_mg: row.plain("reading_mg")?,
        error_mg: row.plain("error_mg")?,
        shakes: shakes.and_then(|n| u32::try_from(n).ok()),
        seconds: row.plain("seconds")?,
        measured: row.maybe_json("measured")?,
        apparatus: row.maybe_json("apparatus")?,
        error: row.plain("error")?,
        created_at: row.time("created_at")?,
        started_at: row.maybe_time("started_at")?,
        finished_at: row.maybe_time("finished_at")?,
    })
}
