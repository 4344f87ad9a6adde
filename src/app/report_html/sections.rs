//! The sections of a report below its sentence. A section without content is empty.

use super::figures::{self, bar};
use super::traces::is_of_traces;
use super::words::{
    cause, chance, column, column_with_unit, counted, decimals_of, duration, interval, level,
    lower, num, parameter, percent, signed, span, text, with_unit, words,
};
use flip_discover::report::{
    CauseReport, Channel, Experiment, Finding, PowderEffect, Report, SideChannel, Verdict,
};
use flip_discover::{Mechanism, is_told};

/// Maximum number of residual figures.
const FIGURES_MAX: usize = 8;
/// Inclusion probability from which a cause is described in more than its bar.
const TOLD: f64 = 0.1;
/// Number of colour shades of an effect.
const SHADES: f64 = 4.0;

/// A section: heading, a line that explains how to read it, content.
pub fn section(title: &str, intro: &str, content: &str) -> String {
    match content {
        "" => String::new(),
        content => {
            format!("<section><h2>{title}</h2><p class=\"intro\">{intro}</p>{content}</section>")
        }
    }
}

/// A table; headings starting with `>` are left-aligned.
pub(super) fn table(class: &str, headings: &[&str], rows: &str) -> String {
    let heading = |label: &&str| match label.strip_prefix('>') {
        Some(label) => format!("<th scope=\"col\" class=\"left\">{label}</th>"),
        None => format!("<th scope=\"col\">{label}</th>"),
    };
    let headings: String = headings.iter().map(heading).collect();
    format!(
        "<div class=\"scroll\" tabindex=\"0\"><table class=\"{class}\"><thead><tr>{headings}</tr></thead><tbody>{rows}</tbody></table></div>"
    )
}

pub(super) fn row(head: &str, cells: &[String]) -> String {
    let cells: String = cells.iter().map(|cell| format!("<td>{cell}</td>")).collect();
    format!("<tr><th scope=\"row\">{head}</th>{cells}</tr>")
}

/// Covariates in the order a reader wants to see them: those of findings, those of causes by
/// decreasing probability, all others.
fn covariates(report: &Report) -> Vec<&str> {
    let of_findings = report.findings.iter().filter_map(|finding| finding.covariate.as_deref());
    let of_unexplained = report.unexplained.iter().filter_map(|it| it.covariate.as_deref());
    let of_evidence =
        report.evidence.iter().flat_map(|it| match it.cause.strip_prefix("unknown: ") {
            Some(covariate) => vec![covariate],
            None => {
                let known = Mechanism::ALL.iter().find(|mechanism| mechanism.name().0 == it.cause);
                known.map_or(Vec::new(), |mechanism| mechanism.covariates().to_vec())
            }
        });
    let mut order: Vec<&str> = Vec::new();
    for name in of_findings.chain(of_unexplained).chain(of_evidence) {
        if !order.contains(&name) {
            order.push(name);
        }
    }
    order
}

pub fn residuals(report: &Report) -> String {
    let order = covariates(report);
    let mut curves: Vec<_> = report.curves.iter().collect();
    curves.sort_by_key(|curve| {
        order.iter().position(|name| *name == curve.covariate).unwrap_or(order.len())
    });
    let drawn: Vec<String> = curves
        .iter()
        .map(|curve| figures::residuals(report, curve))
        .filter(|it| !it.is_empty())
        .collect();
    if drawn.is_empty() {
        return String::new();
    }
    let missing = report.curves.iter().any(|curve| curve.at.iter().any(Option::is_none));
    let mut marks = vec![
        ("<path class=\"zero\" d=\"M1 6h20\"/>", "as simulated before"),
        (
            "<rect class=\"band\" x=\"1\" width=\"20\" height=\"12\"/><path class=\"course\" d=\"M1 6h20\"/>",
            "with what was found: the average over powders, and the band of 90 % of runs around it",
        ),
    ];
    if missing {
        marks.push(("<path class=\"rug p6\" d=\"M4 6h14\"/>", "not recorded"));
    }
    let legend = figures::legend(&figures::powders(&report.rows), &marks);
    let left_out = drawn.len().saturating_sub(FIGURES_MAX);
    let more = match left_out {
        0 => String::new(),
        n => format!(
            "<p class=\"note\">{} of less weight not drawn.</p>",
            counted(n, "recorded condition")
        ),
    };
    let drawn: String = drawn.into_iter().take(FIGURES_MAX).collect();
    section(
        "Where measured and simulated angles differ",
        "Each mark is one row of the file. A powder's mean is fitted, so what counts is a trend along a condition. \
         Powders that react otherwise than the average, and other conditions, move marks out of the band.",
        &format!("{legend}<div class=\"figures\">{drawn}</div>{more}"),
    )
}

