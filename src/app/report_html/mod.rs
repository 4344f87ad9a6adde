//! The report of an investigation as HTML: a self-contained page without script, font or other
//! file, or its sections alone, which FLIP's own page shows.
//!
//! ```text
//! mod.rs         the page: sentence and verdict first, provenance last
//! meaning.rs     what a verdict says, and what it does not
//! sections.rs    what stands between them
//! evidence.rs    how well each cause explains the data
//! gain.rs        before and after
//! spoon.rs       what spoons let fall, against replays
//! traces.rs      what balance readings say by themselves
//! files.rs       how the files were read
//! figures.rs     SVG
//! table.rs       headings, tables, rows
//! words.rs       names, numbers and units
//! style.css      the file around the sections, on a screen, a phone and paper
//! ```
//!
//! The sections' style and the colours are the page's: `web/src/report.css`, `web/src/tokens.css`.
//! The same report always gives the same bytes.

mod evidence;
pub(super) mod figures;
mod files;
mod gain;
mod meaning;
mod sections;
mod spoon;
mod table;
mod traces;
mod words;

#[cfg(test)]
mod tests;

use super::document::{inert, page};
use flip_discover::Report;
use flip_discover::report::Verdict;
use maud::{Markup, html};
use meaning::meaning;
use std::collections::BTreeMap;
use words::{chance, counted, duration, words};

const STYLE: &str = concat!(
    include_str!("../../../web/src/tokens.css"),
    include_str!("style.css"),
    include_str!("../../../web/src/report.css"),
);

/// A powder's name by its id.
type Named<'a> = &'a dyn Fn(&str) -> String;

/// The page, from the report alone.
pub fn html(report: &Report) -> String {
    let headline = |sentence: &str| {
        html! {
            p.over { "FLIP · what the simulation gets wrong" }
            h1 { (sentence) }
        }
    };
    let title = format!("{} · FLIP investigation", badge(report.verdict).1);
    let body = html! { main.report { (sections(report, &headline, &words)) } };
    page(&title, STYLE, Some("light dark"), &body)
}

/// The sections, for a page with a heading of its own that knows the powders' names, by id.
pub fn fragment(report: &Report, powders: &BTreeMap<String, String>) -> String {
    let headline = |sentence: &str| html! { p.sentence { (sentence) } };
    let named = |id: &str| powders.get(id).cloned().unwrap_or_else(|| words(id));
    inert(sections(report, &headline, &named))
}

fn sections(report: &Report, headline: &dyn Fn(&str) -> Markup, named: Named) -> Markup {
    let parts = [
        first(report, headline),
        sections::residuals(report, named),
        evidence::evidence(report, named),
        sections::by_powder(report, named),
        sections::beside(report),
        spoon::spoon(report, named),
        traces::traces(report),
        gain::before_after(report),
        sections::left_out(report),
        sections::blind_spots(report),
        sections::null_check(report),
        sections::experiment(report),
        files::files(report),
        provenance(report),
    ];
    html! { @for part in parts { "\n" (part) } "\n" }
}

/// CSS class and wording of a verdict.
fn badge(verdict: Verdict) -> (&'static str, &'static str) {
    match verdict {
        Verdict::NoDiscrepancy => ("none", "No discrepancy shown"),
        Verdict::Cause => ("cause", "Cause named"),
        Verdict::Ambiguous => ("doubt", "Cause not yet clear"),
        Verdict::Unexplained => ("doubt", "No known cause"),
        Verdict::Hint => ("doubt", "A hint, no cause yet"),
    }
}

/// Sentence, verdict and p-value, and the meaning of the verdict.
fn first(report: &Report, headline: &dyn Fn(&str) -> Markup) -> Markup {
    let is_unjudged = report.unjudged.is_some() && report.verdict == Verdict::NoDiscrepancy;
    let (class, name) =
        if is_unjudged { ("doubt", "Could not be judged") } else { badge(report.verdict) };
    let sentence = if report.sentence.trim().is_empty() { name } else { report.sentence.trim() };
    let campaigns = report.null_check.campaigns;
    let is_least = campaigns > 0 && report.p_value * (f64::from(campaigns) + 1.0) < 1.5;
    html! {
        section.first {
            (headline(sentence))
            div.head {
                span.badge.(class) { (name) }
                @if !(is_unjudged && report.p_value >= 1.0) {
                    span {
                        strong { "p = " (chance(report.p_value)) }
                        ": chance of evidence this strong if nothing is wrong."
                        @if is_least {
                            " It is the smallest that " (campaigns) " simulated campaigns can show."
                        }
                    }
                }
            }
            p { (meaning(report)) }
        }
    }
}

fn provenance(report: &Report) -> Markup {
    let versions = &report.simulator_version;
    let verified = if versions.verified {
        "verified by simulations"
    } else {
        "not yet verified by simulations"
    };
    let extended = match &versions.extended {
        None => html! { "none " small { "nothing was accepted" } },
        Some(id) => html! { span.mono { (id) } " " small { (verified) } },
    };
    let measured = report.rows.iter().filter(|row| row.measured_deg.is_some()).count();
    let mut facts = vec![
        ("Simulator tested", html! { span.mono { (versions.base) } }),
        ("Simulator extended by the findings", extended),
        ("Simulations", html! { (report.simulator_runs) }),
        ("Campaigns without an effect", html! { (report.null_check.campaigns) }),
    ];
    if let Some(numerics) = &report.numerics {
        facts.push(("The simulator's own numerics", words::numerics(numerics)));
    }
    if !report.rows.is_empty() {
        let powders = counted(figures::powders(&report.rows).len(), "powder");
        let of = format!("of {}, {powders}", report.rows.len());
        facts.push(("Rows with an angle", html! { (measured) " " small { (of) } }));
    }
    if report.wall_s > 0.0 {
        facts.push(("Run time", html! { (duration(report.wall_s)) }));
    }
    facts.push(("Document version", html! { (report.schema_version) }));
    table::section(
        "Provenance",
        "The same file, settings and seed reproduce this report. All numbers are in report.json.",
        &html! {
            dl.facts { @for (what, value) in facts { div { dt { (what) } dd { (value) } } } }
        },
    )
}
