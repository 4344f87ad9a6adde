//! `flip bench reserve|release|vial-ready`: turns on the bench.

use super::super::Common;
use super::super::benches::BenchArguments;
use super::super::failure::Failure;
use super::super::session::{with_bench, with_writer};
use super::super::weigh::{ended, report};
use crate::app::{ReservationRequest, VialReadyRequest};

/// Arguments of `flip bench reserve`.
#[derive(Debug, clap::Args)]
pub(in super::super) struct ReserveArguments {
    /// Who reserves the bench.
    #[arg(long, value_name = "NAME")]
    owner: String,
    /// Duration from now, s, 1 to 86400.
    #[arg(long, value_name = "S")]
    seconds: u32,
    /// Your own reservation, to extend it.
    #[arg(long, value_name = "ID")]
    id: Option<String>,
}

/// Arguments of `flip bench release`.
#[derive(Debug, clap::Args)]
pub(in super::super) struct ReleaseArguments {
    /// Reservation id.
    #[arg(value_name = "ID")]
    id: String,
}

/// Arguments of `flip bench vial-ready`.
#[derive(Debug, clap::Args)]
pub(in super::super) struct VialReadyArguments {
    /// Weighing id.
    #[arg(value_name = "ID")]
    id: String,
    /// Name of the person confirming.
    #[arg(long, value_name = "NAME")]
    by: Option<String>,
    /// Label on the vial.
    #[arg(long, value_name = "TEXT")]
    vial: Option<String>,
    #[command(flatten)]
    bench: BenchArguments,
}

/// Reserves the bench for a while.
pub(in super::super) fn reserve(
    common: &Common,
    arguments: &ReserveArguments,
) -> Result<(), Failure> {
    let ReserveArguments { owner, seconds, id } = arguments;
    let request = ReservationRequest { owner: owner.clone(), seconds: *seconds, id: id.clone() };
    let reserved = with_writer(common, async |lab| Ok(lab.reserve_bench(request).await?))?;
    common.print(&reserved, || {
        format!("{} has the bench until {}: {}", reserved.owner, reserved.until, reserved.id)
    })
}

/// Releases the bench.
pub(in super::super) fn release(
    common: &Common,
    arguments: &ReleaseArguments,
) -> Result<(), Failure> {
    let found = with_writer(common, async |lab| Ok(lab.release_bench(&arguments.id).await?))?;
    common.print(&found, || "nobody has the bench for himself any more".to_owned())
}

/// Confirms that a vial is in, and waits for the dose.
pub(in super::super) fn vial_ready(
    common: &Common,
    arguments: &VialReadyArguments,
) -> Result<(), Failure> {
    let VialReadyArguments { id, by, vial, bench } = arguments;
    let said = VialReadyRequest { by: by.clone(), vial: vial.clone() };
    let weighing = with_bench(common, bench, async |lab| ended(lab, id, &said).await)?;
    report(common, weighing)
}
