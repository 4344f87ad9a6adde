//! `flip jobs`: the job list, even while a server runs.

use super::Common;
use super::failure::Failure;
use super::session::with_reader;
use super::table::table;
use crate::app::{Job, PageQuery};
use clap::ValueEnum;
use flip_core::domain::job::{JobKind, JobState};

/// Arguments of `flip jobs`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Only jobs of this kind.
    #[arg(long, value_enum)]
    kind: Option<KindFlag>,
    /// Only jobs in this state.
    #[arg(long, value_enum)]
    state: Option<StateFlag>,
    /// Maximum number of jobs to list, 1 to 200; newest first.
    #[arg(long, value_name = "N", default_value_t = 50, allow_negative_numbers = true)]
    limit: u32,
    /// Continue after this cursor, `next` of the previous list.
    #[arg(long, value_name = "CURSOR")]
    after: Option<String>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum KindFlag {
    Calibration,
    Training,
    Evaluation,
    Investigation,
    /// Angle of repose from piles under a camera.
    Repose,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum StateFlag {
    Queued,
    Running,
    Succeeded,
    Failed,
    Cancelled,
}

/// Prints the job list.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let page = PageQuery { limit: Some(arguments.limit), after: arguments.after.clone() };
    let kind = arguments.kind.map(JobKind::from);
    let state = arguments.state.map(JobState::from);
    let jobs = with_reader(common, async |app| Ok(app.jobs(kind, state, page).await?))?;
    common.print(&jobs, || text(&jobs.items))
}

fn text(jobs: &[Job]) -> String {
    let word = |value: serde_json::Result<serde_json::Value>| {
        value.ok().and_then(|value| value.as_str().map(str::to_owned)).unwrap_or_default()
    };
    let row = |job: &Job| {
        vec![
            job.id.clone(),
            word(serde_json::to_value(job.kind)),
            word(serde_json::to_value(job.state)),
            format!("{:.0} %", 100.0 * job.progress.fraction),
            job.error.clone().unwrap_or_else(|| job.progress.message.clone()),
        ]
    };
    table(&["job", "kind", "state", "done", "message"], &jobs.iter().map(row).collect::<Vec<_>>())
}

impl From<KindFlag> for JobKind {
    fn from(flag: KindFlag) -> Self {
        match flag {
            KindFlag::Calibration => Self::Calibration,
            KindFlag::Training => Self::Training,
            KindFlag::Evaluation => Self::Evaluation,
            KindFlag::Investigation => Self::Investigation,
            KindFlag::Repose => Self::Repose,
        }
    }
}

impl From<StateFlag> for JobState {
    fn from(flag: StateFlag) -> Self {
        match flag {
            StateFlag::Queued => Self::Queued,
            StateFlag::Running => Self::Running,
            StateFlag::Succeeded => Self::Succeeded,
            StateFlag::Failed => Self::Failed,
            StateFlag::Cancelled => Self::Cancelled,
        }
    }
}
