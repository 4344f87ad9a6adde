//! The thread that owns the bench, and the record that it keeps: nothing moves unless what it is about to do is committed.

use super::apparatus::{Apparatus, Pouring};
use super::condition::Condition;
use super::ending::{Ended, record_interrupted};
use crate::domain::seed::derive;
use crate::domain::vial::{Pan, VialFlaw};
use crate::domain::weighing::{OnOverdose, Outcome, WeighingState};
use crate::hardware::wire::{Direction, Exchange};
use crate::jobs::worker::panic_message;
use crate::store::audit::About;
use crate::store::weighings::Weighing;
use crate::store::{self, Store, Tx, now};
use crate::weigh::{Event, Phase};
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::runtime::Handle;

/// The lane also looks for work on its own this often.
const LOOK: Duration = Duration::from_secs(1);
/// Index of the seeds of doses that are made again.
const RETRY: u64 = 7;

/// The thread that owns the bench.
pub(super) struct LaneThread {
    pub store: Store,
    pub apparatus: Apparatus,
    pub condition: Condition,
    pub closing: Arc<AtomicBool>,
    pub runtime: Handle,
    /// What passed over the wires and is not written down yet.
    pub unrecorded: Mutex<Vec<Exchange>>,
}

/// What the lane heard of a pour beside its result.
#[derive(Default)]
pub(super) struct Heard {
    /// The bench was opened.
    pub began: bool,
    /// What was wrong with what stands on the pan.
    pub flaw: Option<VialFlaw>,
    /// What could not be written down, and why.
    pub unrecorded: Option<String>,
}

impl LaneThread {
    pub(super) fn work(&self, woken: &Receiver<()>) {
        while !self.closing.load(Ordering::SeqCst) {
            match self.runtime.block_on(self.next()) {
                Ok(Some(weighing)) => match self.carry_out(&weighing) {
                    Ok(true) => continue,
                    Ok(false) => {}
                    Err(error) => tracing::error!(weighing = weighing.id, %error, "a weighing was not begun"),
                },
                Ok(None) => {}
                Err(error) => tracing::error!(%error, "could not look for weighings"),
            }
            if woken.recv_timeout(LOOK) == Err(RecvTimeoutError::Disconnected) {
                return;
            }
        }
    }

    /// The oldest intent, unless the bench is latched or somebody has to say first that its vial is in.
    async fn next(&self) -> store::Result<Option<Weighing>> {
        self.condition.refresh(&self.store).await;
        // Nothing moves here: what the database says is moving was left so by a write that failed after it had been made.
        record_interrupted(&self.store, &self.condition).await?;
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
        let mut tx = self.store.write().await?;
        if tx.await_vial(&weighing.id, now()).await? {
            tx.commit().await?;
            self.condition.refresh(&self.store).await;
        }
        Ok(None)
    }

    /// Somebody has to say that the vial of this weighing is in.
    pub(super) fn is_confirmed(&self, weighing: &Weighing) -> bool {
        weighing.vial_check.is_confirm() && !self.apparatus.kind.exchanges_vials()
    }

