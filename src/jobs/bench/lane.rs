//! The thread that owns the bench, and the record that it keeps: nothing moves unless what it is about to do is committed.

use super::Moving;
use super::apparatus::{Apparatus, Poured, Pouring};
use crate::domain::bench::{BenchKind, Tick};
use crate::domain::bench_check::{CheckKind, Repeatability, ShakeCalibration};
use crate::domain::seed::derive;
use crate::domain::weighing::{MeasuredMass, OnOverdose, Outcome, WeighingState};
use crate::hardware::wire::{Direction, Exchange};
use crate::jobs::worker::panic_message;
use crate::policy;
use crate::sim::{balance, dispense};
use crate::store::audit::About;
use crate::store::weighings::{Ending, Weighing};
use crate::store::{self, Store, Tx, now};
use crate::weigh::forecast::{Fall, Forecast};
use crate::weigh::{Accuracy, Event, Order, Phase};
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, PoisonError};
use std::time::Duration;
use tokio::runtime::Handle;

/// The lane also looks for work on its own this often.
const LOOK: Duration = Duration::from_secs(1);
/// Earlier doses of a powder that the forecast knows at most: its lot and the air of long ago are others.
const REMEMBERED: u32 = 20;
/// Index of the seeds of doses that are made again.
const RETRY: u64 = 7;

/// The thread that owns the bench.
pub(super) struct LaneThread {
    pub store: Store,
    pub apparatus: Apparatus,
    pub moving: Moving,
    pub closing: Arc<AtomicBool>,
    pub runtime: Handle,
}

impl LaneThread {
    pub(super) fn work(&self, woken: &Receiver<()>) {
        while !self.closing.load(Ordering::SeqCst) {
            match self.runtime.block_on(self.next()) {
                Ok(Some(weighing)) => match self.carry_out(&weighing) {
                    Ok(()) => continue,
                    Err(error) => tracing::error!(weighing = weighing.id, %error, "a weighing was not recorded"),
                },
                Ok(None) => {}
                Err(error) => tracing::error!(%error, "could not look for weighings"),
            }
            if woken.recv_timeout(LOOK) == Err(RecvTimeoutError::Disconnected) {
                return;
            }
        }
    }

    /// The oldest intent, unless the bench is latched.
    async fn next(&self) -> store::Result<Option<Weighing>> {
        match self.store.latch().await? {
            Some(_) => Ok(None),
            None => self.store.planned_weighing().await,
        }
    }

    /// Arm, pour, record. Nothing moves unless `armed` is committed.
    fn carry_out(&self, weighing: &Weighing) -> store::Result<()> {
        let stop = Arc::new(AtomicBool::new(false));
        *self.moving() = Some((weighing.id.clone(), stop.clone()));
        // A shutdown between the look and the line above has not seen the flag.
        if self.closing.load(Ordering::SeqCst) {
            *self.moving() = None;
            return Ok(());
        }
        let done = self.arm(weighing).and_then(|armed| match armed {
            true => self.pour_and_record(weighing, &stop),
            false => Ok(()),
        });
        *self.moving() = None;
        done
    }

    fn arm(&self, weighing: &Weighing) -> store::Result<bool> {
        self.runtime.block_on(async {
            let mut tx = self.store.write().await?;
            let armed = tx.arm_weighing(&weighing.id, self.apparatus.kind, now()).await?;
            tx.commit().await?;
            Ok(armed)
        })
    }

    fn pour_and_record(&self, weighing: &Weighing, stop: &AtomicBool) -> store::Result<()> {
        let (ending, must_look) = match self.prepare(weighing) {
            Ok(pouring) => self.pour_until_kept(pouring, weighing, stop),
            Err(error) => (Ending::bare(WeighingState::Aborted, Outcome::Aborted, error.to_string()), None),
        };
        let rest = (self.apparatus.exchanges)();
        self.runtime.block_on(async {
            let mut tx = self.store.write().await?;
            audit_exchanges(&mut tx, Some(&weighing.id), &rest).await?;
            tx.end_weighing(&weighing.id, &ending, now()).await?;
            if let Some(reason) = must_look {
                tx.latch_bench(&reason, Some(&weighing.id), now()).await?;
            }
            tx.commit().await
        })
    }

