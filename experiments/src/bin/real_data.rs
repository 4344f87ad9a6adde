//! What measurements by others show, and what they cannot: 314 weighings of the published robot,
//! and taps of salt from an auger.
//!
//! ```text
//! cargo experiment real_data -- ../shared/data
//! ```
//!
//! The data belong to others and are not part of FLIP; without them the example reports so and
//! exits successfully. Neither contains angles of repose, so `flip discover` would refuse them. Its
//! search does not depend on the measured quantity: here the weighings' error in mg, and the
//! logarithm of the mass of a tap, take the place of the angle. No cause has a simulated signature
//! then; only recorded covariates count. `docs/real_data.md` discusses the results.

use anyhow::Context;
use flip_discover::report::Report;
use flip_discover::{Campaign, Covariate, Measured, Run, Settings, Values, investigate};
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;

const SETTINGS: Settings = Settings { seed: 1, simulations: 199 };
/// Mass a balance of 0.1 mg cannot distinguish from zero, mg: added to a tap before the logarithm,
/// because some dispense nothing.
const TAP_RESOLUTION_MG: f64 = 0.1;
/// The four policies of the publication; the file has earlier ones too.
const PUBLISHED: [&str; 4] = ["curriculum", "random", "dr_adhesion", "reverse"];

/// A row of a file, by column.
type Line = BTreeMap<String, String>;

fn main() -> anyhow::Result<()> {
    let folder = std::env::args().nth(1).unwrap_or_else(|| "../shared/data".to_owned());
    let file = |name: &str| Path::new(&folder).join(name);
    let trials = file("flip-real/flip_real_trials.csv");
    if !trials.exists() {
        println!("skipped: there is no {}; name the folder that holds it", trials.display());
        return Ok(());
    }
    let trials = read(&trials)?;
    let published: Vec<&Line> =
        trials.iter().filter(|line| PUBLISHED.contains(&line["policy"].as_str())).collect();
    println!(
        "{} weighings in the file, {} by the four published policies\n",
        trials.len(),
        published.len()
    );
    weighings("the four policies, error in mg", &published)?;
    for policy in PUBLISHED {
        let own: Vec<&Line> =
            published.iter().copied().filter(|line| line["policy"] == policy).collect();
        weighings(&format!("{policy} alone, error in mg"), &own)?;
    }
    for (name, what) in [
        ("2026-07-31_salt", "taps of salt, first day's file"),
        ("2026-07-31_salt_angles", "taps of salt, eight tilts three times"),
    ] {
        let taps = file("powder-doser/data/tap-characterization").join(name).join("taps_tidy.csv");
        if !taps.exists() {
            println!("skipped: there is no {}", taps.display());
            continue;
        }
        salt_taps(&format!("{what}, ln(mg + {TAP_RESOLUTION_MG})"), &read(&taps)?)?;
    }
    Ok(())
}

/// Signed errors of weighings; a file of repeats (one policy, powder and target) stands for a
/// session, because days were not recorded.
fn weighings(what: &str, lines: &[&Line]) -> anyhow::Result<()> {
    let error = |line: &Line| Ok(number(line, "final_mg")? - number(line, "target_mg")?);
    let errors = lines.iter().map(|line| error(line)).collect::<anyhow::Result<Vec<f64>>>()?;
    let absolute = errors.iter().map(|error| error.abs()).sum::<f64>() / errors.len() as f64;
    let nothing = lines.iter().filter(|line| line["final_mg"].parse() == Ok(0.0)).count();
    println!("== {what}: mean |error| {absolute:.2} mg, nothing dispensed in {nothing}");
    let session =
        |line: &Line| format!("{} {} {}", line["policy"], line["powder"], line["target_mg"]);
    let recorded = [("policy", true), ("target_mg", false), ("order_in_session", false)];
    let cell = |line: &Line, column: &str| match column {
        "order_in_session" => line["trial"].clone(),
        column => line[column].clone(),
    };
    print(&campaign(lines, &errors, |line| line["powder"].clone(), session, &recorded, cell)?, "mg")
}

/// Logarithms of the mass of taps; each tilt is calibrated by itself, as a powder would be, and a
/// trial is a session.
fn salt_taps(what: &str, lines: &[Line]) -> anyhow::Result<()> {
    let lines: Vec<&Line> = lines.iter().collect();
    let log = |line: &&Line| Ok((number(line, "marginal_mg")?.max(0.0) + TAP_RESOLUTION_MG).ln());
    let logs = lines.iter().map(log).collect::<anyhow::Result<Vec<f64>>>()?;
    let nothing = lines
        .iter()
        .filter(|line| line["marginal_mg"].parse().is_ok_and(|mg: f64| mg <= 0.0))
        .count();
    println!("== {what}: {nothing} taps let nothing fall");
    let tilt = |line: &Line| format!("tilt {}", line["angle_plate_deg"]);
    let recorded = [("order_in_session", false), ("repeat", false)];
    let cell = |line: &Line, column: &str| match column {
        "order_in_session" => line["tap_index"].clone(),
        _ => line["rep"].clone(),
    };
    print(
        &campaign(&lines, &logs, tilt, |line| line["trial"].clone(), &recorded, cell)?,
        "(a factor, as ln)",
    )
}

