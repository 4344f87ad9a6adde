//! Waiting for a job: a progress bar with time left on a terminal, an occasional line elsewhere.
//! Everything goes to stderr.

use super::failure::Failure;
use super::lab::{Lab, Look};
use crate::app::Job;
use crate::telemetry;
use flip_core::domain::job::{JobState, seconds_left};
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

/// How often a job is looked at.
const LOOK: Look = Look { here: Duration::from_millis(200), there_s: 1 };
/// Interval between progress lines if no bar can be drawn.
const SAY_EVERY: Duration = Duration::from_secs(15);
/// Bar positions for a fraction of 1.
const STEPS: f64 = 10_000.0;

/// The bars of one command.
#[derive(Debug)]
pub(super) struct Watch {
    bars: MultiProgress,
    terminal: bool,
}

impl Watch {
    /// Bars on stderr, or lines if stderr is not a terminal.
    pub(super) fn new() -> Self {
        let terminal = std::io::stderr().is_terminal();
        let target =
            if terminal { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        Self { bars: MultiProgress::with_draw_target(target), terminal }
    }

    /// Waits until the job `id` has succeeded, showing its progress under `label`.
    ///
    /// # Errors
    /// The job failed or was cancelled: the job's own reason.
    pub(super) async fn job(&self, lab: &Lab, id: &str, label: &str) -> Result<Job, Failure> {
        let mut line = self.line(label);
        let mut job = lab.job(id).await?;
        loop {
            if job.state.is_terminal() {
                lab.has_ended(id);
            }
            match job.state {
                JobState::Queued => line.wait(&job.progress.message),
                JobState::Running => line.show(job.progress.fraction, &job.progress.message),
                JobState::Succeeded => {
                    line.end("done");
                    return Ok(job);
                }
                JobState::Failed | JobState::Cancelled => {
                    line.end("ended early");
                    let reason = job.error.unwrap_or_else(|| "it was cancelled".into());
                    return Err(Failure::Failed(anyhow::anyhow!("{label}: {reason}")));
                }
            }
            job = lab.job_later(id, LOOK).await?;
        }
    }

    /// Prints `text` above the bars.
    pub(super) fn say(&self, text: &str) {
        // `suspend` lets the bars be redrawn below the line; without a terminal it only prints.
        match self.terminal {
            // A terminal that has gone needs no bars.
            true => self.bars.suspend(|| drop(writeln!(std::io::stderr(), "{text}"))),
            false => telemetry::say(text),
        }
    }

    fn line(&self, label: &str) -> Line {
        let style = ProgressStyle::with_template(
            "{prefix:30} {bar:30} {percent:>3} %  {eta:>5} left  {msg}",
        );
        let bar = self.bars.add(ProgressBar::new(STEPS as u64));
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        bar.set_prefix(label.to_owned());
        Line {
            bar,
            label: label.to_owned(),
            terminal: self.terminal,
            pace: None,
            said: Instant::now(),
        }
    }
}

/// One job's bar.
struct Line {
    bar: ProgressBar,
    label: String,
    terminal: bool,
    /// When the job was first seen running, and its progress then: a resumed job starts above zero.
    pace: Option<(Instant, f64)>,
    said: Instant,
}

impl Line {
    fn wait(&self, message: &str) {
        self.bar.set_message(message.to_owned());
    }

    fn show(&mut self, fraction: f64, message: &str) {
        if self.pace.is_none() {
            self.bar.reset_eta();
        }
        let (began, first) = *self.pace.get_or_insert((Instant::now(), fraction));
        self.bar.set_position((fraction.clamp(0.0, 1.0) * STEPS) as u64);
        self.bar.set_message(message.to_owned());
        if !self.terminal && self.said.elapsed() >= SAY_EVERY {
            self.said = Instant::now();
            let left = seconds_left(fraction - first, 1.0 - fraction, began.elapsed());
            let left = left.map_or(String::new(), |s| format!(", about {s:.0} s left"));
            telemetry::say(format_args!(
                "{}: {:.0} %, {message}{left}",
                self.label,
                100.0 * fraction
            ));
        }
    }

    fn end(&self, message: &str) {
        self.bar.set_position(STEPS as u64);
        self.bar.finish_with_message(message.to_owned());
        if !self.terminal {
            // A job finished by another command was never seen running.
            let took = self.pace.map_or(String::new(), |(began, _)| {
                format!(" after {:.0} s", began.elapsed().as_secs_f64())
            });
            telemetry::say(format_args!("{}: {message}{took}", self.label));
        }
    }
}
