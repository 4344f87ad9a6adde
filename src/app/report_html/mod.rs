//! The report of an investigation as one self-contained HTML page: no script, no font, no other
//! file.
//!
//! ```text
//! mod.rs         the page: sentence and verdict first, provenance last
//! sections.rs    what stands between them
//! gain.rs        before and after
//! traces.rs      what balance readings say by themselves
//! files.rs       how the files were read
//! figures.rs     SVG
//! words.rs       names, numbers and units; everything from a file is escaped there
//! style.css      light, dark, phone and paper
//! ```
//!
//! The same report always gives the same bytes. A server must send it with [`POLICY`]: under a
//! stricter policy the page has no style.

mod figures;
mod files;
mod gain;
mod sections;
mod traces;
mod words;

#[cfg(test)]
mod tests;

use flip_discover::Report;
use flip_discover::numerics::CREEP;
use flip_discover::report::{Channel, Verdict};
use words::{cause, chance, column, counted, duration, form, listed, lower, text, upper};

/// Content security policy: the page's own style, and nothing else.
pub const POLICY: &str =
    "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'";

const STYLE: &str = include_str!("style.css");

/// The page.
pub fn html(report: &Report) -> String {
    let parts = [
        first(report),
        sections::residuals(report),
        sections::evidence(report),
        sections::by_powder(report),
        sections::beside(report),
        traces::traces(report),
        gain::before_after(report),
        sections::left_out(report),
        sections::blind_spots(report),
        sections::null_check(report),
        sections::experiment(report),
        files::files(report),
        provenance(report),
    ];
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\"/>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n<meta name=\"color-scheme\" \
         content=\"light dark\"/>\n<title>{} · FLIP investigation</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n{}\n\
         </main>\n</body>\n</html>\n",
        badge(report.verdict).1,
        parts
            .iter()
            .filter(|part| !part.is_empty())
            .map(String::as_str)
            .collect::<Vec<_>>()
            .join("\n")
    )
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
fn first(report: &Report) -> String {
    let is_unjudged = report.unjudged.is_some() && report.verdict == Verdict::NoDiscrepancy;
    let (class, name) =
        if is_unjudged { ("doubt", "Could not be judged") } else { badge(report.verdict) };
    let sentence = if report.sentence.trim().is_empty() { name } else { report.sentence.trim() };
    let campaigns = report.null_check.campaigns;
    let least = match campaigns > 0 && report.p_value * (f64::from(campaigns) + 1.0) < 1.5 {
        true => format!(" It is the smallest that {campaigns} simulated campaigns can show."),
        false => String::new(),
    };
    let chance = match is_unjudged && report.p_value >= 1.0 {
        true => String::new(),
        false => format!(
            "<span><strong>p = {}</strong>: chance of evidence this strong if nothing is wrong.{least}</span>",
            chance(report.p_value)
        ),
    };
    format!(
        "<section class=\"first\"><p class=\"over\">FLIP · what the simulation gets wrong</p><h1>{}</h1><div class=\"head\">\
         <span class=\"badge {class}\">{name}</span>{chance}</div><p>{}</p></section>",
        text(sentence),
        meaning(report)
    )
}

