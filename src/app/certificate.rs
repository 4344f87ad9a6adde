//! The certificate of a weighing: a self-contained page to print.
//!
//! It states what was measured and where the record of it is; it claims no compliance with
//! anything.

use super::document::page;
use super::{App, Error, Result, WeighingDetail};
use flip_core::domain::weighing::{MeasuredMass, Outcome};
use flip_store::audit::AuditRecord;
use flip_store::weighings::Weighing;
use maud::{Markup, html};

const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:46rem;padding:0 1rem;color:#111;background:#fff}\
h1{font-size:1.4rem;margin:0}h2{font-size:1rem;margin:1.6rem 0 .3rem}table{border-collapse:collapse;width:100%}\
th,td{text-align:left;padding:.25rem .6rem .25rem 0;border-bottom:1px solid #ddd;vertical-align:top}th{font-weight:500;width:42%}\
.big{font-size:1.9rem;margin:.6rem 0}.warn{border-left:4px solid #b00;padding:.3rem .8rem;margin:.8rem 0}\
code{font-size:.8rem;word-break:break-all}footer{margin-top:2rem;font-size:.8rem;color:#555}@media print{body{margin:0}}";

impl App {
    /// The certificate of a weighing that has ended.
    ///
    /// # Errors
    /// `NotFound`; `Conflict` (`weighing_unfinished`, or `not_a_dose` for a probing run).
    pub async fn certificate(&self, id: &str) -> Result<String> {
        let mut detail = self.weighing(id).await?;
        if detail.weighing.outcome.is_none() {
            let advice =
                format!("weighing {id} has not ended: its certificate can be printed once it has");
            return Err(Error::conflict("weighing_unfinished", advice));
        }
        if detail.weighing.asked.probe.is_some() {
            let advice = format!(
                "{id} probed a powder and weighed no dose, so there is nothing to certify: GET /v1/powders/{}/card has what it found",
                detail.weighing.powder
            );
            return Err(Error::conflict("not_a_dose", advice));
        }
        let mut record = Recorded::default();
        match self.outcome_on_record(id).await? {
            // From the record rather than the row: anyone with access to the file can change the
            // row.
            Some(said) => detail.weighing = said,
            None => record.unrecorded = true,
        }
        self.export_audit(Some(id), |it| record.add(it)).await?;
        Ok(certificate(&detail, &record))
    }

    /// The recorded outcome of a weighing that has ended; `None` for weighings that predate the
    /// record.
    async fn outcome_on_record(&self, id: &str) -> Result<Option<Weighing>> {
        let row =
            self.store().weighing(id).await?.ok_or_else(|| Error::not_found("weighing", id))?;
        match self.store().outcome_on_record(&row).await? {
            (None, said) => Ok(said),
            (Some(changed), _) => {
                let advice = format!(
                    "weighing {id} is not certified: {}. `flip audit verify` checks the whole record; a backup may hold what was written",
                    changed.why
                );
                Err(Error::conflict("record_differs", advice))
            }
        }
    }
}

/// Audit information on the certificate.
#[derive(Default)]
struct Recorded {
    records: usize,
    last: Option<AuditRecord>,
    /// The requester, by token.
    asked_by: Option<String>,
    /// It ended before there was an audit trail.
    unrecorded: bool,
    /// Errors in archives that held some of the records.
    lost: Vec<String>,
}

impl Recorded {
    fn add(&mut self, record: &AuditRecord) {
        if record.kind == "lost" {
            self.lost.extend(record.body["why"].as_str().map(str::to_owned));
            return;
        }
        self.records += 1;
        self.last = Some(record.clone());
        if record.kind == "intent" {
            let text = |field: &str| record.body["who"][field].as_str();
            self.asked_by = text("name").map(|name| match text("role") {
                Some(role) => format!("{name} ({role})"),
                None => name.to_owned(),
            });
        }
    }

    fn rows(&self) -> Vec<(&'static str, String)> {
        let mut rows = vec![("Records of this weighing", self.records.to_string())];
        rows.extend(self.last.iter().flat_map(|last| {
            [
                ("Last record", format!("{} of {}", last.seq, last.at)),
                ("Hash up to that record", last.hash.clone()),
            ]
        }));
        rows.extend(self.asked_by.iter().map(|who| ("Requested with the token of", who.clone())));
        rows
    }
}

/// The page; the same weighing always gives the same bytes.
fn certificate(detail: &WeighingDetail, record: &Recorded) -> String {
    let weighing = &detail.weighing;
    let body = html! {
        h1 { "Weighing certificate" }
        p.big { (result(weighing)) }
        @for warning in all_warnings(detail, record) { p.warn { (warning) } }
        (section("Request", &asked(weighing)))
        (section("Result", &measured(weighing)))
        (section("Provenance", &provenance(weighing)))
        (section("Record", &record.rows()))
        footer {
            "Made by FLIP " (env!("CARGO_PKG_VERSION")) ". It states what was measured and recorded; "
            "it does not claim compliance with any regulation. "
            "`flip audit verify --hash HASH` checks the record."
        }
    };
    page(&format!("Weighing {} · FLIP", weighing.id), STYLE, None, &body)
}

fn section(title: &str, rows: &[(&str, String)]) -> Markup {
    html! {
        @if !rows.is_empty() {
            h2 { (title) }
            table { @for (name, value) in rows { tr { th scope="row" { (name) } td { (value) } } } }
        }
    }
}

/// The net mass with its uncertainty, or a statement that there is none.
fn result(weighing: &Weighing) -> String {
    let powder = &weighing.powder;
    match (&weighing.measured, weighing.reading_mg) {
        (Some(measured), _) => {
            format!(
                "{} mg ± {} mg of {powder}",
                digits(measured.net_mg),
                digits(measured.uncertainty_mg)
            )
        }
        (None, Some(reading_mg)) => {
            format!("{} mg of {powder}, by the final reading", digits(reading_mg))
        }
        (None, None) => format!("no mass of {powder} was measured"),
    }
}

/// Warnings about the dose and about its record.
fn all_warnings(detail: &WeighingDetail, record: &Recorded) -> Vec<String> {
    let mut all = warnings(&detail.weighing);
    all.extend(detail.trace_lost.clone());
    all.extend(record.lost.iter().map(|why| format!("Part of its record is lost: {why}.")));
    if record.unrecorded {
        all.push(
            "It ended before FLIP kept a record: nothing printed here can be verified.".to_owned(),
        );
    }
    all
}

/// Warnings about the dose.
fn warnings(weighing: &Weighing) -> Vec<String> {
    let mut all = Vec::new();
    let told = |outcome: Outcome| match outcome {
        Outcome::Within | Outcome::Probed => None,
        Outcome::Under => Some("The dose is below the target by more than the tolerance."),
        Outcome::Over => Some("The dose is above the target by more than the tolerance."),
        Outcome::NotStable => Some("The balance did not settle: do not rely on the mass."),
        Outcome::Blocked => Some("No more powder left the spoon."),
        Outcome::Stopped => Some("The weighing was stopped."),
        Outcome::Aborted => Some("The weighing was aborted."),
        Outcome::Unknown => {
            Some("The process ended during the weighing: the content of the vial is not known.")
        }
    };
    all.extend(weighing.outcome.and_then(told).map(str::to_owned));
    all.extend(weighing.error.clone());
    if let Some(measured) = &weighing.measured {
        if measured.proven == Some(false) {
            all.push(format!(
                "Not proven: with its uncertainty of {} mg, the net mass may lie on either side of a tolerance limit.",
                digits(measured.uncertainty_mg)
            ));
        }
        match (measured.below_minimum_weight, measured.minimum_mg) {
            (Some(true), Some(minimum)) => all.push(format!(
                "Below the minimum weight of this balance, {} mg at the required accuracy: not accurately weighed in the sense of USP <41>.",
                digits(minimum)
            )),
            (None, _) => all.push("The balance's repeatability was not checked, so its minimum weight is not known.".to_owned()),
            _ => {}
        }
        if !(measured.stable_by_balance && measured.stable_by_window) {
            all.push(
                "The last reading was not stable by both the balance's flag and FLIP's own window."
                    .to_owned(),
            );
        }
    }
    all
}

fn asked(weighing: &Weighing) -> Vec<(&'static str, String)> {
    let mut rows = vec![
        ("Powder", weighing.powder.clone()),
        ("Target", format!("{} mg", digits(weighing.target_mg))),
        (
            "Tolerance",
            format!(
                "-{} / +{} mg",
                digits(weighing.tolerance_lower_mg),
                digits(weighing.tolerance_upper_mg)
            ),
        ),
    ];
    let asked = &weighing.asked;
    let mut more = |name, value: Option<String>| rows.extend(value.map(|value| (name, value)));
    more("Lot", asked.lot.clone());
    more("Vial", asked.vial.clone());
    more("Requested by", asked.operator.clone());
    more("Temperature", asked.temperature_c.map(|c| format!("{c} °C")));
    more("Relative humidity", asked.relative_humidity_pct.map(|pct| format!("{pct} %")));
    more("Required accuracy", asked.accuracy_pct.map(|pct| format!("{pct} %")));
    rows
}

fn measured(weighing: &Weighing) -> Vec<(&'static str, String)> {
    let mut rows = vec![("Outcome", outcome(weighing))];
    let Some(it) = &weighing.measured else { return rows };
    let mg = |value: Option<f64>| {
        value.map_or_else(
            || "not reported by the balance".to_owned(),
            |mg| format!("{} mg", digits(mg)),
        )
    };
    rows.extend([
        ("Gross", mg(it.gross_mg)),
        ("Tare", mg(it.tare_mg)),
        ("Zero after the tare", mg(it.zero_mg)),
        ("Net", format!("{} mg", digits(it.net_mg))),
        ("Expanded uncertainty (k = 2)", format!("{} mg", digits(it.uncertainty_mg))),
        (
            "Minimum weight",
            it.minimum_mg.map_or_else(
                || "not known: no repeatability check".to_owned(),
                |mg| format!("{} mg", digits(mg)),
            ),
        ),
        (
            "Stable by the balance / by FLIP's window",
            format!("{} / {}", yes(it.stable_by_balance), yes(it.stable_by_window)),
        ),
    ]);
    rows.extend(
        weighing.error_mg.map(|mg| ("Error (net minus target)", format!("{} mg", digits(mg)))),
    );
    rows.extend(drift(it));
    rows.extend(weighing.shakes.map(|n| ("Shakes", n.to_string())));
    rows.extend(weighing.seconds.map(|s| ("Time on the bench", format!("{s:.1} s"))));
    let thrown = it.discarded_mg.iter().map(|mg| digits(*mg)).collect::<Vec<_>>().join(", ");
    rows.extend((!thrown.is_empty()).then_some(("Discarded before, mg", thrown)));
    rows
}

fn drift(it: &MeasuredMass) -> Option<(&'static str, String)> {
    let (before, after) = (it.drift_before_mg_min?, it.drift_after_mg_min?);
    Some(("Drift before / after", format!("{} / {} mg/min", digits(before), digits(after))))
}

fn provenance(weighing: &Weighing) -> Vec<(&'static str, String)> {
    let mut rows = vec![("Weighing", weighing.id.clone()), ("Policy", weighing.policy.clone())];
    rows.push((
        "Simulator",
        weighing.under.as_ref().map_or_else(|| "base".to_owned(), |under| under.simulator.clone()),
    ));
    if let Some(measured) = &weighing.measured {
        let named = |(role, name): (&String, &String)| format!("{role}: {name}");
        rows.push(("Devices", measured.devices.iter().map(named).collect::<Vec<_>>().join("; ")));
    }
    rows.push(("Request recorded", weighing.created_at.to_string()));
    rows.extend(weighing.started_at.map(|at| ("Armed", at.to_string())));
    rows.extend(weighing.finished_at.map(|at| ("Ended", at.to_string())));
    rows
}

fn word(outcome: Outcome) -> String {
    serde_json::to_value(outcome)
        .ok()
        .and_then(|value| value.as_str().map(|word| word.replace('_', " ")))
        .unwrap_or_default()
}

/// The outcome, and whether it is proven.
fn outcome(weighing: &Weighing) -> String {
    let outcome = weighing.outcome.map(word).unwrap_or_default();
    let is_proven = weighing.measured.as_ref().and_then(|measured| measured.proven);
    if is_proven == Some(false) { format!("{outcome}, not proven") } else { outcome }
}

fn yes(is: bool) -> &'static str {
    if is { "yes" } else { "no" }
}

/// Rounded to a hundredth, without trailing zeros.
fn digits(value: f64) -> String {
    let text = format!("{value:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::super::document::hostile::assert_inert;
    use super::*;
    use serde_json::{Value, json};

    fn page(weighing: Value) -> String {
        page_of(weighing, &Recorded::default())
    }

    fn page_of(weighing: Value, record: &Recorded) -> String {
        let mut all = json!({
            "id": "w", "powder": "salt", "target_mg": 10.0, "tolerance_lower_mg": 1.0, "tolerance_upper_mg": 1.0, "policy": "p",
            "parameter_set": "ps", "seed": 1, "state": "done", "outcome": "within", "dispensed_mg": 8.2, "reading_mg": 9.3, "error_mg": -0.7,
            "shakes": 3, "seconds": 40.0, "error": null, "created_at": "2026-11-26T01:00:00.000Z", "started_at": null, "finished_at": null,
        });
        let (Value::Object(all_fields), Value::Object(fields)) = (&mut all, weighing) else {
            panic!("objects")
        };
        all_fields.extend(fields);
        let weighing = serde_json::from_value(all).unwrap();
        let detail = WeighingDetail { weighing, ticks: Vec::new(), trace_lost: None };
        certificate(&detail, record)
    }

    fn measured(proven: bool) -> Value {
        let of = json!({ "tare_mg": 12000.0, "gross_mg": 12009.3, "net_mg": 9.3, "uncertainty_mg": 0.9, "proven": proven,
            "stable_by_balance": true, "stable_by_window": true });
        json!({ "measured": of })
    }

    #[test]
    fn a_certificate_says_what_is_not_proven_and_its_error_is_that_of_the_reading() {
        let (open, proven) = (page(measured(false)), page(measured(true)));
        assert!(
            open.contains("within, not proven")
                && open.contains("Not proven: with its uncertainty of 0.9 mg"),
            "{open}"
        );
        assert!(
            open.contains("9.3 mg ± 0.9 mg") && open.contains("-0.7 mg") && !open.contains("8.2"),
            "{open}"
        );
        assert!(!proven.to_lowercase().contains("not proven"), "{proven}");
    }

    #[test]
    fn no_name_on_a_certificate_is_markup() {
        assert_inert(|name| {
            let mut all = measured(false);
            all["measured"]["devices"] = json!({ "balance": name });
            for field in ["id", "powder", "policy", "error"] {
                all[field] = name.into();
            }
            for field in ["lot", "vial", "operator"] {
                all["asked"][field] = name.into();
            }
            let record = Recorded {
                asked_by: Some(name.to_owned()),
                lost: vec![name.to_owned()],
                ..Recorded::default()
            };
            page_of(all, &record)
        });
    }

    #[test]
    fn an_aborted_dose_has_no_mass_on_its_certificate() {
        let cause = "the arm stopped; the balance last showed 4 mg, which does not say what lies in the vial";
        let gone = json!({ "state": "aborted", "outcome": "aborted", "reading_mg": null, "error_mg": null, "error": cause });
        let page = page(gone);
        assert!(
            page.contains("no mass of salt was measured")
                && page.contains(cause)
                && !page.contains("0 mg of salt"),
            "{page}"
        );
    }
}