    fn prepare(&self, weighing: &Weighing) -> store::Result<Pouring> {
        let missing = |what: &str| store::Error::Corrupt(format!("the weighing's {what} is gone"));
        self.runtime.block_on(async {
            let policy = self.store.policy_bytes(&weighing.policy).await?.ok_or_else(|| missing("policy"))?;
            let set =
                self.store.parameter_set(&weighing.parameter_set).await?.ok_or_else(|| missing("parameter set"))?;
            let repeatability: Option<(_, Repeatability)> = self.store.newest_check(CheckKind::Repeatability).await?;
            let shakes: Option<(_, ShakeCalibration)> = self.store.newest_check(CheckKind::Shakes).await?;
            let balance = balance::Settings::default();
            let spoon = dispense::Settings::default();
            let extensions = spoon.extensions.patched(&weighing.patch);
            let extensions = extensions.map_err(|error| store::Error::Corrupt(error.to_string()))?;
            let policy = policy::decode(&policy).map_err(|error| store::Error::Corrupt(error.to_string()))?;
            let readability_mg = (self.apparatus.readability_mg)().unwrap_or(balance.readability_mg);
            let earlier = if self.apparatus.remembers { self.earlier(&weighing.powder).await? } else { Vec::new() };
            if !earlier.is_empty() {
                self.record_earlier(&weighing.id, earlier.len()).await?;
            }
            Ok(Pouring {
                forecast: Forecast::GENERIC.informed(&earlier, readability_mg),
                order: Order {
                    target_mg: weighing.target_mg,
                    tolerance_lower_mg: weighing.tolerance_lower_mg,
                    tolerance_upper_mg: weighing.tolerance_upper_mg,
                    readability_mg,
                },
                accuracy: Accuracy {
                    repeatability_mg: repeatability.map(|(_, check)| check.sd_mg),
                    class_pct: weighing.asked.accuracy_pct.unwrap_or(Accuracy::default().class_pct),
                },
                controller: policy.controller,
                rules: policy.manifest.rules,
                balance,
                spoon: dispense::Settings { extensions, ..spoon },
                set: weighing.patch.powder(&set.parameters),
                shakes: shakes.map(|(_, line)| line),
                seed: weighing.seed,
            })
        })
    }

    /// What earlier doses of this powder on such a bench did, those that ran their course.
    async fn earlier(&self, powder: &str) -> store::Result<Vec<Vec<Fall>>> {
        let traces = self.store.traces_of(powder, self.apparatus.kind, REMEMBERED).await?;
        let falls = |trace: &String| {
            let bytes = self.store.artifacts().get(trace).map_err(|error| error.to_string())?;
            let ticks: Vec<Tick> = serde_json::from_slice(&bytes).map_err(|error| error.to_string())?;
            Ok::<_, String>(Fall::of(&ticks))
        };
        // A dose whose trace is lost is one that is not known; no other need wait for it.
        let known = |trace: &String| {
            falls(trace).inspect_err(|error| tracing::warn!(trace, error, "an earlier dose cannot be read")).ok()
        };
        Ok(traces.iter().filter_map(known).collect())
    }

    /// Say in the record that a dose was forecast from earlier ones.
    async fn record_earlier(&self, weighing: &str, doses: usize) -> store::Result<()> {
        let mut tx = self.store.write().await?;
        let said = serde_json::json!({ "action": "forecast from earlier doses of the powder", "doses": doses });
        tx.audit(About { weighing: Some(weighing), kind: "decision" }, &said, now()).await?;
        tx.commit().await
    }

    /// Pour; while it is an overdose that may be thrown away, exchange the vial and pour again.
    fn pour_until_kept(
        &self,
        mut pouring: Pouring,
        weighing: &Weighing,
        stop: &AtomicBool,
    ) -> (Ending, Option<String>) {
        let retries = match weighing.asked.on_overdose {
            OnOverdose::DiscardAndRetry { max } if self.apparatus.kind != BenchKind::Devices => max,
            _ => 0,
        };
        let mut discarded_mg = Vec::new();
        loop {
            let (mut ending, must_look) = self.pour(&pouring, weighing, stop);
            let again = ending.outcome == Outcome::Over && discarded_mg.len() < retries as usize && must_look.is_none();
            if again && !stop.load(Ordering::SeqCst) && self.record_discarded(weighing, &ending).is_ok() {
                discarded_mg.extend(ending.reading_mg);
                pouring.seed = derive(weighing.seed, &[RETRY, discarded_mg.len() as u64]);
                continue;
            }
            if let Some(measured) = &mut ending.measured {
                measured.discarded_mg = discarded_mg;
            }
            return (ending, must_look);
        }
    }

