//! How a dose ended, kept in memory until it is recorded: nothing else starts before that.

use super::condition::{Condition, Unwritten};
use super::lane::{Heard, LaneThread, RECORD};
use flip_bench::rig::{Poured, Pouring};
use flip_core::domain::apparatus::Apparatus;
use flip_core::domain::bench::{BenchKind, Tick};
use flip_core::domain::vial::{Dosed, Pan, Vial, VialFlaw};
use flip_core::domain::weighing::{MeasuredMass, Outcome, WeighingState};
use flip_sim::dispense;
use flip_store::bench::Latch;
use flip_store::weighings::{Ending, Weighing};
use flip_store::{self as store, Store, now};
use std::sync::atomic::Ordering;
use std::time::Duration;

/// First delay before retrying to record an ending; each is twice as long as the previous one.
const AGAIN: Duration = Duration::from_millis(100);
/// Maximum delay.
const AGAIN_MAX: Duration = Duration::from_secs(2);
/// How often shutdown is polled while waiting.
const ASK_EVERY: Duration = Duration::from_millis(50);

/// How a dose ended.
pub(super) struct Ended {
    ending: Ending,
    ticks: Option<Vec<Tick>>,
    /// Why a person must check the bench.
    must_look: Option<String>,
    /// What happened to the pan.
    touched: Touched,
}

/// What a dose did to the vial on the pan.
enum Touched {
    /// Nothing: the bench was not opened, or nothing moved.
    Not,
    /// Its content is unknown.
    Unknown,
    /// It was tared, and now shows this, mg.
    Known { tare_mg: f64, shown_mg: f64, step_mg: f64 },
}

impl Ended {
    fn bare(cause: String, touched: Touched) -> Self {
        let ending = Ending::bare(WeighingState::Aborted, Outcome::Aborted, cause);
        Self { ending, ticks: None, must_look: None, touched }
    }

    /// Nothing moved.
    pub(super) fn not_begun(cause: String) -> Self {
        Self::bare(cause, Touched::Not)
    }

    /// Stopped before the bench was opened: nothing moved.
    pub(super) fn stopped_before() -> Self {
        let ending =
            Ending::bare(WeighingState::Aborted, Outcome::Stopped, "stopped before anything moved");
        Self { ending, ticks: None, must_look: None, touched: Touched::Not }
    }

    /// The pouring code panicked midway.
    pub(super) fn panicked(cause: String, has_devices: bool) -> Self {
        let must_look = has_devices.then(|| cause.clone());
        Self { must_look, ..Self::bare(cause, Touched::Unknown) }
    }

    pub(super) fn outcome(&self) -> Outcome {
        self.ending.outcome
    }

    pub(super) fn reading_mg(&self) -> Option<f64> {
        self.ending.reading_mg
    }

    /// Whether work may continue without a check by a person.
    pub(super) fn may_go_on(&self) -> bool {
        self.must_look.is_none()
    }

    /// Adds the overdoses discarded before it.
    pub(super) fn discarded(&mut self, discarded_mg: Vec<f64>) {
        if let Some(measured) = &mut self.ending.measured {
            measured.discarded_mg = discarded_mg;
        }
    }
}

impl LaneThread {
    /// How it ended, in terms of the weighing.
    pub(super) fn ended(
        &self,
        weighing: &Weighing,
        pouring: &Pouring,
        poured: Poured,
        heard: Heard,
        refused: Option<String>,
    ) -> Ended {
        let state = match poured.outcome {
            Outcome::Within
            | Outcome::Under
            | Outcome::Over
            | Outcome::NotStable
            | Outcome::Blocked
            | Outcome::Probed => WeighingState::Done,
            Outcome::Stopped | Outcome::Aborted => WeighingState::Aborted,
            Outcome::Unknown => WeighingState::Unknown,
        };
        let apparatus = (!poured.ticks.is_empty()).then(|| self.apparatus(pouring, &poured));
        let touched = touched(&poured, &heard, pouring.task.order.readability_mg);
        let task = &pouring.task;
        let minimum_mg = task.accuracy.repeatability_mg.map(|_| task.minimum_mg());
        let measured = poured.measured.map(|measured| MeasuredMass {
            minimum_mg,
            below_minimum_weight: minimum_mg.map(|minimum_mg| measured.net_mg < minimum_mg),
            devices: self.rig.devices(),
            ..measured
        });
        // The verdict is that of the reading, and so is the error. A dose that was not weighed has
        // none.
        let is_weighed = matches!(
            poured.outcome,
            Outcome::Within | Outcome::Under | Outcome::Over | Outcome::Blocked
        );
        let error_mg = poured
            .reading_mg
            .filter(|_| is_weighed)
            .map(|reading_mg| reading_mg - weighing.target_mg);
        let error = match (refused, heard.unrecorded) {
            (Some(refused), _) => Some(refused),
            // The loop itself reports no reason for this.
            (None, Some(why))
                if poured.outcome == Outcome::Aborted && poured.must_look.is_none() =>
            {
                Some(why)
            }
            _ => poured.error,
        };
        let ending = Ending {
            state,
            outcome: poured.outcome,
            dispensed_mg: poured.dispensed_mg,
            reading_mg: poured.reading_mg,
            error_mg,
            shakes: Some(poured.shakes),
            seconds: Some(poured.seconds),
            measured,
            apparatus,
            trace: None,
            error,
        };
        let must_look = poured.must_look.filter(|_| self.rig.kind().has_devices());
        Ended { ending, ticks: Some(poured.ticks), must_look, touched }
    }

