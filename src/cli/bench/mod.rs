//! `flip bench`: the bench and its devices, and the cost of the simulator on this machine compared
//! with others on the same scene.

mod check;
mod clock;
mod ours;
mod peers;
mod probe;
mod roofline;
mod scale;
pub(super) mod several;
mod shakes;
mod sim;
mod text;
mod turns;
mod upkeep;

use super::Common;
use super::failure::Failure;
use flip_core::domain::FieldError;
use flip_sim::column;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Allowed number of grains in a bed: fewer do not form a column, more take hours.
const PARTICLES: std::ops::RangeInclusive<u32> = 100..=200_000;

/// Arguments of `flip bench`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Show the bench, whether it may be used, and its balance's repeatability; works while a
    /// server runs.
    Status(several::NameArguments),
    /// List the benches: which process has each, what waits there, what its container holds.
    List,
    /// Say what powder is in a bench's container, so that weighings that ask for any bench find it.
    Load(several::LoadArguments),
    /// Stop all motion on a bench, whichever process has it. Not an emergency stop.
    Stop(several::StopArguments),
    /// Clear a latched bench or arm after a person has checked it: weighings may go on.
    Clear(upkeep::ClearArguments),
    /// Let weighings start again after a stop.
    Resume(upkeep::ResumeArguments),
    /// Reserve the bench for a limited time.
    Reserve(turns::ReserveArguments),
    /// Release the bench before the reservation ends.
    Release(turns::ReleaseArguments),
    /// Confirm that the vial is in for the weighing whose turn it is, and wait until the dose has
    /// ended.
    VialReady(turns::VialReadyArguments),
    /// Show what the balance reads while nothing is dosed.
    Read(scale::ReadArguments),
    /// Tare the balance while nothing is dosed.
    Tare(scale::ZeroArguments),
    /// Set the balance's zero point while nothing is dosed.
    Zero(scale::ZeroArguments),
    /// Find out which balance is connected.
    Probe(probe::Arguments),
    /// Test every device in a bench file, without powder.
    Check(check::Arguments),
    /// Measure the arm's actual shakes against the commanded ones.
    CalibrateShake(shakes::Arguments),
    /// Record a repeatability check of the balance: ten or more weighings of one test weight.
    Repeatability(upkeep::RepeatabilityArguments),
    /// Time the simulator, alone or against others, in processor seconds per simulated second.
    Sim(sim::Arguments),
    /// Write a settled bed for another simulator, one `x,y,z` in metres per line.
    Bed(BedArguments),
}

/// Arguments of `flip bench bed`.
#[derive(Debug, clap::Args)]
struct BedArguments {
    /// Number of grains, 100 to 200000.
    #[arg(long, value_name = "N", default_value_t = 2000, allow_negative_numbers = true)]
    particles: u32,
    /// File to write.
    #[arg(value_name = "FILE")]
    file: PathBuf,
}

/// The document of `flip bench bed`.
#[derive(Debug, Serialize)]
struct BedDocument {
    particles: u32,
    diameter_m: f64,
    height_m: f64,
    file: PathBuf,
    simulator: &'static str,
}

/// Runs the chosen subcommand and prints its result.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.what {
        What::Status(arguments) => upkeep::status(common, arguments),
        What::List => several::list(common),
        What::Load(arguments) => several::load(common, arguments),
        What::Stop(arguments) => several::stop(common, arguments),
        What::Clear(arguments) => upkeep::clear(common, arguments),
        What::Resume(arguments) => upkeep::resume(common, arguments),
        What::Reserve(arguments) => turns::reserve(common, arguments),
        What::Release(arguments) => turns::release(common, arguments),
        What::VialReady(arguments) => turns::vial_ready(common, arguments),
        What::Repeatability(arguments) => upkeep::repeatability(common, arguments),
        What::Read(arguments) => scale::read(common, arguments),
        What::Tare(arguments) => scale::tare(common, arguments),
        What::Zero(arguments) => scale::zero(common, arguments),
        What::Probe(arguments) => probe::run(common, arguments),
        What::Check(arguments) => check::run(common, arguments),
        What::CalibrateShake(arguments) => shakes::run(common, arguments),
        What::Sim(arguments) => sim::run(common, arguments),
        What::Bed(arguments) => bed(common, arguments),
    }
}

fn bed(common: &Common, arguments: &BedArguments) -> Result<(), Failure> {
    require_particles("particles", arguments.particles)?;
    let centres = settle(arguments.particles)?;
    write_bed(&arguments.file, &centres)?;
    let document = BedDocument {
        particles: arguments.particles,
        diameter_m: column::DIAMETER_M,
        height_m: centres.iter().fold(0.0, |top, x| x[2].max(top)) + column::DIAMETER_M / 2.0,
        file: arguments.file.clone(),
        simulator: flip_sim::VERSION,
    };
    common.print(&document, || {
        format!("{} grains in {}", document.particles, document.file.display())
    })
}

fn require_particles(field: &'static str, particles: u32) -> Result<(), FieldError> {
    if PARTICLES.contains(&particles) {
        return Ok(());
    }
    let message = format!(
        "must be from {} to {} grains, got {particles}",
        PARTICLES.start(),
        PARTICLES.end()
    );
    Err(FieldError::new(field, message))
}

/// A bed made by the simulator itself.
fn settle(particles: u32) -> Result<Vec<[f64; 3]>, Failure> {
    column::bed(particles)
        .map_err(|cause| Failure::Failed(anyhow::anyhow!("the bed of {particles}: {cause}")))
}

fn write_bed(file: &Path, centres: &[[f64; 3]]) -> Result<(), Failure> {
    let lines: Vec<String> =
        centres.iter().map(|[x, y, z]| format!("{x:.9e},{y:.9e},{z:.9e}\n")).collect();
    Ok(std::fs::write(file, lines.concat())?)
}

/// Reads a bed written by [`write_bed`] or another program.
fn read_bed(file: &Path) -> Result<Vec<[f64; 3]>, Failure> {
    let bad = |line: usize| {
        let message = format!("{}: line {line} is not `x,y,z`", file.display());
        FieldError::new("peers", message)
    };
    let text = std::fs::read_to_string(file)?;
    let centre = |(number, line): (usize, &str)| {
        let numbers: Result<Vec<f64>, _> =
            line.split(',').map(|cell| cell.trim().parse()).collect();
        numbers
            .ok()
            .and_then(|n| <[f64; 3]>::try_from(n).ok())
            .ok_or_else(|| bad(number + 1).into())
    };
    text.lines().enumerate().map(centre).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bed_survives_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("bed.csv");
        let centres = [[1.25e-4, -3.0e-3, 0.5], [0.0, 1.0e-9, 2.0]];
        write_bed(&file, &centres).unwrap();
        assert_eq!(read_bed(&file).unwrap(), centres);
        std::fs::write(&file, "1,2,3\n1,2\n").unwrap();
        assert!(format!("{:?}", read_bed(&file).unwrap_err()).contains("line 2"));
    }
}