fn meaning(report: &Report) -> String {
    let is_found = |verdict: Verdict| verdict != Verdict::NoDiscrepancy;
    let has_traces = report.traces.as_ref().is_some_and(|it| is_found(it.verdict));
    let has_flow =
        report.beside.iter().any(|it| it.channel == Channel::FlowTime && is_found(it.verdict));
    let creeps = report.causes.iter().any(|it| it.mechanism == CREEP);
    let has_angles = !(has_traces || has_flow || creeps)
        || report.findings.iter().any(|it| it.channel == Channel::Repose);
    let parts = [
        (has_angles, "the measured angles"),
        (has_flow, "the flow times"),
        (has_traces, "the balance readings"),
    ];
    let parts: Vec<String> =
        parts.iter().filter(|(depart, _)| *depart).map(|(_, what)| (*what).to_owned()).collect();
    let what = upper(&listed(&parts));
    if creeps && parts.is_empty() {
        return "Whatever was measured, simulated heaps go on moving: what is wrong is how they are computed. These data show nothing else.".to_owned();
    }
    match report.verdict {
        Verdict::NoDiscrepancy if report.unjudged.is_some() => {
            "These angles can neither show that the simulation is wrong nor that it is right.".to_owned()
        }
        Verdict::NoDiscrepancy => {
            "These data do not show that the simulation is wrong. That is no proof that it is right: \
                                   see below which effects this campaign would have found, and which it cannot show."
                .to_owned()
        }
        Verdict::Cause => {
            format!(
                "{what} depart from the simulation, and the catalogue has a cause that explains how. \
                 A good explanation is not a proof: only an experiment that changes the cause is."
            )
        }
        Verdict::Ambiguous => {
            let names: Vec<String> = report
                .ambiguous_between
                .iter()
                .map(|name| format!("<strong>{}</strong>", text(&lower(&cause(name)))))
                .collect();
            let between = match names.as_slice() {
                [] => "several causes".to_owned(),
                names => listed(names),
            };
            let next =
                if report.suggested_experiment.is_some() { " The experiment below would tell most." } else { "" };
            format!("{what} depart from the simulation, but these data cannot tell between {between}.{next}")
        }
        Verdict::Hint => {
            "Evidence this strong is rare by chance, and points at one cause. But its effect is not told from zero, or days that were left out \
             are not predicted better by it: nothing to act on before the experiment below."
                .to_owned()
        }
        Verdict::Unexplained => {
            let law = report.unexplained.as_ref().map_or(String::new(), |it| {
                let on = match &it.covariate {
                    Some(name) => format!("It depends on <strong>{}</strong>", text(&lower(&column(name).0))),
                    None => "Nothing that was recorded explains it".to_owned(),
                };
                format!(" {on}. Its law ({}): {}.", form(it.form_class.name()), text(it.law.trim_end_matches('.')))
            });
            format!("{what} depart from the simulation, and no cause of the catalogue explains how.{law}")
        }
    }
}

fn provenance(report: &Report) -> String {
    let versions = &report.simulator_version;
    let extended = match &versions.extended {
        None => "none <small>nothing was accepted</small>".to_owned(),
        Some(id) => format!(
            "<span class=\"mono\">{}</span> <small>{}</small>",
            text(id),
            if versions.verified {
                "verified by simulations"
            } else {
                "not yet verified by simulations"
            }
        ),
    };
    let measured = report.rows.iter().filter(|row| row.measured_deg.is_some()).count();
    let mut facts = vec![
        (
            "Simulator that was judged",
            format!("<span class=\"mono\">{}</span>", text(&versions.base)),
        ),
        ("Simulator that the findings make", extended),
        ("Simulations", report.simulator_runs.to_string()),
        ("Simulated campaigns without an effect", report.null_check.campaigns.to_string()),
    ];
    if let Some(numerics) = &report.numerics {
        facts.push(("The simulator's own numerics", words::numerics(numerics)));
    }
    if !report.rows.is_empty() {
        let powders = counted(figures::powders(&report.rows).len(), "powder");
        facts.push((
            "Rows with an angle",
            format!("{measured} <small>of {}, {powders}</small>", report.rows.len()),
        ));
    }
    if report.wall_s > 0.0 {
        facts.push(("Time it took", duration(report.wall_s)));
    }
    facts.push(("Version of this document", report.schema_version.to_string()));
    let facts: String = facts
        .iter()
        .map(|(what, value)| format!("<div><dt>{what}</dt><dd>{value}</dd></div>"))
        .collect();
    sections::section(
        "Provenance",
        "The same file, settings and seed give this report again. All numbers are in report.json.",
        &format!("<dl class=\"facts\">{facts}</dl>"),
    )
}
