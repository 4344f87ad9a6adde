//! `flip measure`: a powder's angle of repose by camera, on a bench that has a stand for piles.

use super::Common;
use super::benches::BenchArguments;
use super::failure::Failure;
use super::labels::LabelArguments;
use super::session::with_bench;
use super::table::table;
use super::watch::Watch;
use crate::app::{Job, Pile, PileDimensions, Procedure, ReposeMeasurement, ReposeRequest};
use flip_core::domain::FieldError;

/// Arguments of `flip measure`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Powder id.
    #[arg(long, value_name = "ID")]
    powder: String,
    /// Piles to measure, 1 to 20.
    #[arg(long, value_name = "N", default_value_t = 5, allow_negative_numbers = true)]
    repeats: u32,
    /// Frames per pile, 3 to 100.
    #[arg(long, value_name = "N", default_value_t = 10, allow_negative_numbers = true)]
    frames: u32,
    /// Time the gate stays open, 1 to 300 s.
    #[arg(long, value_name = "S", default_value_t = 20.0, allow_negative_numbers = true)]
    open_s: f64,
    /// Time each pile rests before frames are taken, 0 to 300 s.
    #[arg(long, value_name = "S", default_value_t = 5.0, allow_negative_numbers = true)]
    rest_s: f64,
    /// Height of the funnel's tip above the base, 10 to 500 mm.
    #[arg(long, value_name = "MM", default_value_t = 60.0, allow_negative_numbers = true)]
    tip_height_mm: f64,
    /// Diameter of the base, 5 to 500 mm.
    #[arg(long, value_name = "MM", default_value_t = 60.0, allow_negative_numbers = true)]
    base_diameter_mm: f64,
    /// Height of the base above the bench, 0 to 200 mm.
    #[arg(long, value_name = "MM", default_value_t = 15.0, allow_negative_numbers = true)]
    base_height_mm: f64,
    /// Which measurement of this powder, from 1; repeating a number returns the existing one
    /// [default: the next].
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    run: Option<u32>,
    #[command(flatten)]
    labels: LabelArguments,
    #[command(flatten)]
    bench: BenchArguments,
}

/// Measures, and prints every pile.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    if arguments.bench.is_file() {
        // No frames could be uploaded to this process: the pile would be poured in vain.
        let advice = "must be `emulated` here: frames of devices are uploaded, so run `flip serve --bench FILE` and POST /v1/repose-measurements";
        return Err(FieldError::new("bench", advice).into());
    }
    let Arguments { powder, repeats, frames, open_s, rest_s, run, .. } = arguments;
    let rig = PileDimensions {
        tip_height_mm: arguments.tip_height_mm,
        base_diameter_mm: arguments.base_diameter_mm,
        base_height_mm: arguments.base_height_mm,
        ..PileDimensions::default()
    };
    let procedure =
        Procedure { repeats: *repeats, frames: *frames, open_s: *open_s, rest_s: *rest_s };
    let request = ReposeRequest {
        powder: powder.clone(),
        run: *run,
        procedure,
        rig,
        labels: arguments.labels.all()?,
        ..ReposeRequest::default()
    };
    let measured = with_bench(common, &arguments.bench, async |lab| {
        let (Job { id, .. }, _) = lab.start_repose(request).await?;
        Watch::new().job(lab, &id, powder).await?;
        Ok(lab.repose(&id).await?)
    })?;
    common.print(&measured, || text(&measured))
}

fn text(measured: &ReposeMeasurement) -> String {
    let row = |pile: &Pile| {
        let angle = |of: fn(&flip_core::domain::pile::Measurement) -> [f64; 2]| {
            pile.measured
                .as_ref()
                .map(of)
                .map_or_else(|| "-".to_owned(), |[deg, u]| format!("{deg:.2} ({u:.2})"))
        };
        let tip = angle(|m| [m.tip.deg, m.tip.u_deg]);
        let cone = angle(|m| [m.cone.deg, m.cone.u_deg]);
        let refusal = pile.refusal.clone().unwrap_or_default();
        vec![pile.number.to_string(), tip, cone, pile.frames.len().to_string(), refusal]
    };
    let rows: Vec<Vec<String>> = measured.piles.iter().map(row).collect();
    let table =
        table(&["pile", "tip deg (u)", "cone deg (u)", "frames", "no angle because"], &rows);
    let Some(result) = &measured.result else { return table };
    let repeats = &result.repeats;
    let registered = match result.registered {
        true => "It is the powder's newest measurement.",
        false => "It was not registered: nobody has measured the powder on an emulated bench.",
    };
    format!(
        "{table}\n\n{}: angle of repose {:.2} deg, SD over {} piles {:.2}, standard uncertainty {:.2}; by the cone {:.2} deg, SD {:.2}, u {:.2}.\n{registered}",
        measured.powder,
        repeats.tip.repose_deg,
        repeats.tip.n,
        repeats.tip.sd_deg,
        repeats.tip_u_deg,
        repeats.cone.repose_deg,
        repeats.cone.sd_deg,
        repeats.cone_u_deg,
    )
}