pub fn evidence(report: &Report) -> String {
    let finite = |it: &f64| it.is_finite();
    let weights = || report.evidence.iter().map(|it| it.log10_evidence).filter(finite);
    let (low, high) = (weights().fold(0.0, f64::min), weights().fold(1.0, f64::max));
    let bars_of = |of_traces: bool| -> String {
        let line = |it: &flip_discover::report::Evidence| {
            let class = if it.log10_evidence < 0.0 { "against" } else { "weight" };
            let family =
                it.family.as_deref().map_or(String::new(), |family| text(&lower(&words(family))));
            row(
                &format!("{} <span class=\"small\">{family}</span>", text(&cause(&it.cause))),
                &[
                    bar(it.log10_evidence, low, high, class)
                        + &format!(
                            "<span class=\"number\">{}</span>",
                            signed(it.log10_evidence, 1)
                        ),
                    bar(it.inclusion_probability, 0.0, 1.0, "share")
                        + &format!(
                            "<span class=\"number\">{}</span>",
                            percent(it.inclusion_probability)
                        ),
                ],
            )
        };
        report.evidence.iter().filter(|it| is_of_traces(&it.cause) == of_traces).map(line).collect()
    };
    let untestable: String = report
        .untestable
        .iter()
        .map(|it| {
            let name = text(&cause(&it.mechanism));
            format!(
                "<tr class=\"greyed\"><th scope=\"row\">{name}</th><td colspan=\"2\" class=\"left wrap\">cannot be tested: {}\
                 </td></tr>",
                text(&it.reason)
            )
        })
        .collect();
    let (angles, traces) = (bars_of(false), bars_of(true));
    if angles.is_empty() && traces.is_empty() && untestable.is_empty() {
        return String::new();
    }
    let bars = |rows: &str| {
        table("evidence", &[">Cause and its family", "Evidence (log10)", "Probability"], rows)
    };
    let bars = match (angles.as_str(), traces.as_str()) {
        (_, "") => bars(&format!("{angles}{untestable}")),
        ("", _) => bars(&format!("{traces}{untestable}")),
        _ => format!(
            "<h3>Angles of repose</h3>{}<h3>Balance readings</h3>{}",
            bars(&angles),
            bars(&format!("{traces}{untestable}"))
        ),
    };
    section(
        "How well each cause explains the data",
        "Evidence: 0 is noise alone, 1 explains the data ten times as well, 2 a hundred times; below 0 noise alone does better. \
         Probability: that the cause is at work, if anything is; two causes may be at work together.",
        &format!("{bars}{}", causes(report)),
    )
}

/// What is known of the probable causes; empty if nothing is wrong.
fn causes(report: &Report) -> String {
    if report.verdict == Verdict::NoDiscrepancy {
        return String::new();
    }
    let told = report
        .causes
        .iter()
        .filter(|it| it.inclusion_probability >= TOLD)
        .take(5)
        .map(told)
        .collect::<String>();
    match told.as_str() {
        "" => told,
        told => format!("<h3>The most probable causes</h3><ul class=\"plain\">{told}</ul>"),
    }
}

fn told(it: &CauseReport) -> String {
    let powders: Vec<String> = it.powders.iter().map(|name| text(&lower(&words(name)))).collect();
    let shown = match powders.as_slice() {
        [] => String::new(),
        powders => format!(" Shows on {}.", super::words::listed(powders)),
    };
    let parameter = |p: &flip_discover::report::ParameterReport| {
        let decimals = decimals_of(p.value);
        format!(
            " {}: {} {}.",
            text(&parameter(&p.name)),
            with_unit(&num(p.value, decimals), &text(&p.unit)),
            interval(p.ci95, decimals)
        )
    };
    let parameters: String = it.parameters.iter().map(parameter).collect();
    format!(
        "<li><strong>{}</strong>, {}. Level {} of 3: {}.{shown}{parameters}</li>",
        text(&cause(&it.mechanism)),
        percent(it.inclusion_probability),
        it.confidence_level,
        level(it.confidence_level)
    )
}