    fn record_discarded(&self, weighing: &Weighing, ending: &Ending) -> store::Result<()> {
        self.runtime.block_on(async {
            let mut tx = self.store.write().await?;
            let said =
                serde_json::json!({ "action": "vial exchanged after an overdose", "reading_mg": ending.reading_mg });
            tx.audit(About { weighing: Some(&weighing.id), kind: "decision" }, &said, now()).await?;
            tx.commit().await
        })
    }

    /// The ending, and why a person must look if one must.
    fn pour(&self, pouring: &Pouring, weighing: &Weighing, stop: &AtomicBool) -> (Ending, Option<String>) {
        let mut on_event = |event: &Event<'_>| match self.runtime.block_on(self.record(&weighing.id, event)) {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                tracing::error!(weighing = weighing.id, %error, "what the bench does was not recorded: nothing may move");
                ControlFlow::Break(())
            }
        };
        let poured = catch_unwind(AssertUnwindSafe(|| (self.apparatus.pour)(pouring, &mut on_event, stop)));
        match poured {
            Ok(poured) => {
                let must_look = poured.must_look.clone().filter(|_| self.apparatus.kind.has_devices());
                (self.ending(weighing, pouring, poured), must_look)
            }
            Err(panic) => {
                let cause = format!("the weighing panicked: {}", panic_message(&*panic));
                let latch = self.apparatus.kind.has_devices().then(|| cause.clone());
                (Ending::bare(WeighingState::Aborted, Outcome::Aborted, cause), latch)
            }
        }
    }

    /// Commit what is about to happen, and what passed over the wires meanwhile.
    async fn record(&self, id: &str, event: &Event<'_>) -> store::Result<()> {
        let exchanges = (self.apparatus.exchanges)();
        let mut tx = self.store.write().await?;
        audit_exchanges(&mut tx, Some(id), &exchanges).await?;
        match event {
            // Committed before the bench was opened.
            Event::Phase(Phase::Armed) => {}
            Event::Phase(Phase::Dosing) => tx.advance_weighing(id, WeighingState::Dosing, now()).await?,
            Event::Phase(Phase::Settling) => tx.advance_weighing(id, WeighingState::Settling, now()).await?,
            Event::Decision(decision) => {
                tx.audit(About { weighing: Some(id), kind: "decision" }, decision, now()).await?;
            }
            Event::Tick(tick) => {
                tx.insert_tick(id, tick).await?;
                tx.audit(About { weighing: Some(id), kind: "reading" }, tick, now()).await?;
            }
        }
        tx.commit().await
    }

    fn ending(&self, weighing: &Weighing, pouring: &Pouring, poured: Poured) -> Ending {
        let state = match poured.outcome {
            Outcome::Within | Outcome::Under | Outcome::Over | Outcome::NotStable | Outcome::Blocked => {
                WeighingState::Done
            }
            Outcome::Stopped | Outcome::Aborted => WeighingState::Aborted,
            Outcome::Unknown => WeighingState::Unknown,
        };
        let trace = serde_json::to_vec(&poured.ticks).map_err(|error| store::Error::Corrupt(error.to_string()));
        let trace = trace.and_then(|bytes| self.store.artifacts().put(&bytes));
        let lost = trace.as_ref().err().map(|error| format!("the trace was not stored: {error}"));
        let measured = poured.measured.map(|measured| MeasuredMass {
            minimum_mg: pouring.accuracy.repeatability_mg.map(|_| pouring.minimum_mg()),
            below_minimum_weight: pouring.accuracy.repeatability_mg.map(|_| measured.net_mg < pouring.minimum_mg()),
            devices: (self.apparatus.devices)(),
            ..measured
        });
        // The verdict is that of the reading, and so is the error. What was not weighed has none.
        let is_weighed = matches!(poured.outcome, Outcome::Within | Outcome::Under | Outcome::Over | Outcome::Blocked);
        let error_mg = poured.reading_mg.filter(|_| is_weighed).map(|reading_mg| reading_mg - weighing.target_mg);
        Ending {
            state,
            outcome: poured.outcome,
            dispensed_mg: poured.dispensed_mg,
            reading_mg: poured.reading_mg,
            error_mg,
            shakes: Some(poured.shakes),
            seconds: Some(poured.seconds),
            measured,
            trace: trace.ok(),
            error: poured.error.or(lost),
        }
    }

    fn moving(&self) -> std::sync::MutexGuard<'_, Option<(String, Arc<AtomicBool>)>> {
        self.moving.lock().unwrap_or_else(PoisonError::into_inner)
    }
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