/// The lines as a campaign: `recorded` names covariates, and whether they are names.
fn campaign(
    lines: &[&Line],
    values: &[f64],
    powder: impl Fn(&Line) -> String,
    session: impl Fn(&Line) -> String,
    recorded: &[(&str, bool)],
    cell: impl Fn(&Line, &str) -> String,
) -> anyhow::Result<Campaign> {
    let place = |known: &mut Vec<String>, name: String| {
        known.iter().position(|it| *it == name).unwrap_or_else(|| {
            known.push(name);
            known.len() - 1
        })
    };
    let (mut powders, mut sessions) = (Vec::new(), Vec::new());
    let run = |(row, (line, value)): (usize, (&&Line, &f64))| Run {
        row: row as u32 + 2,
        powder: place(&mut powders, powder(line)),
        session: place(&mut sessions, session(line)),
        value: Some(*value),
    };
    let runs = lines.iter().zip(values).enumerate().map(run).collect();
    let covariate = |&(name, of_names): &(&str, bool)| {
        let cells: Vec<String> = lines.iter().map(|line| cell(line, name)).collect();
        let values = if of_names {
            let mut names = cells.clone();
            names.sort();
            names.dedup();
            Values::Levels {
                of: cells.iter().map(|cell| names.binary_search(cell).ok()).collect(),
                names,
            }
        } else {
            Values::Numbers(cells.iter().map(|cell| cell.parse().ok()).collect())
        };
        Covariate { name: name.to_owned(), values }
    };
    let covariates = recorded.iter().map(covariate).collect();
    Ok(Campaign { powders, runs, covariates, ..Campaign::default() }.checked()?)
}

fn print(campaign: &Campaign, unit: &str) -> anyhow::Result<()> {
    let heard = |_: &_| ControlFlow::Continue(());
    let report = investigate(Measured::angles(campaign), "none", &SETTINGS, heard)?
        .context("it was stopped")?;
    let Report {
        verdict,
        p_value,
        null_check,
        findings,
        evidence,
        minimum_detectable,
        blind_spots,
        untestable,
        ..
    } = &report;
    println!(
        "n {} in {} sessions, {} means absorbed; verdict {verdict:?}, p = {p_value:.3} among {} campaigns",
        campaign.runs.len(),
        campaign.sessions(),
        campaign.powders.len(),
        null_check.campaigns
    );
    for it in evidence {
        println!(
            "  {}: log10 evidence {:+.1}, probability if any {:.2}",
            it.cause, it.log10_evidence, it.inclusion_probability
        );
    }
    for it in findings {
        let [low, high] = it.ci95;
        let covariate = it.covariate.as_deref().unwrap_or("nothing recorded");
        println!(
            "  effect of {covariate} {}: {:+.2} [{low:.2}, {high:.2}] {unit}",
            it.span, it.effect
        );
        for of in &it.by_powder {
            println!("    {}: {:+.2} [{:.2}, {:.2}]", of.powder, of.effect, of.ci95[0], of.ci95[1]);
        }
    }
    if let Some(gain) = &report.gain {
        let it = &gain.held_out;
        let [low, high] = it.ci95;
        let (before, after) = (it.rmse_before, it.rmse_after);
        println!(
            "  sessions left out: error {before:.2} to {after:.2} {unit} [gain {low:.2} to {high:.2}], accepted {}",
            gain.accepted
        );
    }
    for it in minimum_detectable {
        println!(
            "  would have found, four times of five: {} of {:.2} {unit}",
            it.mechanism, it.effect_deg
        );
    }
    let untold: Vec<&str> = untestable.iter().map(|it| it.mechanism.as_str()).collect();
    println!("  cannot be told: {}", untold.join(", "));
    println!("  blind spots of the design: {}", blind_spots.len());
    if let Some(it) = &report.suggested_experiment {
        println!("  next: {} runs, {:.0} minutes", it.runs.len(), it.minutes);
    }
    println!();
    Ok(())
}

fn read(path: &Path) -> anyhow::Result<Vec<Line>> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let line = |line: &str| {
        header.iter().zip(line.split(',')).map(|(k, v)| ((*k).to_owned(), v.to_owned())).collect()
    };
    Ok(lines.filter(|line| !line.is_empty()).map(line).collect())
}

fn number(line: &Line, column: &str) -> anyhow::Result<f64> {
    let cell = line.get(column).with_context(|| format!("there is no column {column}"))?;
    cell.parse().with_context(|| format!("{column} holds `{cell}`, which is no number"))
}
