//! FLIP as a laboratory would spread it over machines, on this one: a private PostgreSQL that waits
//! for its disk, servers with an emulated bench each, workers.
//!
//! `cargo run --release --example cluster -- demonstration [arguments of flip demo]` and `… -- faults
//! [share of the faults, %] [seed]`, or `make cluster` and `make faults`; `FLIP_BIN` is the program.

mod clocks;
mod demonstration;
mod faults;
mod process;

use anyhow::{Context, Result, bail};
use flip_testing::Cluster;
use process::Flip;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let program = std::env::var_os("FLIP_BIN").context("set FLIP_BIN to the program flip")?;
    let program = std::fs::canonicalize(program)?;
    let cluster = Cluster::start(true).map_err(anyhow::Error::msg)?;
    let folder = tempfile::tempdir()?;
    let runtime = tokio::runtime::Runtime::new()?;
    let url = runtime.block_on(cluster.database_of(folder.path()));
    let files = folder.path().join("files");
    let flip = Flip { program, files, url, artifacts: None, clocks: None };
    match arguments.split_first() {
        Some((what, rest)) if what == "demonstration" => {
            demonstration::run(&flip, folder.path(), rest)
        }
        Some((what, rest)) if what == "faults" => {
            runtime.block_on(faults::run(&flip, &cluster, folder.path(), rest))
        }
        _ => bail!("what: demonstration or faults"),
    }
}
