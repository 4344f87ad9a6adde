//! What one PostgreSQL carries: jobs, events and doses a second from several processes' connections,
//! what one dose writes, and how soon three servers answer while workers compute.
//!
//! `cargo bench --bench database -- [seconds] [requests a second] [queued jobs]`, or `make
//! bench-database`. The private PostgreSQL waits for its disk; everything shares this machine.

mod rows;
mod service;

use anyhow::Context;
use flip_testing::Cluster;
use std::time::Duration;

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|it| it != "--bench").collect();
    let number = |k: usize, usual: u64| {
        let text = arguments.get(k);
        text.map_or(Ok(usual), |text| text.parse().with_context(|| format!("{text} is no number")))
    };
    let (seconds, rate, queued) = (number(0, 30)?, number(1, 300)?, number(2, 10_000)?);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let cluster = Cluster::start(true).map_err(anyhow::Error::msg)?;
    println!("{cores} processors, {seconds} s each\n");

    let dose = service::dose(&cluster).await?;
    println!(
        "an emulated dose: {} records, {} commits, {:.0} s: {:.1} records and {:.1} commits a second\n",
        dose.records,
        dose.commits,
        dose.seconds,
        dose.records as f64 / dose.seconds,
        dose.commits as f64 / dose.seconds
    );
    rows::print(&cluster, Duration::from_secs(seconds), &dose).await?;
    service::print(&cluster, Duration::from_secs(seconds), rate, queued).await
}

/// The value below which this share of them lies.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let last = sorted.len().saturating_sub(1);
    sorted.get(((sorted.len() as f64 * share) as usize).min(last)).copied().unwrap_or(f64::NAN)
}
