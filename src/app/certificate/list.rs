//! The certificate of a list of doses.

use super::words::{digits, not_real, outcome};
use super::{Recorded, STYLE, footer, heading, mark, page, signatures};
use flip_core::domain::weighing::Outcome;
use flip_store::weighings::Weighing;
use maud::html;
use std::collections::BTreeSet;

/// The page of a list; the same doses always give the same bytes.
pub(super) fn certificate_of_all(
    name: &str,
    doses: &[(Weighing, Recorded)],
    laboratory: Option<&str>,
) -> String {
    let is = |outcome| doses.iter().filter(|dose| dose.0.outcome == Some(outcome)).count();
    let within = is(Outcome::Within);
    let cells = |(weighing, record): &(Weighing, Recorded)| {
        let text = |text: &Option<String>| text.clone().unwrap_or_else(|| "–".to_owned());
        let asked = &weighing.asked;
        let lost = record.unrecorded || !record.lost.is_empty();
        [
            text(&asked.position),
            text(&asked.vial),
            weighing.powder.clone(),
            text(&asked.lot),
            format!(
                "{} −{} / +{}",
                digits(weighing.target_mg),
                digits(weighing.tolerance_lower_mg),
                digits(weighing.tolerance_upper_mg)
            ),
            match &weighing.measured {
                Some(it) => format!("{} ± {}", digits(it.net_mg), digits(it.uncertainty_mg)),
                None => weighing.reading_mg.map_or_else(|| "–".to_owned(), digits),
            },
            outcome(weighing) + if lost { ", part of its record is lost" } else { "" },
            weighing.finished_at.map_or_else(String::new, |at| at.to_string()),
        ]
    };
    let mut marks: Vec<_> = doses.iter().filter_map(|dose| not_real(dose.0.bench)).collect();
    marks.dedup();
    let operators: BTreeSet<_> =
        doses.iter().filter_map(|dose| dose.0.asked.operator.as_deref()).collect();
    let operators = operators.into_iter().collect::<Vec<_>>().join(", ");
    let body = html! {
        @if let [(word, _), rest @ ..] = &marks[..] {
            (mark(if rest.is_empty() { word } else { "Not real" }))
        }
        main {
            h1 { "Certificate of a list of doses" }
            (heading(laboratory))
            p.big { (name) }
            p { (within) " of " (doses.len()) " doses within tolerance. Masses in mg; ± is the expanded uncertainty (k = 2)." }
            @if !marks.is_empty() { p.warn { "Simulated or emulated: no real powder was weighed in some or all of these doses." } }
            @if within < doses.len() {
                p.warn { (doses.len() - within) " of the doses are not within tolerance, or have no mass: see their outcomes." }
            }
            table.doses {
                thead { tr { @for title in ["Position", "Vial", "Powder", "Lot", "Target", "Net", "Outcome", "Ended"] { th scope="col" { (title) } } } }
                tbody { @for dose in doses { tr { @for cell in cells(dose) { td { (cell) } } } } }
            }
            h2 { "Record" }
            table { tbody { @for (weighing, record) in doses {
                tr { th scope="row" { (weighing.id) } td { @if let Some(last) = &record.last { "record " (last.seq) ", " code { (last.hash) } } @else { "none" } } }
            } } }
            (signatures(Some(&operators)))
            (footer("; each weighing has a certificate of its own"))
        }
    };
    page(&format!("List {name} · FLIP"), STYLE, None, &body)
}