    /// What the dose was weighed with. A simulated spoon holds what its simulator fills in.
    fn apparatus(&self, pouring: &Pouring, poured: &Poured) -> Apparatus {
        let Pouring { task, simulation, .. } = pouring;
        let is_simulated = self.rig.kind() != BenchKind::Devices;
        let filled_mg = || dispense::capacity_mg(&simulation.set, &simulation.spoon);
        let capacity_mg = self.rig.spoon().capacity_mg;
        Apparatus {
            readability_mg: task.order.readability_mg,
            repeatability_mg: task.accuracy.repeatability_mg,
            capacity_mg: capacity_mg.or_else(|| is_simulated.then(filled_mg)),
            stroke: poured.stroke,
        }
    }

    /// Why nothing was poured into the vial on the pan, and what to do.
    pub(super) fn refused(&self, weighing: &Weighing, before: &Pan, flaw: VialFlaw) -> String {
        let named = |name: Option<&str>| {
            name.map_or_else(|| "a vial".to_owned(), |name| format!("vial `{name}`"))
        };
        let wanted = named(self.condition.pan().vial.and_then(|vial| vial.name).as_deref());
        let known = match (flaw, &before.vial) {
            (
                VialFlaw::SameAsBefore { .. },
                Some(Vial { name, holds_mg: Some(holds_mg), weighing, .. }),
            ) => {
                format!(
                    " ({} with {holds_mg:.1} mg, of weighing {weighing})",
                    named(name.as_deref())
                )
            }
            _ => String::new(),
        };
        format!(
            "{wanted} was said to be in and empty for weighing {}, but {flaw}{known}. Nothing was poured: put an empty vial in and ask for a new weighing",
            weighing.id
        )
    }

    /// State of the pan after a dose that started from this state.
    pub(super) fn pan_after(&self, weighing: &Weighing, before: &Pan, ended: &Ended) -> Pan {
        let during = self.condition.pan();
        match (&ended.touched, during.vial.clone()) {
            (Touched::Not, _) => before.clone(),
            (Touched::Known { tare_mg, shown_mg, step_mg }, Some(vial)) => before.after(&Dosed {
                weighing: weighing.id.clone(),
                vial: vial.name,
                at: vial.since,
                tare_mg: *tare_mg,
                shown_mg: *shown_mg,
                confirmed: self.is_confirmed(weighing),
                step_mg: *step_mg,
            }),
            _ => during,
        }
    }

    /// Records the ending, retrying until it succeeds; nothing else starts meanwhile. If the
    /// process ends first, the next start finds a weighing without a recorded end.
    pub(super) fn write_down(&self, weighing: &Weighing, ended: &Ended, pan: &Pan) {
        let latch = ended.must_look.as_ref().map(|reason| Latch {
            at: now(),
            reason: reason.clone(),
            weighing: Some(weighing.id.clone()),
            bench: Some(self.rig.kind()),
        });
        latch.iter().cloned().for_each(|latch| self.condition.latch(latch));
        // A clearance comes before or after this, never between the update in memory and the store.
        let mut alone = Some(self.runtime.block_on(self.condition.alone()));
        self.condition.stands(pan.clone());
        let (mut pause, since) = (AGAIN, now());
        while let Err(error) =
            self.runtime.block_on(self.write_in_time(weighing, ended, latch.as_ref(), pan, true))
        {
            if let store::Error::Disowned(_) = error {
                // Whoever took the bench has recorded that nobody knows how this ended.
                tracing::error!(weighing = weighing.id, %error, ending = ?ended.ending, "the end of a weighing is not recorded");
                return;
            }
            tracing::error!(weighing = weighing.id, %error, "the end of a weighing is not written down yet");
            let unwritten = Unwritten { weighing: weighing.id.clone(), since, why: error.remedy() };
            self.condition.set_unwritten(Some(unwritten));
            self.latch_if_gone(weighing, &error);
            drop(alone.take());
            if self.closes_within(pause) {
                return self.write_at_last(weighing, ended, latch.as_ref(), pan);
            }
            pause = (2 * pause).min(AGAIN_MAX);
            alone = Some(self.runtime.block_on(self.condition.alone()));
        }
        self.condition.set_unwritten(None);
    }

    /// Without a record nobody knows later what is on the bench: a person must check it, even if
    /// the database comes back.
    fn latch_if_gone(&self, weighing: &Weighing, error: &store::Error) {
        if matches!(error, store::Error::Gone(_)) && self.rig.kind().has_devices() {
            let (weighing, bench) = (Some(weighing.id.clone()), Some(self.rig.kind()));
            self.condition.latch(Latch { at: now(), reason: error.remedy(), weighing, bench });
        }
    }

