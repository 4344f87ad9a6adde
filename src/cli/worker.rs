//! `flip worker`: computes the jobs of a database on a server, beside the process that serves it.

use super::Common;
use super::failure::Failure;
use super::jobs::KindFlag;
use super::serve::LogFormat;
use super::session::{StopSignals, runtime};
use crate::app::{Crew, Functions, Hired, compute_on};
use crate::telemetry;
use flip_core::domain::FieldError;
use flip_core::domain::job::JobKind;
use serde::Serialize;

/// The most threads that a worker is given.
const THREADS_MAX: u32 = 1024;

/// Arguments of `flip worker`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Take only jobs of these kinds, such as calibration,training; all but measurements on the
    /// bench if left out.
    #[arg(long, value_enum, value_name = "KIND,KIND", value_delimiter = ',')]
    kinds: Vec<KindFlag>,
    /// Threads to compute on, 1 to 1024; as many as there are cores if left out.
    #[arg(long, value_name = "N")]
    threads: Option<u32>,
    /// Name by which people know this worker; the machine's if left out.
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Format of log lines on stderr.
    #[arg(long, value_enum, default_value_t = LogFormat::Text)]
    log_format: LogFormat,
}

/// Document printed once it takes jobs.
#[derive(Debug, Serialize)]
struct Document<'a> {
    worker: &'a str,
    name: &'a str,
    kinds: &'a [JobKind],
    threads: u32,
    /// Its graphics card, on which it computes jobs that ask for one; none without one.
    card: Option<&'a str>,
}

/// Computes jobs until asked to stop.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    telemetry::start(arguments.log_format.into(), telemetry::SERVICE);
    let crew = arguments.crew()?;
    if common.database_url.is_none() {
        let why = "a worker computes the jobs of a database on a server: name it here or in FLIP_DATABASE_URL";
        return Err(FieldError::new("database_url", why).into());
    }
    compute_on(crew.threads as usize);
    let storage = common.storage()?;
    runtime()?.block_on(async {
        let mut signals = StopSignals::catch()?;
        let hired = Hired::start(&storage, crew.clone(), Functions::default()).await?;
        let document = Document {
            worker: hired.id(),
            name: &crew.name,
            kinds: &crew.kinds,
            threads: crew.threads,
            card: hired.card(),
        };
        let shown = common.print(&document, || {
            let card = hired.card().map_or_else(String::new, |card| format!(" and {card}"));
            format!("worker {} on {} threads{card}, for {storage}", crew.name, crew.threads)
        });
        if shown.is_err() {
            tracing::warn!("nobody reads stdout");
        }
        let signal = signals.received().await;
        tracing::info!(signal, "saves what it computes and ends");
        hired.shutdown().await;
        Ok(())
    })
}

impl Arguments {
    fn crew(&self) -> Result<Crew, Failure> {
        let mut crew = Crew::default();
        if let Some(threads) = self.threads {
            if !(1..=THREADS_MAX).contains(&threads) {
                let why = format!("{threads} threads; 1 to {THREADS_MAX} are possible");
                return Err(FieldError::new("threads", why).into());
            }
            crew.threads = threads;
        }
        if let Some(name) = &self.name {
            let name = name.trim();
            if name.is_empty() || name.chars().count() > 100 {
                return Err(FieldError::new("name", "a name has 1 to 100 characters").into());
            }
            name.clone_into(&mut crew.name);
        }
        let wanted: Vec<JobKind> = self.kinds.iter().map(|kind| JobKind::from(*kind)).collect();
        for kind in &wanted {
            if *kind == JobKind::Repose {
                let why =
                    "a measurement of an angle of repose is of the process that has the bench";
                return Err(FieldError::new("kinds", why).into());
            }
            if !crew.kinds.contains(kind) {
                let why = "this program was built without libtorch and cannot train";
                return Err(FieldError::new("kinds", why).into());
            }
        }
        crew.kinds.retain(|kind| {
            *kind != JobKind::Repose && (wanted.is_empty() || wanted.contains(kind))
        });
        Ok(crew)
    }
}
