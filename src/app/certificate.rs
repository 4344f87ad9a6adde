//! The certificate of a weighing: a self-contained page to print.
//!
//! It states what was measured and where the record of it is; it claims no compliance with
//! anything.

mod curve;
mod list;
mod rows;
mod words;

use super::document::page;
use super::{App, AuditAsked, Error, Result, WeighingDetail};
use curve::curve;
use flip_store::audit::AuditRecord;
use flip_store::page::{LIST_LIMIT_MAX, PageQuery};
use flip_store::weighing_search::{WeighingSort, WeighingsWanted};
use flip_store::weighings::Weighing;
use list::certificate_of_all;
use maud::{Markup, html};
use rows::{asked, measured, provenance};
use words::{not_real, result, warnings};

const STYLE: &str = include_str!("certificate/style.css");

impl App {
    /// The certificate of a weighing that has ended, with the name of a laboratory; `None`: that of
    /// the service, or a line to write it on.
    ///
    /// # Errors
    /// `NotFound`; `Conflict` (`weighing_unfinished`, or `not_a_dose` for a probing run).
    pub async fn certificate(&self, id: &str, laboratory: Option<&str>) -> Result<String> {
        let (detail, unrecorded) = self.ended_dose(id).await?;
        let mut record = Recorded { unrecorded, ..Recorded::default() };
        self.export_audit(AuditAsked::of(id), |it| record.add(it)).await?;
        Ok(certificate(&detail, &record, laboratory.or(self.laboratory())))
    }

    /// A dose that has ended, as the record has it: anyone with access to the file can change its
    /// row. `true`: it predates the record.
    ///
    /// # Errors
    /// `NotFound`; `Conflict` (`weighing_unfinished`, `not_a_dose` for a probing run,
    /// `record_differs`).
    pub(super) async fn ended_dose(&self, id: &str) -> Result<(WeighingDetail, bool)> {
        let mut detail = self.weighing(id).await?;
        if detail.weighing.outcome.is_none() {
            let advice = format!("weighing {id} has not ended: ask again once it has");
            return Err(Error::conflict("weighing_unfinished", advice));
        }
        if detail.weighing.asked.probe.is_some() {
            let advice = format!(
                "{id} probed a powder and weighed no dose, so there is nothing to certify: GET /v1/powders/{}/card has what it found",
                detail.weighing.powder
            );
            return Err(Error::conflict("not_a_dose", advice));
        }
        let said = self.outcome_on_record(id).await?;
        let unrecorded = said.is_none();
        detail.weighing = said.unwrap_or(detail.weighing);
        Ok((detail, unrecorded))
    }