pub fn by_powder(report: &Report) -> String {
    let findings: Vec<&Finding> =
        report.findings.iter().filter(|it| it.channel != Channel::Trace).collect();
    if findings.is_empty() {
        return String::new();
    }
    let mut powders: Vec<&str> = Vec::new();
    for powder in
        findings.iter().flat_map(|finding| &finding.by_powder).map(|it| it.powder.as_str())
    {
        if !powders.contains(&powder) {
            powders.push(powder);
        }
    }
    let cells = |of: &dyn Fn(&Finding) -> Option<PowderEffect>| -> Vec<String> {
        // Degrees and percent have separate shades.
        let most = |unit: &str| {
            let alike = findings.iter().filter(|it| it.unit == unit);
            let all = alike.flat_map(|f| f.by_powder.iter().map(|it| it.effect).chain([f.effect]));
            all.map(f64::abs).filter(|it| it.is_finite()).fold(1e-9, f64::max)
        };
        findings
            .iter()
            .map(|finding| effect(of(finding), most(&finding.unit), &finding.unit))
            .collect()
    };
    let line = |name: &str, cells: &[String]| {
        format!("<tr><th scope=\"row\">{name}</th>{}</tr>", cells.concat())
    };
    let average = |finding: &Finding| match finding.powder {
        None => {
            Some(PowderEffect { powder: String::new(), effect: finding.effect, ci95: finding.ci95 })
        }
        Some(_) => None,
    };
    let rows: String = powders
        .iter()
        .map(|powder| {
            let of = |finding: &Finding| {
                finding.by_powder.iter().find(|it| it.powder == *powder).cloned()
            };
            line(&text(&words(powder)), &cells(&of))
        })
        .collect();
    let headings: Vec<String> = findings.iter().map(|it| heading(it)).collect();
    let mut columns = vec![">Powder"];
    columns.extend(headings.iter().map(String::as_str));
    section(
        "Effect on each powder",
        "How far the measurement moves from one end of the condition to the other, with its 95 % interval. \
         Bold: the interval leaves out zero.",
        &table("heat", &columns, &format!("{rows}{}", line("On average", &cells(&average)))),
    )
}

/// Measurements other than the angle.
pub fn beside(report: &Report) -> String {
    let line = |it: &SideChannel| {
        let (name, looked_at) = match it.channel {
            Channel::FlowTime => ("Flow times", "flow time"),
            _ => ("Scatter of repeats", "difference"),
        };
        let says = if it.sentence.is_empty() {
            "It is the same throughout."
        } else {
            it.sentence.as_str()
        };
        let says = format!("<span class=\"left wrap\">{}</span>", text(says));
        row(name, &[counted(it.n as usize, looked_at), chance(it.p_value), says])
    };
    let rows: String = report.beside.iter().map(line).collect();
    if rows.is_empty() {
        return String::new();
    }
    section(
        "What was measured beside the angle",
        "Each judged by itself, as the angles are. The simulator says nothing of how far repeats scatter, so that alone is no discrepancy.",
        &table("", &[">Measurement", "Looked at", "p", ">What it says"], &rows),
    )
}

fn heading(finding: &Finding) -> String {
    let channel = match finding.channel {
        Channel::Repose => "",
        Channel::FlowTime => "Flow time: ",
        Channel::Trace => "Balance readings: ",
        Channel::Scatter => "Scatter: ",
    };
    let what =
        finding.covariate.as_deref().map_or("nothing recorded".to_owned(), |name| column(name).0);
    format!(
        "{channel}{}<br/><span class=\"small\">{}</span>",
        text(&what),
        text(span(&finding.span, &what))
    )
}

fn effect(effect: Option<PowderEffect>, most: f64, unit: &str) -> String {
    let Some(it) = effect else { return "<td class=\"small\">–</td>".to_owned() };
    let shade = (SHADES * it.effect.abs() / most).round().clamp(0.0, SHADES);
    let shade = match (it.effect > 0.0, shade as u32) {
        (_, 0) => String::new(),
        (true, shade) => format!(" up{shade}"),
        (false, shade) => format!(" down{shade}"),
    };
    let sure = if is_told(it.ci95, unit) { "sure" } else { "plain-effect" };
    let number = with_unit(&signed(it.effect, 1), &text(unit));
    format!(
        "<td class=\"{sure}{shade}\">{number} <span class=\"small\">{}</span></td>",
        interval(it.ci95, 1)
    )
}