    /// Whether the process shuts down during this delay.
    fn closes_within(&self, pause: Duration) -> bool {
        let mut left = pause;
        while !self.closing.load(Ordering::SeqCst) && !left.is_zero() {
            std::thread::sleep(left.min(ASK_EVERY));
            left = left.saturating_sub(ASK_EVERY);
        }
        self.closing.load(Ordering::SeqCst)
    }

    fn write_at_last(&self, weighing: &Weighing, ended: &Ended, latch: Option<&Latch>, pan: &Pan) {
        let written = self.runtime.block_on(self.write_in_time(weighing, ended, latch, pan, false));
        if let Err(error) = written {
            let ending = &ended.ending;
            tracing::error!(weighing = weighing.id, %error, ?ending, "the end of a weighing is lost: the next start calls it unknown");
        }
    }

    /// As [`Self::try_to_write`], given up after a while: a network that has gone away says nothing.
    /// If it was written after all, the next try finds the ending there; a reading whose commit was
    /// not answered may be recorded twice.
    async fn write_in_time(
        &self,
        weighing: &Weighing,
        ended: &Ended,
        latch: Option<&Latch>,
        pan: &Pan,
        waits: bool,
    ) -> store::Result<()> {
        let writing = self.try_to_write(weighing, ended, latch, pan, waits);
        let given_up = |_| {
            let why = format!("it did not answer within {} s", RECORD.as_secs());
            store::Error::Unreachable(why)
        };
        tokio::time::timeout(RECORD, writing).await.map_err(given_up)?
    }

    async fn try_to_write(
        &self,
        weighing: &Weighing,
        ended: &Ended,
        latch: Option<&Latch>,
        pan: &Pan,
        waits: bool,
    ) -> store::Result<()> {
        // Before the trace: writing its file would recreate a folder that the database has lost.
        self.store.is_in_place()?;
        let ending = self.with_trace(ended, waits).await?;
        self.journal.hear(&weighing.id, self.rig.exchanges(), None);
        self.journal.write_down(&self.store, &self.condition).await?;
        let mut tx = self.store.write_for_bench().await?;
        tx.end_weighing(&weighing.id, &ending, now()).await?;
        if !self.rig.exchanges_vials() {
            tx.set_pan(pan).await?;
        }
        if let Some(latch) = latch {
            tx.latch_bench(latch).await?;
        }
        tx.commit().await
    }

    /// The ending with its ticks as a file; without them if there is no room, or if their bucket is
    /// away and nobody waits for it.
    async fn with_trace(&self, ended: &Ended, waits: bool) -> store::Result<Ending> {
        let Some(ticks) = &ended.ticks else { return Ok(ended.ending.clone()) };
        let trace = match serde_json::to_vec(ticks) {
            Ok(bytes) if waits => self.store.artifacts().put(&bytes).await,
            // A bucket that is away must not keep the rest of the ending from being recorded.
            Ok(bytes) => tokio::time::timeout(RECORD / 4, self.store.artifacts().put(&bytes))
                .await
                .unwrap_or_else(|_| Err(store::Error::Corrupt("no answer in time".to_owned()))),
            Err(error) => Err(store::Error::Corrupt(error.to_string())),
        };
        let trace = match trace {
            Err(error @ store::Error::ArtifactsAway { .. }) if waits => return Err(error),
            trace => trace,
        };
        let lost = trace.as_ref().err().map(|error| format!("the trace was not stored: {error}"));
        Ok(Ending {
            trace: trace.ok(),
            error: ended.ending.error.clone().or(lost),
            ..ended.ending.clone()
        })
    }
}

/// Handles weighings that were moving when the process ended, or whose last write failed despite
/// having been committed: the content of their vials is unknown.
pub(super) async fn record_interrupted(store: &Store, condition: &Condition) -> store::Result<()> {
    let interrupted = store.interrupted_weighings().await?;
    if interrupted.is_empty() {
        return Ok(());
    }
    let reason = "the end of the weighing is not on record, because the process ended or a write failed before it: check the vial and the bench, then ask \
                  for a new weighing";
    let mut tx = store.write_for_bench().await?;
    for (id, bench) in interrupted {
        tracing::warn!(weighing = id, "was interrupted; its outcome is unknown");
        tx.end_weighing(
            &id,
            &Ending::bare(WeighingState::Unknown, Outcome::Unknown, reason),
            now(),
        )
        .await?;
        if bench.has_devices() {
            let latch = Latch {
                at: now(),
                reason: reason.to_owned(),
                weighing: Some(id),
                bench: Some(bench),
            };
            condition.latch(tx.latch_bench(&latch).await?);
        }
    }
    tx.commit().await
}

fn touched(poured: &Poured, heard: &Heard, step_mg: f64) -> Touched {
    if !heard.began || heard.flaw.is_some() {
        return Touched::Not;
    }
    match poured
        .measured
        .as_ref()
        .and_then(|it| it.tare_mg.map(|tare_mg| (tare_mg, it.net_mg + it.zero_mg.unwrap_or(0.0))))
    {
        Some((tare_mg, shown_mg)) => Touched::Known { tare_mg, shown_mg, step_mg },
        None => Touched::Unknown,
    }
}
