//! Gathers from the store what one weighing needs: policy, powder, checks of the bench, earlier
//! doses.

use super::lane::LaneThread;
use crate::jobs::spoon::holds_mg;
use flip_bench::rig::{Pouring, Simulation, Task};
use flip_bench::weigh::earlier::Expected;
use flip_bench::weigh::forecast::Fall;
use flip_bench::weigh::{Accuracy, Order};
use flip_core::domain::bench::Tick;
use flip_core::domain::bench_check::{CheckKind, Repeatability, ShakeCalibration};
use flip_core::domain::vial::{Pan, PanCheck};
use flip_policy as policy;
use flip_sim::{balance, dispense};
use flip_store::audit::About;
use flip_store::weighings::Weighing;
use flip_store::{self as store, now};

/// Maximum number of a powder's earlier doses that the forecast uses: older ones had other air,
/// and where no lot is named another lot.
const REMEMBERED: u32 = 20;

impl LaneThread {
    /// Gathers everything for a weighing on this pan.
    pub(super) fn prepare(&self, weighing: &Weighing, pan: &Pan) -> store::Result<Pouring> {
        let missing = |what: &str| store::Error::Corrupt(format!("the weighing's {what} is gone"));
        self.runtime.block_on(async {
            let policy = self
                .store
                .policy_bytes(&weighing.policy)
                .await?
                .ok_or_else(|| missing("policy"))?;
            let set = self
                .store
                .parameter_set(&weighing.parameter_set)
                .await?
                .ok_or_else(|| missing("parameter set"))?;
            let repeatability: Option<(_, Repeatability)> =
                self.store.newest_check(CheckKind::Repeatability).await?;
            let shakes: Option<(_, ShakeCalibration)> =
                self.store.newest_check(CheckKind::Shakes).await?;
            let balance = balance::Settings::default();
            let spoon = dispense::Settings::default();
            let extensions = spoon.extensions.patched(&weighing.patch);
            let extensions =
                extensions.map_err(|error| store::Error::Corrupt(error.to_string()))?;
            let policy = policy::decode(&policy)
                .map_err(|error| store::Error::Corrupt(error.to_string()))?;
            let readability_mg = self.rig.readability_mg().unwrap_or(balance.readability_mg);
            let earlier =
                if self.rig.remembers() { self.earlier(weighing).await? } else { Vec::new() };
            if !earlier.is_empty() {
                self.record_earlier(&weighing.id, earlier.len()).await?;
            }
            let class_pct = weighing.asked.accuracy_pct;
            Ok(Pouring {
                task: Task {
                    order: Order {
                        target_mg: weighing.target_mg,
                        tolerance_lower_mg: weighing.tolerance_lower_mg,
                        tolerance_upper_mg: weighing.tolerance_upper_mg,
                        readability_mg,
                    },
                    accuracy: Accuracy {
                        repeatability_mg: repeatability.map(|(_, check)| check.sd_mg),
                        class_pct: class_pct.unwrap_or(Accuracy::default().class_pct),
                    },
                    controller: policy.controller,
                    rules: policy.manifest.rules,
                },
                simulation: Simulation {
                    set: weighing.patch.powder(&set.parameters),
                    spoon: dispense::Settings { extensions, ..spoon },
                    balance,
                    seed: weighing.seed,
                },
                shakes: shakes.map(|(_, line)| line),
                expected: Expected::of(set.repose_deg, &earlier, readability_mg),
                spoon_mg: holds_mg(&self.rig.spoon(), std::iter::once(&set.parameters)),
                pan: self.pan_check(weighing, pan, readability_mg),
                probe: weighing.asked.probe,
            })
        })
    }

    /// Spoonfuls of earlier doses of this powder on such a bench, of those that ran their course and
    /// are not forgotten; of its lot, if the weighing names one.
    async fn earlier(&self, weighing: &Weighing) -> store::Result<Vec<Vec<Fall>>> {
        let (powder, lot) = (&weighing.powder, weighing.asked.lot.as_deref());
        let traces = self.store.traces_of(powder, lot, self.rig.kind(), REMEMBERED).await?;
        let spoonfuls = async |trace: &String| {
            let bytes =
                self.store.artifacts().get(trace).await.map_err(|error| error.to_string())?;
            let ticks: Vec<Tick> =
                serde_json::from_slice(&bytes).map_err(|error| error.to_string())?;
            Ok::<_, String>(Fall::of(&ticks))
        };
        // A dose whose trace is lost counts as unknown; the others are still used.
        let mut known = Vec::new();
        for trace in &traces {
            match spoonfuls(trace).await {
                Ok(spoonfuls) => known.extend(spoonfuls),
                Err(error) => tracing::warn!(trace, error, "an earlier dose cannot be read"),
            }
        }
        Ok(known)
    }

    /// Records that a dose was forecast from these spoonfuls of earlier ones.
    async fn record_earlier(&self, weighing: &str, spoonfuls: usize) -> store::Result<()> {
        let mut tx = self.store.write().await?;
        let said = serde_json::json!({ "action": "forecast from earlier doses of the powder", "spoonfuls": spoonfuls });
        tx.audit(About { weighing: Some(weighing), kind: "decision" }, &said, now()).await?;
        tx.commit().await
    }

    /// What the display must show, where a person has confirmed that the vial is in.
    fn pan_check(&self, weighing: &Weighing, pan: &Pan, readability_mg: f64) -> PanCheck {
        match self.is_confirmed(weighing) {
            true => pan.check(readability_mg, self.rig.empty_vial()),
            false => PanCheck::NONE,
        }
    }
}
