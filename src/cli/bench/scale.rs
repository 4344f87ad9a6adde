//! `flip bench read|tare|zero`: the balance while nothing is dosed.

use super::super::Common;
use super::super::benches::BenchArguments;
use super::super::failure::Failure;
use super::super::session::with_idle_bench;
use crate::app::{BalanceReading, BalanceRequest};

/// Arguments of `flip bench read`.
#[derive(Debug, clap::Args)]
pub(in super::super) struct ReadArguments {
    #[command(flatten)]
    bench: BenchArguments,
}

/// Arguments of `flip bench tare` and `flip bench zero`.
#[derive(Debug, clap::Args)]
pub(in super::super) struct ZeroArguments {
    /// Your reservation of the bench, if you have one.
    #[arg(long, value_name = "ID")]
    reservation: Option<String>,
    #[command(flatten)]
    bench: BenchArguments,
}

/// Prints what the balance shows.
pub(in super::super) fn read(common: &Common, arguments: &ReadArguments) -> Result<(), Failure> {
    let shown =
        with_idle_bench(common, &arguments.bench, async |lab| Ok(lab.read_balance().await?))?;
    common.print(&shown, || text(&shown))
}

/// Tares the balance, and prints what it then shows.
pub(in super::super) fn tare(common: &Common, arguments: &ZeroArguments) -> Result<(), Failure> {
    let request = BalanceRequest { reservation: arguments.reservation.clone() };
    let shown = with_idle_bench(common, &arguments.bench, async |lab| {
        Ok(lab.tare_balance(request).await?)
    })?;
    common.print(&shown, || text(&shown))
}

/// Sets the zero point, and prints what the balance then shows.
pub(in super::super) fn zero(common: &Common, arguments: &ZeroArguments) -> Result<(), Failure> {
    let request = BalanceRequest { reservation: arguments.reservation.clone() };
    let shown = with_idle_bench(common, &arguments.bench, async |lab| {
        Ok(lab.zero_balance(request).await?)
    })?;
    common.print(&shown, || text(&shown))
}

fn text(shown: &BalanceReading) -> String {
    let stable = if shown.stable { "" } else { ", not stable" };
    format!("{:.1} mg{stable}", shown.mass_mg)
}