    /// Arm, pour, record. Nothing moves unless `armed` is committed. `false`: something keeps the bench from it.
    fn carry_out(&self, weighing: &Weighing) -> store::Result<bool> {
        let stop = Arc::new(AtomicBool::new(false));
        if !self.condition.take_turn(weighing, &stop, self.is_confirmed(weighing)) {
            return Ok(false);
        }
        // A shutdown between the look and the line above has not seen the flag.
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

    /// The bench is about to move; what was known of its pan. `None`: the weighing waits no longer.
    fn arm(&self, weighing: &Weighing) -> store::Result<Option<Pan>> {
        self.runtime.block_on(async {
            let mut tx = self.store.write().await?;
            let Some(armed) = tx.arm_weighing(&weighing.id, self.apparatus.kind, now()).await? else { return Ok(None) };
            let pan = self.condition.pan();
            let begun = pan.begun(&weighing.id, self.condition.vial_of(weighing).as_deref(), now());
            if !self.apparatus.kind.exchanges_vials() {
                tx.set_pan(&begun).await?;
            }
            tx.commit().await?;
            self.condition.armed(armed, begun);
            self.condition.refresh(&self.store).await;
            Ok(Some(pan))
        })
    }

    fn pour_and_record(&self, weighing: &Weighing, pan: &Pan, stop: &AtomicBool) {
        let ended = match self.prepare(weighing, pan) {
            Ok(pouring) => self.pour_until_kept(pouring, weighing, pan, stop),
            Err(error) => Ended::not_begun(error.to_string()),
        };
        let pan = self.pan_after(weighing, pan, &ended);
        self.write_down(weighing, &ended, &pan);
    }

    /// Pour; while it is an overdose that may be thrown away, exchange the vial and pour again.
    fn pour_until_kept(&self, mut pouring: Pouring, weighing: &Weighing, pan: &Pan, stop: &AtomicBool) -> Ended {
        let retries = match weighing.asked.on_overdose {
            OnOverdose::DiscardAndRetry { max } if self.apparatus.kind.exchanges_vials() => max,
            _ => 0,
        };
        let mut discarded_mg = Vec::new();
        loop {
            let mut ended = self.pour(&pouring, weighing, pan, stop);
            let again = ended.outcome() == Outcome::Over && discarded_mg.len() < retries as usize && ended.may_go_on();
            if again && !stop.load(Ordering::SeqCst) && self.record_discarded(weighing, &ended).is_ok() {
                discarded_mg.extend(ended.reading_mg());
                pouring.seed = derive(weighing.seed, &[RETRY, discarded_mg.len() as u64]);
                continue;
            }
            ended.discarded(discarded_mg);
            return ended;
        }
    }

    fn record_discarded(&self, weighing: &Weighing, ended: &Ended) -> store::Result<()> {
        self.runtime.block_on(async {
            let mut tx = self.store.write().await?;
            let said =
                serde_json::json!({ "action": "vial exchanged after an overdose", "reading_mg": ended.reading_mg() });
            tx.audit(About { weighing: Some(&weighing.id), kind: "decision" }, &said, now()).await?;
            tx.commit().await
        })
    }

    fn pour(&self, pouring: &Pouring, weighing: &Weighing, pan: &Pan, stop: &AtomicBool) -> Ended {
        let mut heard = Heard::default();
        let mut on_event = |event: &Event<'_>| self.hear(&mut heard, &weighing.id, event);
        let poured = catch_unwind(AssertUnwindSafe(|| (self.apparatus.pour)(pouring, &mut on_event, stop)));
        match poured {
            Ok(poured) => {
                let refused = heard.flaw.map(|flaw| self.refused(weighing, pan, flaw));
                self.ended(weighing, pouring, poured, heard, refused)
            }
            Err(panic) => {
                let cause = format!("the weighing panicked: {}", panic_message(&*panic));
                Ended::panicked(cause, self.apparatus.kind.has_devices())
            }
        }
    }

    /// Write down what is about to happen; it may not happen where that fails.
    fn hear(&self, heard: &mut Heard, id: &str, event: &Event<'_>) -> ControlFlow<()> {
        heard.began = true;
        if let Event::Pan(flaw) = event {
            heard.flaw = Some(**flaw);
        }
        match self.runtime.block_on(self.record(id, event)) {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                tracing::error!(weighing = id, %error, "what the bench does was not recorded: nothing may move");
                heard.unrecorded.get_or_insert_with(|| unrecorded(&error));
                ControlFlow::Break(())
            }
        }
    }

    /// Commit what is about to happen, and what passed over the wires meanwhile.
    async fn record(&self, id: &str, event: &Event<'_>) -> store::Result<()> {
        let exchanges = self.exchanges();
        let mut tx = self.store.write().await?;
        audit_exchanges(&mut tx, Some(id), &exchanges).await?;
        match event {
            // Committed before the bench was opened.
            Event::Phase(Phase::Armed) => {}
            Event::Phase(Phase::Dosing) => tx.advance_weighing(id, WeighingState::Dosing, now()).await?,
            Event::Phase(Phase::Settling) => tx.advance_weighing(id, WeighingState::Settling, now()).await?,
            Event::Pan(flaw) => tx.audit(About { weighing: Some(id), kind: "decision" }, flaw, now()).await?,
            Event::Decision(decision) => {
                tx.audit(About { weighing: Some(id), kind: "decision" }, decision, now()).await?;
            }
            Event::Tick(tick) => {
                tx.insert_tick(id, tick).await?;
                tx.audit(About { weighing: Some(id), kind: "reading" }, tick, now()).await?;
            }
        }
        tx.commit().await?;
        self.recorded(exchanges.len());
        match event {
            Event::Phase(Phase::Dosing) => self.condition.advance(WeighingState::Dosing),
            Event::Phase(Phase::Settling) => self.condition.advance(WeighingState::Settling),
            _ => {}
        }
        Ok(())
    }

    /// What passed over the wires and is not written down yet.
    pub(super) fn exchanges(&self) -> Vec<Exchange> {
        let mut unrecorded = self.unrecorded();
        unrecorded.extend((self.apparatus.exchanges)());
        unrecorded.clone()
    }

    /// The first so many are written down now.
    pub(super) fn recorded(&self, count: usize) {
        self.unrecorded().drain(..count);
    }

    fn unrecorded(&self) -> MutexGuard<'_, Vec<Exchange>> {
        self.unrecorded.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Why nothing may move, and what to do about it.
fn unrecorded(error: &store::Error) -> String {
    format!("the record could not be written, so nothing may move: {}", error.remedy())
}

/// Write down what passed over the wires.
pub(in crate::jobs) async fn audit_exchanges(
    tx: &mut Tx,
    weighing: Option<&str>,
    exchanges: &[Exchange],
) -> store::Result<()> {
    for exchange in exchanges {
        let kind = match exchange.direction {
            Direction::Sent => "sent",
            Direction::Received => "received",
        };
        let said = serde_json::json!({ "device": exchange.device, "text": exchange.text });
        tx.audit(About { weighing, kind }, &said, now()).await?;
    }
    Ok(())
}