    /// The certificate of all doses of a list, which have ended.
    ///
    /// # Errors
    /// `NotFound`; `Conflict` (`weighing_unfinished`, `record_differs`).
    pub async fn list_certificate(&self, name: &str) -> Result<String> {
        let wanted = WeighingsWanted {
            list: Some(name.to_owned()),
            sort: WeighingSort::Oldest,
            ..WeighingsWanted::default()
        };
        let (mut found, mut page) = (Vec::new(), PageQuery::first(LIST_LIMIT_MAX).with_archived());
        loop {
            let window = page.window(LIST_LIMIT_MAX)?;
            let part = self.store().weighings_wanted(&wanted, window).await?.page;
            found.extend(part.items);
            let Some(next) = part.next else { break };
            page =
                PageQuery { after: Some(next), ..PageQuery::first(LIST_LIMIT_MAX).with_archived() };
        }
        if found.is_empty() {
            return Err(Error::not_found("list of doses", name));
        }
        let open = found.iter().filter(|weighing| weighing.outcome.is_none()).count();
        if open > 0 {
            let advice = format!(
                "{open} of the {} doses of `{name}` have not ended: the certificate can be printed once they have",
                found.len()
            );
            return Err(Error::conflict("weighing_unfinished", advice));
        }
        let mut doses = Vec::new();
        for row in found {
            let mut record = Recorded::default();
            let said = self.outcome_on_record(&row.id).await?;
            record.unrecorded = said.is_none();
            self.export_audit(AuditAsked::of(&row.id), |it| record.add(it)).await?;
            doses.push((said.unwrap_or(row), record));
        }
        Ok(certificate_of_all(name, &doses, self.laboratory()))
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
    /// Who stopped it, and when.
    stopped: Option<String>,
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
            self.asked_by = who(record);
        }
        if is_stop(record) && self.stopped.is_none() {
            let by = who(record).unwrap_or_else(|| "a person not known".to_owned());
            self.stopped = Some(format!("{by}, {}", record.at));
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

/// The person behind a record, by name and role.
fn who(record: &AuditRecord) -> Option<String> {
    let text = |field: &str| record.body["who"][field].as_str();
    text("name").map(|name| match text("role") {
        Some(role) => format!("{name} ({role})"),
        None => name.to_owned(),
    })
}

fn is_stop(record: &AuditRecord) -> bool {
    record.kind == "person" && record.body["action"] == "stop"
}

/// The page; the same weighing always gives the same bytes.
fn certificate(detail: &WeighingDetail, record: &Recorded, laboratory: Option<&str>) -> String {
    let weighing = &detail.weighing;
    let not_real = not_real(weighing.bench);
    let mut results = measured(weighing);
    results.extend(record.stopped.iter().map(|by| ("Stopped by", by.clone())));
    let body = html! {
        @if let Some((word, _)) = not_real { (mark(word)) }
        main {
            h1 { "Weighing certificate" }
            (heading(laboratory))
            p.big { (result(weighing)) }
            @if let Some((_, sentence)) = not_real { p.warn { (sentence) } }
            @for warning in all_warnings(detail, record) { p.warn { (warning) } }
            (section("Request", &asked(weighing)))
            (section("Result", &results))
            div.whole {
                h2 { "Mass over time" }
                @match curve(weighing, &detail.ticks) {
                    Some(curve) => (curve),
                    None => p { "No course is on record: the bench did not move, or the file with it is lost." },
                }
            }
            (section("Provenance", &provenance(weighing)))
            (section("Record", &record.rows()))
            (signatures(weighing.asked.operator.as_deref()))
            (footer(""))
        }
    };
    page(&format!("Weighing {} · FLIP", weighing.id), STYLE, None, &body)
}

/// A word across every sheet.
fn mark(word: &str) -> Markup {
    html! { div.mark aria-hidden="true" { span { (word) } } }
}

fn heading(laboratory: Option<&str>) -> Markup {
    html! { @if let Some(name) = laboratory { p.lab { (name) } } }
}

/// Where the people who answer for it sign.
fn signatures(operator: Option<&str>) -> Markup {
    html! {
        div.whole {
            h2 { "Signatures" }
            table.signed {
                thead { tr { @for title in ["Role", "Name", "Signature", "Date"] { th scope="col" { (title) } } } }
                tbody {
                    tr { th scope="row" { "Operator" } td { (operator.unwrap_or_default()) } td {} td {} }
                    tr { th scope="row" { "Reviewer" } td {} td {} td {} }
                }
            }
        }
    }
}

fn footer(more: &str) -> Markup {
    html! {
        footer {
            "Made by FLIP " (env!("CARGO_PKG_VERSION")) ". It states what was measured and recorded; "
            "it does not claim compliance with any regulation. "
            "`flip audit verify --hash HASH` checks the record" (more) "."
        }
    }
}

fn section(title: &str, rows: &[(&str, String)]) -> Markup {
    html! {
        @if !rows.is_empty() {
            div.whole {
                h2 { (title) }
                table { tbody { @for (name, value) in rows { tr { th scope="row" { (name) } td { (value) } } } } }
            }
        }
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

#[cfg(test)]
mod tests {
    use super::super::document::hostile::assert_inert;
    use super::*;
    use flip_core::domain::bench::{Action, Reading, Tick};
    use flip_core::domain::timestamp::Timestamp;
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
        let ticks = [0.0, 4.0, 9.3].iter().enumerate().map(|(k, mass_mg)| Tick {
            step: k as u32,
            t_s: 8.0 * k as f64,
            pitch_deg: 10.0,
            action: Action::once(0.0, 2.0),
            reading: Reading { mass_mg: *mass_mg, stable: true },
            spoonful: 1,
        });
        let detail =
            WeighingDetail { weighing, ticks: ticks.collect(), trace_lost: None, stopped: None };
        certificate(&detail, record, Some("Lab 7"))
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
                stopped: Some(name.to_owned()),
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

    #[test]
    fn what_is_not_real_is_marked_on_every_sheet_and_said_in_a_sentence() {
        for (bench, word) in [("simulated", "Simulated"), ("emulated", "Emulated")] {
            let page = page(json!({ "bench": bench }));
            assert!(page.contains(&format!("<span>{word}</span>")), "{page}");
            assert!(page.contains(&format!("{word}: no real powder was weighed")), "{page}");
        }
        let real = page(json!({ "bench": "devices" }));
        assert!(!real.contains("no real powder") && !real.contains("class=\"mark\""), "{real}");
    }

    #[test]
    fn a_certificate_has_a_laboratory_a_curve_and_room_for_two_signatures() {
        let page = page(json!({ "asked": { "operator": "Ada" } }));
        assert!(page.contains("<p class=\"lab\">Lab 7</p>"), "{page}");
        assert!(page.contains("Balance readings from 0 mg to 9.3 mg in 16 s"), "{page}");
        assert!(page.contains("<th scope=\"row\">Operator</th><td>Ada</td>"), "{page}");
        assert!(page.contains("<th scope=\"row\">Reviewer</th>"), "{page}");
    }

    #[test]
    fn the_first_stop_of_a_dose_is_on_its_certificate_with_the_person() {
        let stop = |name: &str, ms| AuditRecord {
            seq: ms,
            at: Timestamp::from_unix_ms(ms),
            weighing: Some("w".to_owned()),
            kind: "person".to_owned(),
            body: json!({ "action": "stop", "who": { "name": name, "role": "operator" } }),
            hash: String::new(),
        };
        let mut record = Recorded::default();
        record.add(&stop("Ada", 1000));
        record.add(&stop("Bob", 2000));
        let page = page_of(json!({}), &record);
        assert!(
            page.contains("Ada (operator), 1970-01-01T00:00:01Z") && !page.contains("Bob"),
            "{page}"
        );
    }
}
