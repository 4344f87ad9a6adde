//! `flip bench list|load|stop`, and the commands that take `--bench-name`: benches of any process.

use super::super::Common;
use super::super::failure::Failure;
use super::super::session::{beside, with_reader};
use super::super::table::table;
use super::upkeep::text as status_text;
use crate::app::{BenchRow, DEFAULT_BENCH, LoadRequest};
use flip_core::domain::FieldError;

/// Which bench, by its name.
#[derive(Debug, Clone, Default, clap::Args)]
pub(in super::super) struct NameArguments {
    /// Name of a bench (`flip bench list`) [default: the one of the service or the data folder].
    #[arg(long, value_name = "NAME")]
    pub(in super::super) bench_name: Option<String>,
}

/// Arguments of `flip bench load`.
#[derive(Debug, clap::Args)]
pub(in super::super) struct LoadArguments {
    /// Powder id; without it the container is empty.
    #[arg(long, value_name = "ID")]
    powder: Option<String>,
    /// Lot of the powder.
    #[arg(long, value_name = "TEXT", requires = "powder")]
    lot: Option<String>,
    #[command(flatten)]
    name: NameArguments,
}

/// Arguments of `flip bench stop`.
#[derive(Debug, clap::Args)]
pub(in super::super) struct StopArguments {
    /// Name of the bench.
    #[arg(long, value_name = "NAME")]
    bench_name: String,
}

impl NameArguments {
    /// The named bench, if one is; it is reached through a server or a server's database.
    pub(in super::super) fn named(&self, common: &Common) -> Result<Option<&str>, Failure> {
        let Some(name) = self.bench_name.as_deref() else { return Ok(None) };
        check_reach(common, name).map(|()| Some(name))
    }
}

fn check_reach(common: &Common, name: &str) -> Result<(), Failure> {
    if common.server()?.is_some() || common.storage()?.is_on_server() || name == DEFAULT_BENCH {
        return Ok(());
    }
    let advice = format!(
        "a data folder has one bench, which needs no name: leave --bench-name {name} out, or name a service (--server) or a server's database (--database-url)"
    );
    Err(FieldError::new("bench_name", advice).into())
}

/// Prints all benches.
pub(in super::super) fn list(common: &Common) -> Result<(), Failure> {
    let found = with_reader(common, async |lab| Ok(lab.benches().await?))?;
    common.print(&found, || benches_text(&found))
}

/// Says what a bench's container holds.
pub(in super::super) fn load(common: &Common, arguments: &LoadArguments) -> Result<(), Failure> {
    let name = arguments.name.named(common)?.map(str::to_owned);
    let LoadArguments { powder, lot, .. } = arguments;
    let request = LoadRequest { powder: powder.clone(), lot: lot.clone() };
    let loaded = beside(common, async |lab| {
        let name = name.as_deref().unwrap_or(DEFAULT_BENCH);
        Ok(lab.load_bench(name, request).await?)
    })?;
    common.print(&loaded, || benches_text(std::slice::from_ref(&loaded)))
}

/// Stops a bench, wherever its process runs.
pub(in super::super) fn stop(common: &Common, arguments: &StopArguments) -> Result<(), Failure> {
    let name = &arguments.bench_name;
    check_reach(common, name)?;
    let found = beside(common, async |lab| Ok(lab.stop_bench_named(name).await?))?;
    common.print(&found, || status_text(&found))
}

fn benches_text(benches: &[BenchRow]) -> String {
    let row = |it: &BenchRow| {
        let holds = it.holds.as_ref().map(|holds| match &holds.lot {
            Some(lot) => format!("{} ({lot})", holds.powder),
            None => holds.powder.clone(),
        });
        let state = match (&it.latch, &it.held, &it.moving) {
            _ if !it.served && it.machine.is_some() => "no process has it",
            (Some(_), ..) => "latched",
            (_, Some(_), _) => "held",
            (_, _, Some(_)) => "moves",
            _ if it.served => "free",
            // Beside a server that holds the data folder.
            _ => "",
        };
        vec![
            it.name.clone(),
            it.kind.map_or("", |kind| kind.name()).to_owned(),
            it.machine.clone().unwrap_or_default(),
            state.to_owned(),
            it.waiting.to_string(),
            holds.unwrap_or_default(),
        ]
    };
    table(
        &["bench", "kind", "on", "state", "waiting", "holds"],
        &benches.iter().map(row).collect::<Vec<_>>(),
    )
}
