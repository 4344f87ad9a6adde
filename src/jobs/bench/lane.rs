//! The thread that owns the bench, and the record it keeps: nothing moves unless the intended
//! motion is committed.

use super::condition::Condition;
use super::ending::{Ended, record_interrupted};
use super::journal::Journal;
use super::sign::StopSign;
use crate::jobs::worker::panic_message;
use flip_bench::rig::{Pouring, Rig};
use flip_bench::weigh::Event;
use flip_core::domain::seed::derive;
use flip_core::domain::vial::{Pan, VialFlaw};
use flip_core::domain::weighing::{OnOverdose, Outcome, WeighingState};
use flip_store::audit::About;
use flip_store::weighings::Weighing;
use flip_store::{self as store, Store, now};
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;
use tokio::runtime::Handle;

/// How often the lane polls for work by itself.
const LOOK: Duration = Duration::from_secs(1);
/// How long a dose waits for its record: then it ends by itself, and the spoon is levelled. Longer
/// than the store waits for another program's lock; a network that has gone away says nothing.
pub(super) const RECORD: Duration = Duration::from_secs(12);
/// Seed index for repeated doses.
const RETRY: u64 = 7;

/// The thread that owns the bench.
pub(super) struct LaneThread {
    pub store: Store,
    pub rig: Arc<dyn Rig>,
    pub condition: Condition,
    pub closing: Arc<AtomicBool>,
    pub runtime: Handle,
    /// Events of the dose that are not recorded yet.
    pub journal: Arc<Journal>,
}

/// What the lane learnt of a pour in addition to its result.
#[derive(Default)]
pub(super) struct Heard {
    /// The bench was opened.
    pub began: bool,
    /// What was wrong with the vial on the pan.
    pub flaw: Option<VialFlaw>,
    /// What could not be recorded, and why.
    pub unrecorded: Option<String>,
}

impl LaneThread {
    pub(super) fn work(&self, woken: &Receiver<()>) {
        while !self.closing.load(Ordering::SeqCst) {
            match self.runtime.block_on(self.next()) {
                Ok(Some(weighing)) => match self.carry_out(&weighing) {
                    Ok(true) => continue,
                    Ok(false) => {}
                    Err(error) => {
                        tracing::error!(weighing = weighing.id, %error, "a weighing was not begun")
                    }
                },
                Ok(None) => {}
                Err(error) => tracing::error!(%error, "could not look for weighings"),
            }
            if woken.recv_timeout(LOOK) == Err(RecvTimeoutError::Disconnected) {
                return;
            }
        }
    }

    /// The oldest intent, unless the bench is latched or its vial must be confirmed first.
    async fn next(&self) -> store::Result<Option<Weighing>> {
        self.condition.refresh(&self.store).await;
        // Nothing moves here: a weighing that the database lists as moving is left over from a
        // write that failed despite having been committed.
        let alone = self.condition.alone().await;
        record_interrupted(&self.store, &self.condition).await?;
        drop(alone);
        if !self.condition.is_free() {
            return Ok(None);
        }
        let Some(weighing) = self.store.next_weighing().await? else { return Ok(None) };
        if !self.is_confirmed(&weighing) || self.condition.is_vial_in(&weighing.id) {
            return Ok(Some(weighing));
        }
        if weighing.state == WeighingState::AwaitingVial {
            return Ok(None);
        }
        let mut tx = self.store.write_for_bench().await?;
        if tx.await_vial(&weighing.id, now()).await? {
            tx.commit().await?;
            self.condition.refresh(&self.store).await;
        }
        Ok(None)
    }

    /// Whether a person must confirm that the vial of this weighing is in.
    pub(super) fn is_confirmed(&self, weighing: &Weighing) -> bool {
        weighing.vial_check.is_confirm() && !self.rig.exchanges_vials()
    }

    /// Arms, pours, records. Nothing moves unless `armed` is committed. `false`: the bench is not
    /// available.
    fn carry_out(&self, weighing: &Weighing) -> store::Result<bool> {
        let stop = Arc::new(StopSign::default());
        if !self.condition.take_turn(weighing, &stop, self.is_confirmed(weighing)) {
            return Ok(false);
        }
        // A shutdown between the check and the line above has not seen the flag.
        let armed = match self.closing.load(Ordering::SeqCst) {
            true => Ok(None),
            false => self.arm(weighing),
        };
        match armed {
            Ok(Some(pan)) => self.pour_and_record(weighing, &pan, &stop),
            Ok(None) => self.condition.not_begun(),
            Err(error) => {
                self.condition.not_begun();
                return Err(error);
            }
        }
        Ok(true)
    }

    /// Commits that the bench is about to move; returns the previous state of its pan. `None`: the
    /// weighing is no longer waiting.
    fn arm(&self, weighing: &Weighing) -> store::Result<Option<Pan>> {
        self.runtime.block_on(async {
            let mut tx = self.store.write_for_bench().await?;
            let Some(armed) = tx.arm_weighing(&weighing.id, self.rig.kind(), now()).await? else {
                return Ok(None);
            };
            let pan = self.condition.pan();
            let begun = pan.begun(&weighing.id, self.condition.vial_of(weighing).as_deref(), now());
            if !self.rig.exchanges_vials() {
                tx.set_pan(&begun).await?;
            }
            tx.commit().await?;
            self.condition.armed(armed, begun);
            self.condition.refresh(&self.store).await;
            Ok(Some(pan))
        })
    }

