//! `flip jobs`: the job list, even while a server runs.

use super::Common;
use super::failure::Failure;
use super::labels::label;
use super::session::with_reader;
use super::table::table;
use crate::app::{Job, JobTimes, JobsWanted, PageQuery, Worker};
use clap::ValueEnum;
use flip_core::domain::job::{JobKind, JobState};
use flip_core::domain::labels::LabelWanted;

/// Arguments of `flip jobs`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// How long jobs took on this machine, by kind, instead of the list.
    #[arg(long, conflicts_with_all = ["kind", "state", "label", "after"])]
    times: bool,
    /// The processes that compute jobs, instead of the list: what each does, and when it was last
    /// heard of.
    #[arg(long, conflicts_with_all = ["times", "kind", "state", "label", "after"])]
    workers: bool,
    /// Only jobs of this kind.
    #[arg(long, value_enum)]
    kind: Option<KindFlag>,
    /// Only jobs in this state.
    #[arg(long, value_enum)]
    state: Option<StateFlag>,
    /// Only jobs with this label, as `plate:A7`.
    #[arg(long, value_name = "KEY:VALUE", value_parser = label)]
    label: Option<LabelWanted>,
    /// Maximum number of jobs to list, 1 to 200; newest first.
    #[arg(long, value_name = "N", default_value_t = 50, allow_negative_numbers = true)]
    limit: u32,
    /// Continue after this cursor, `next` of the previous list.
    #[arg(long, value_name = "CURSOR")]
    after: Option<String>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
pub(super) enum KindFlag {
    Calibration,
    Training,
    Evaluation,
    Investigation,
    /// Angle of repose from piles under a camera.
    Repose,
    /// The grains of a weighing's spoonful.
    Film,
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
    if arguments.times {
        let times = with_reader(common, async |lab| Ok(lab.job_times().await?))?;
        return common.print(&times, || times_text(&times));
    }
    if arguments.workers {
        let workers = with_reader(common, async |lab| Ok(lab.workers().await?))?;
        return common.print(&workers, || workers_text(&workers));
    }
    let page = PageQuery {
        limit: Some(arguments.limit),
        after: arguments.after.clone(),
        ..PageQuery::default()
    };
    let kind = arguments.kind.map(JobKind::from);
    let state = arguments.state.map(JobState::from);
    let wanted = JobsWanted { kind, state, label: arguments.label.clone() };
    let jobs = with_reader(common, async |lab| Ok(lab.jobs(wanted, page).await?))?;
    common.print(&jobs, || text(&jobs.items))
}

fn word(value: serde_json::Result<serde_json::Value>) -> String {
    value.ok().and_then(|value| value.as_str().map(str::to_owned)).unwrap_or_default()
}

fn times_text(times: &[JobTimes]) -> String {
    let row = |it: &JobTimes| {
        vec![
            word(serde_json::to_value(it.sort.kind)),
            it.sort.method.clone().unwrap_or_default(),
            it.n.to_string(),
            format!("{:.0}", it.lower_s),
            format!("{:.0}", it.median_s),
            format!("{:.0}", it.upper_s),
        ]
    };
    table(
        &["kind", "method", "n", "quartile s", "median s", "quartile s"],
        &times.iter().map(row).collect::<Vec<_>>(),
    )
}

fn workers_text(workers: &[Worker]) -> String {
    let row = |it: &Worker| {
        let kinds = it.kinds.iter().map(|kind| word(serde_json::to_value(kind)));
        vec![
            it.name.clone(),
            if it.serves { "serves" } else { "" }.to_owned(),
            it.threads.to_string(),
            it.card.clone().unwrap_or_default(),
            kinds.collect::<Vec<_>>().join(", "),
            it.heard_at.to_string(),
            if it.ended_at.is_some() { "has ended".to_owned() } else { it.jobs.join(", ") },
        ]
    };
    table(
        &["worker", "", "threads", "card", "takes", "last heard of", "computes"],
        &workers.iter().map(row).collect::<Vec<_>>(),
    )
}

fn text(jobs: &[Job]) -> String {
    let row = |job: &Job| {
        vec![
            job.id.clone(),
            word(serde_json::to_value(job.kind)),
            of(job),
            word(serde_json::to_value(job.state)),
            format!("{:.0} %", 100.0 * job.progress.fraction),
            when(job),
            job.error.clone().unwrap_or_else(|| job.progress.message.clone()),
        ]
    };
    table(
        &["job", "kind", "of", "state", "done", "left", "message"],
        &jobs.iter().map(row).collect::<Vec<_>>(),
    )
}

/// What it is about: its policy and powders, or the angle that it aims at.
fn of(job: &Job) -> String {
    let subject = &job.subject;
    let powders = match (&subject.powders[..], subject.repose_deg) {
        ([], Some(deg)) => format!("{deg:.2}°"),
        (powders, _) => powders.join(", "),
    };
    let device = if subject.device.is_cpu() { "" } else { ", by a card" };
    match &subject.policy {
        Some(policy) => format!("{policy} on {powders}{device}"),
        None => format!("{powders}{device}"),
    }
}

/// Time left, or its place in the queue.
fn when(job: &Job) -> String {
    match (job.place, job.left_s) {
        (Some(place), _) => format!("place {place}"),
        (None, Some(left_s)) => format!("about {left_s:.0} s"),
        (None, None) => String::new(),
    }
}

impl From<KindFlag> for JobKind {
    fn from(flag: KindFlag) -> Self {
        match flag {
            KindFlag::Calibration => Self::Calibration,
            KindFlag::Training => Self::Training,
            KindFlag::Evaluation => Self::Evaluation,
            KindFlag::Investigation => Self::Investigation,
            KindFlag::Repose => Self::Repose,
            KindFlag::Film => Self::Film,
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
