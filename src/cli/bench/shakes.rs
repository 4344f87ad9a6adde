//! `flip bench calibrate-shake`: the arm's actual shakes against the commanded ones.

use super::super::Common;
use super::super::benches::read;
use super::super::failure::Failure;
use super::super::session::with_writer;
use super::super::table::table;
use flip_bench::hardware::conformance::Looked;
use flip_bench::hardware::shake_calibration::{Calibrated, Error, Plan, calibrate};
use flip_bench::hardware::wire::Tap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Arguments of `flip bench calibrate-shake`.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct Arguments {
    /// Bench file that names the arm.
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Commanded amplitudes, mm, comma-separated; the arm's maximum is not exceeded.
    #[arg(long, value_name = "MM,…", value_delimiter = ',', default_values_t = [2.0, 4.0, 8.0, 12.0, 16.0])]
    amplitudes_mm: Vec<f64>,
    /// Shakes per amplitude.
    #[arg(long, value_name = "N", default_value_t = 3)]
    repeats: u32,
    /// Name of the person who checked the spoon.
    #[arg(long, value_name = "NAME")]
    by: String,
    /// Confirm that the spoon holds no powder and the arm's path is clear; it shakes away from the
    /// vial.
    #[arg(long)]
    spoon_empty: bool,
}

/// Requests the end of the work when dropped, as by Ctrl-C.
struct EndOnDrop(Arc<AtomicBool>);

impl Drop for EndOnDrop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::SeqCst);
    }
}

/// Shakes an empty spoon, stores the fitted line through the executed shakes, and prints it.
///
/// The data folder is held meanwhile, so that no server weighs on the same bench.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let file = read("config", &arguments.config)?;
    let looked = Looked::by(&arguments.by, arguments.spoon_empty, false)?;
    let Arguments { amplitudes_mm, repeats, .. } = arguments.clone();
    let plan = Plan { amplitudes_mm, repeats, seed: common.seed }.checked()?;
    let found = with_writer(common, async |lab| {
        if let Some(latch) = lab.bench().await?.latch {
            return Err(Failure::NotNow(format!(
                "the bench is latched: {}; `flip bench clear` it first",
                latch.reason
            )));
        }
        let stop = Arc::new(AtomicBool::new(false));
        let _end = EndOnDrop(stop.clone());
        let (file, plan, looked) = (file.clone(), plan.clone(), looked.clone());
        let shaking = tokio::task::spawn_blocking(move || {
            calibrate(&file, plan, &looked, &stop, &Tap::none())
        });
        let found = shaking.await.map_err(anyhow::Error::from)?.map_err(failure)?;
        lab.here()?.keep_shakes(&found.calibration).await?;
        Ok(found)
    })?;
    common.print(&found, || text(&found))
}

fn failure(error: Error) -> Failure {
    match error {
        Error::Field(error) => error.into(),
        error => Failure::Failed(error.into()),
    }
}

fn text(found: &Calibrated) -> String {
    let mut shakes: Vec<_> = found.shakes.iter().collect();
    shakes.sort_by(|a, b| a.shake.commanded_mm.total_cmp(&b.shake.commanded_mm));
    let streamed =
        |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"));
    let rows: Vec<Vec<String>> = shakes
        .iter()
        .map(|it| {
            vec![
                format!("{:.2}", it.shake.commanded_mm),
                format!("{:.2}", it.shake.executed_mm),
                streamed(it.streamed_mm),
                format!("{:.1}", it.shake.planned_mm_s),
                format!("{:.1}", it.shake.peak_mm_s),
            ]
        })
        .collect();
    let header = ["commanded mm", "executed mm", "seen mm", "planned mm/s", "peak mm/s"];
    let line = &found.calibration;
    let mut lines = vec![
        format!("arm        {}", found.arm),
        table(&header, &rows),
        format!(
            "amplitude  executed = {:.3} commanded {:+.3} mm, SD {:.3} mm",
            line.gain, line.offset_mm, line.scatter_mm
        ),
        format!("speed      {:.3} of what was planned", line.speed_gain),
    ];
    lines.extend(found.notes.iter().map(|note| format!("note       {note}")));
    lines.join("\n")
}
