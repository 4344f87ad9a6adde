//! `flip compare`: two calibrations side by side.

use super::Common;
use super::failure::Failure;
use super::session::with_reader;
use super::table::table;
use crate::app::{ComparedCalibration, Comparison};

/// Arguments of `flip compare`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Id of a calibration that succeeded; `flip jobs` lists them.
    #[arg(value_name = "CALIBRATION")]
    calibration: String,
    /// Id of the calibration to compare it with.
    #[arg(value_name = "OTHER")]
    with: String,
}

/// Prints the costs and results of both, and whether their sets give the same angle of repose.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let Arguments { calibration, with } = arguments;
    let comparison =
        with_reader(common, async |lab| Ok(lab.compare_calibrations(calibration, with).await?))?;
    common.print(&comparison, || text(&comparison))
}

/// Four digits, even of a number with many zeros after the decimal point.
fn short(value: f64) -> String {
    if value != 0.0 && value.abs() < 1e-3 { format!("{value:.3e}") } else { format!("{value:.4}") }
}

fn text(comparison: &Comparison) -> String {
    let Comparison { calibration: one, with: other, difference_deg, standard_error_deg, agree } =
        comparison;
    let number =
        |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"));
    let row = |what: &str, of: &dyn Fn(&ComparedCalibration) -> String| {
        vec![what.to_owned(), of(one), of(other)]
    };
    let mut rows = vec![
        row("powder", &|c| c.powder.clone().unwrap_or_else(|| "-".to_owned())),
        row("target deg", &|c| number(Some(c.target.repose_deg))),
        row("search", &|c| c.evaluations.to_string()),
        row("verification", &|c| c.verification_runs.to_string()),
        row("sets", &|c| c.sets.to_string()),
        row("verified error deg", &|c| number(c.verified_error_deg)),
        row("sd over sets deg", &|c| number(c.verified_sd_deg)),
        row("mean angle deg", &|c| number(c.repose_deg)),
        row("standard error deg", &|c| number(c.standard_error_deg)),
    ];
    let spread = |c: &ComparedCalibration, k: usize| match c.parameters.get(k) {
        Some(p) => format!("{} ({} to {})", short(p.mean), short(p.lower), short(p.upper)),
        None => "-".to_owned(),
    };
    let keys = one.parameters.iter().chain(&other.parameters).map(|p| p.key.as_str());
    let mut named: Vec<&str> = Vec::new();
    for key in keys {
        if !named.contains(&key) {
            named.push(key);
        }
    }
    rows.extend(named.iter().enumerate().map(|(k, key)| row(key, &|c| spread(c, k))));
    let verdict = match agree {
        Some(true) => "they agree within two standard errors",
        Some(false) => "they differ by more than two standard errors",
        None => "whether they agree is not known",
    };
    let header = ["", one.id.as_str(), other.id.as_str()];
    format!(
        "{}\nmean angles differ by {} deg (standard error {}): {verdict}",
        table(&header, &rows),
        number(*difference_deg),
        number(*standard_error_deg)
    )
}