    fn pour_and_record(&self, weighing: &Weighing, pan: &Pan, stop: &StopSign) {
        let ended = match self.prepare(weighing, pan) {
            Ok(pouring) => self.pour_until_kept(pouring, weighing, pan, stop),
            Err(error) => Ended::not_begun(error.to_string()),
        };
        let pan = self.pan_after(weighing, pan, &ended);
        self.write_down(weighing, &ended, &pan);
    }

    /// Pours; as long as the result is an overdose that may be discarded, exchanges the vial and
    /// pours again.
    fn pour_until_kept(
        &self,
        mut pouring: Pouring,
        weighing: &Weighing,
        pan: &Pan,
        stop: &StopSign,
    ) -> Ended {
        let retries = match weighing.asked.on_overdose {
            OnOverdose::DiscardAndRetry { max } if self.rig.exchanges_vials() => max,
            _ => 0,
        };
        let mut discarded_mg = Vec::new();
        loop {
            let mut ended = self.pour(&pouring, weighing, pan, stop);
            let again = ended.outcome() == Outcome::Over
                && discarded_mg.len() < retries as usize
                && ended.may_go_on();
            if again && !stop.is_pressed() && self.record_discarded(weighing, &ended).is_ok() {
                discarded_mg.extend(ended.reading_mg());
                pouring.simulation.seed =
                    derive(weighing.seed, &[RETRY, discarded_mg.len() as u64]);
                continue;
            }
            ended.discarded(discarded_mg);
            return ended;
        }
    }

    fn record_discarded(&self, weighing: &Weighing, ended: &Ended) -> store::Result<()> {
        self.runtime.block_on(async {
            let mut tx = self.store.write_for_bench().await?;
            let said =
                serde_json::json!({ "action": "vial exchanged after an overdose", "reading_mg": ended.reading_mg() });
            tx.audit(About { weighing: Some(&weighing.id), kind: "decision" }, &said, now()).await?;
            tx.commit().await
        })
    }

    fn pour(&self, pouring: &Pouring, weighing: &Weighing, pan: &Pan, stop: &StopSign) -> Ended {
        // If it was stopped during preparation, nothing has moved.
        if stop.is_pressed() {
            return Ended::stopped_before();
        }
        let mut heard = Heard::default();
        let mut on_event = |event: &Event<'_>| self.hear(&mut heard, &weighing.id, event, stop);
        let poured =
            catch_unwind(AssertUnwindSafe(|| self.rig.pour(pouring, &mut on_event, stop.flag())));
        match poured {
            Ok(poured) => {
                let refused = heard.flaw.map(|flaw| self.refused(weighing, pan, flaw));
                self.ended(weighing, pouring, poured, heard, refused)
            }
            Err(panic) => {
                let cause = format!("the weighing panicked: {}", panic_message(&*panic));
                Ended::panicked(cause, self.rig.kind().has_devices())
            }
        }
    }

    /// Records what is about to happen; returns `Break` if that fails, so that it does not. After a
    /// stop only the way back remains, which does not wait for a record; nor does it if recording
    /// has failed before.
    fn hear(
        &self,
        heard: &mut Heard,
        id: &str,
        event: &Event<'_>,
        stop: &StopSign,
    ) -> ControlFlow<()> {
        heard.began = true;
        if let Event::Pan(flaw) = event {
            heard.flaw = Some(**flaw);
        }
        self.journal.hear(id, self.rig.exchanges(), Some(event));
        let (journal, store, condition) =
            (self.journal.clone(), self.store.clone(), self.condition.clone());
        let writing = self
            .runtime
            .spawn(async move { journal.write_if_nobody_does(&store, &condition).await });
        if stop.is_pressed() || heard.unrecorded.is_some() {
            return ControlFlow::Break(());
        }
        let written = self.runtime.block_on(async {
            tokio::select! {
                written = tokio::time::timeout(RECORD, writing) => Some(written),
                () = stop.pressed() => None,
            }
        });
        let failed = match written {
            Some(Ok(Ok(Ok(())))) => return ControlFlow::Continue(()),
            None => return ControlFlow::Break(()),
            Some(Ok(Ok(Err(error)))) => unrecorded(&error),
            Some(Ok(Err(ended))) => {
                format!("the record could not be written, so nothing may move: {ended}")
            }
            Some(Err(_)) => format!(
                "the database did not take the record within {} s, so nothing may move",
                RECORD.as_secs()
            ),
        };
        tracing::error!(weighing = id, failed, "what the bench does was not recorded");
        heard.unrecorded = Some(failed);
        ControlFlow::Break(())
    }
}

/// Why nothing may move, and what to do about it.
fn unrecorded(error: &store::Error) -> String {
    format!("the record could not be written, so nothing may move: {}", error.remedy())
}
