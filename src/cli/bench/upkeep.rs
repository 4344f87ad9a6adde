//! `flip bench status|clear|resume|repeatability`: a person's work on a bench.

use super::super::Common;
use super::super::benches::BenchArguments;
use super::super::failure::Failure;
use super::super::session::{beside, with_idle_bench, with_reader, with_writer};
use super::several::NameArguments;
use crate::app::{BenchStatus, ClearRequest, RepeatabilityRequest, ResumeRequest};
use flip_core::domain::bench::BenchKind;

/// Arguments of `flip bench clear`.
#[derive(Debug, clap::Args)]
pub(in super::super) struct ClearArguments {
    /// Name of the person who checked the bench.
    #[arg(long, value_name = "NAME")]
    by: String,
    /// What was found and done.
    #[arg(long, value_name = "TEXT", default_value = "")]
    note: String,
    /// Confirm that spoon, vial and balance were checked.
    #[arg(long)]
    looked: bool,
    /// Confirm that the vial is empty or new and that the balance will be tared.
    #[arg(long)]
    vial_ready: bool,
    /// Let waiting weighings start at the next start-up, even after a stop; otherwise the bench is
    /// held.
    #[arg(long)]
    resume: bool,
    /// A bench of devices needs its bench file, so that its arm is notified.
    #[command(flatten)]
    bench: BenchArguments,
    #[command(flatten)]
    name: NameArguments,
}

/// Arguments of `flip bench resume`.
#[derive(Debug, clap::Args)]
pub(in super::super) struct ResumeArguments {
    /// Name of the person resuming.
    #[arg(long, value_name = "NAME")]
    by: String,
    /// What was found and done.
    #[arg(long, value_name = "TEXT", default_value = "")]
    note: String,
    #[command(flatten)]
    name: NameArguments,
}

/// Arguments of `flip bench repeatability`.
#[derive(Debug, Clone, clap::Args)]
pub(in super::super) struct RepeatabilityArguments {
    /// Readings of one test weight, mg, reloaded for each reading; at least ten, comma-separated.
    #[arg(long, value_name = "MG,…", value_delimiter = ',', allow_negative_numbers = true)]
    readings_mg: Vec<f64>,
    /// Readability (display step) of the balance, mg.
    #[arg(long, value_name = "MG", default_value_t = 1.0)]
    readability_mg: f64,
}

/// Prints the state of the bench and whether it may be used.
pub(in super::super) fn status(common: &Common, name: &NameArguments) -> Result<(), Failure> {
    let name = name.named(common)?;
    let found = with_reader(common, async |lab| match name {
        Some(name) => Ok(lab.bench_named(name).await?),
        None => Ok(lab.bench().await?),
    })?;
    common.print(&found, || text(&found))
}

/// Clears the bench after a person's check: weighings may go on.
pub(in super::super) fn clear(common: &Common, arguments: &ClearArguments) -> Result<(), Failure> {
    let ClearArguments { by, note, looked, vial_ready, resume, bench, name } = arguments;
    let (looked, vial_ready, resume) = (*looked, *vial_ready, *resume);
    let request = ClearRequest { by: by.clone(), note: note.clone(), looked, vial_ready, resume };
    let found = match name.named(common)? {
        Some(name) => beside(common, async |lab| Ok(lab.clear_bench_named(name, request).await?))?,
        None => with_idle_bench(common, bench, async |lab| Ok(lab.clear_bench(request).await?))?,
    };
    common.print(&found, || text(&found))
}

/// Lets weighings start again after a stop.
pub(in super::super) fn resume(
    common: &Common,
    arguments: &ResumeArguments,
) -> Result<(), Failure> {
    let request = ResumeRequest { by: arguments.by.clone(), note: arguments.note.clone() };
    let found = match arguments.name.named(common)? {
        Some(name) => {
            beside(common, async |lab| Ok(lab.resume_bench_named(name, request).await?))?
        }
        None => with_writer(common, async |lab| Ok(lab.resume_bench(request).await?))?,
    };
    common.print(&found, || text(&found))
}

/// Stores a repeatability check of the balance.
pub(in super::super) fn repeatability(
    common: &Common,
    arguments: &RepeatabilityArguments,
) -> Result<(), Failure> {
    let RepeatabilityArguments { readings_mg, readability_mg } = arguments.clone();
    let request = RepeatabilityRequest { readings_mg, readability_mg };
    let found = with_writer(common, async |lab| Ok(lab.check_repeatability(request).await?))?;
    common.print(&found, || {
        format!(
            "SD {:.3} mg over {} weighings\nmay weigh from {:.0} mg at 0.1 %, from {:.0} mg at 1 %",
            found.sd_mg,
            found.readings_mg.len(),
            found.minimum_mg(0.001),
            found.minimum_mg(0.01)
        )
    })
}

fn kind(found: &BenchStatus) -> &'static str {
    match found.kind {
        Some(BenchKind::Simulated) => "simulated",
        Some(BenchKind::Emulated) => "emulated",
        Some(BenchKind::Devices) => "devices",
        None => "another process has it",
    }
}

pub(super) fn text(found: &BenchStatus) -> String {
    let mut lines = vec![format!("bench      {}", kind(found))];
    lines.extend(found.devices.iter().map(|(role, name)| format!("{role:<10} {name}")));
    lines.push(match (&found.latch, &found.held) {
        (Some(latch), _) => format!("latched    since {}: {}", latch.at, latch.reason),
        (None, Some(held)) => format!("held       since {}: {}", held.at, held.reason),
        (None, None) => "free       weighings may be made".to_owned(),
    });
    lines.extend(found.waiting.iter().map(|it| {
        let vial = it.vial.as_ref().map_or_else(String::new, |vial| format!(" into vial {vial}"));
        format!("waits      {} {:.1} mg of {}{vial}", it.id, it.target_mg, it.powder)
    }));
    lines.extend(found.vial.iter().map(|vial| {
        let name = vial.name.as_deref().unwrap_or("of no name");
        let holds =
            vial.holds_mg.map_or_else(|| "an unknown mass".to_owned(), |mg| format!("{mg:.1} mg"));
        format!("vial       {name}, {holds} in it, last by weighing {}", vial.weighing)
    }));
    lines.extend(
        found
            .reservation
            .iter()
            .map(|it| format!("reserved   for {} until {}, {}", it.owner, it.until, it.id)),
    );
    lines.extend(found.moving.iter().map(|id| format!("moving     {id}")));
    lines.extend(
        found
            .piling
            .iter()
            .map(|it| format!("piling     pile {} of measurement {}", it.pile, it.job)),
    );
    lines.extend(
        found.repeatability.iter().map(|check| format!("repeats    SD {:.3} mg", check.sd_mg)),
    );
    lines.join("\n")
}