pub fn blind_spots(report: &Report) -> String {
    let spots: String =
        report.blind_spots.iter().map(|it| format!("<li>{}</li>", text(it))).collect();
    match spots.as_str() {
        "" => spots,
        spots => section(
            "What these data cannot show",
            "Nothing is claimed of these, neither that they are there nor that they are not.",
            &format!("<ul class=\"plain\">{spots}</ul>"),
        ),
    }
}

/// Columns that are not conditions; empty if there are none.
pub fn left_out(report: &Report) -> String {
    let rows: String = report
        .left_out
        .iter()
        .map(|it| {
            let reason = format!("<span class=\"left wrap\">{}</span>", text(&it.reason));
            row(&text(&column_with_unit(&it.column)), &[reason])
        })
        .collect();
    match rows.as_str() {
        "" => rows,
        rows => section(
            "Columns that were left out",
            "Conditions are what was there before a heap was poured. What was read off the heap afterwards explains its angle and causes nothing.",
            &table("", &[">Column", ">Why"], rows),
        ),
    }
}

pub fn null_check(report: &Report) -> String {
    // Balance readings have their own section.
    if report.traces.as_ref().is_some_and(|it| it.null_check == report.null_check) {
        return String::new();
    }
    let check = &report.null_check;
    let mut content = String::new();
    if let Some((statistic, threshold95)) = check.statistic.zip(check.threshold95) {
        content = format!(
            "<p>{} of this design (its powders, days, repeats and gaps) were simulated with nothing wrong, and the whole search \
             was done on each. The statistic is the natural log of the strongest evidence for any cause, with how \
             likely the cause was before. One in twenty exceeds {}; here it is {}, p\u{a0}=\u{a0}{}.</p><div class=\"figures\">{}</div>",
            counted(check.campaigns as usize, "campaign"),
            num(threshold95, 1),
            num(statistic, 1),
            chance(report.p_value),
            figures::null_scale(check)
        );
    }
    if !report.minimum_detectable.is_empty() {
        let line = |it: &flip_discover::report::Detectable| {
            row(
                &text(&cause(&it.mechanism)),
                &[format!("{}°", num(it.effect_deg, 1)), percent(it.power)],
            )
        };
        let rows: String = report.minimum_detectable.iter().map(line).collect();
        content += "<h3>The smallest effects that this design would find</h3><p class=\"note\">Change of the angle from the 5th \
                    to the 95th percentile of the condition, all powders alike. Smaller ones are easily missed.</p>";
        content += &table("", &[">Cause", "Effect", "Found in"], &rows);
    }
    section("Null check", "How often as much is found where nothing is wrong.", &content)
}

pub fn experiment(report: &Report) -> String {
    let Some(it) = &report.suggested_experiment else { return String::new() };
    section(
        "The next experiment",
        "What would tell most. Do the runs in this order.",
        &experiment_card(it),
    )
}

pub(super) fn experiment_card(it: &Experiment) -> String {
    let share = |what: &str, of: Option<f64>, note: &str| {
        of.map_or(String::new(), |of| {
            format!("<div><dt>{what}</dt><dd>{}{note}</dd></div>", percent(of))
        })
    };
    let facts = format!(
        "<dl class=\"facts\"><div><dt>Time it takes</dt><dd>{}</dd></div>{}{}</dl>",
        duration(60.0 * it.minutes),
        share("Chance that it settles the cause", it.chance_of_resolution, ""),
        share(
            "Probability of the right cause after it",
            it.expected_posterior,
            " <small>on average</small>"
        )
    );
    format!(
        "<div class=\"card\"><p><strong>{}</strong></p>{facts}</div>{}",
        text(&it.what),
        runs(it)
    )
}

fn runs(experiment: &Experiment) -> String {
    let mut columns: Vec<&str> = Vec::new();
    for name in experiment.runs.iter().flat_map(|run| run.keys()) {
        if !columns.contains(&name.as_str()) {
            columns.push(name);
        }
    }
    columns.sort_by_key(|name| *name != "powder");
    if columns.is_empty() {
        return String::new();
    }
    let headings: Vec<String> = columns.iter().map(|name| text(&column_with_unit(name))).collect();
    let headings: Vec<&str> =
        [">Run"].into_iter().chain(headings.iter().map(String::as_str)).collect();
    let line = |(k, run): (usize, &std::collections::BTreeMap<String, String>)| {
        let cell = |name: &&str| run.get(*name).map_or("–".to_owned(), |value| text(value));
        row(&(k + 1).to_string(), &columns.iter().map(cell).collect::<Vec<_>>())
    };
    table("", &headings, &experiment.runs.iter().enumerate().map(line).collect::<String>())
}
