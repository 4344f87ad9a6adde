//! A bench and a heap that answer at once, by formula.

use flip::app::Functions;
use flip::jobs::{Cards, heaps_on_cores};
use flip_bench::hardware::DeviceError;
use flip_bench::rig::{OnEvent, Poured, Pouring, Rig};
use flip_bench::weigh::{Event, Phase};
use flip_core::domain::bench::{Action, BenchKind, Reading, Tick};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::weighing::Outcome;
use flip_policy::{self as policy, Controller, Kind, Manifest, Policy, Rules, ScheduledStep};
use flip_sim::batch::Engine;
use flip_sim::repose::{Refusal, Repose, Settings};
use sha2::{Digest, Sha256};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

/// A machine without a card.
struct NoCard;

impl Cards for NoCard {
    fn found(&self) -> Result<String, String> {
        Err("there is no driver in this test; use the CPU".to_owned())
    }
    fn open(&self) -> Result<Arc<dyn Engine>, String> {
        self.found().map(|_| unreachable!("none is found"))
    }
}

/// Counts pours, and can be held.
#[derive(Clone, Default)]
pub struct Bench {
    pours: Arc<AtomicUsize>,
    held: Arc<AtomicBool>,
    halved: Arc<AtomicBool>,
}

/// While it lives, pours are blocked.
pub struct Hold(Arc<AtomicBool>);

impl Drop for Hold {
    fn drop(&mut self) {
        self.0.store(false, Ordering::SeqCst);
    }
}

impl Bench {
    pub fn functions(&self) -> Functions {
        Functions {
            simulate: heaps_on_cores(heap),
            rig: Arc::new(self.clone()),
            card: Arc::new(NoCard),
            ..Functions::default()
        }
    }

    pub fn pours(&self) -> usize {
        self.pours.load(Ordering::SeqCst)
    }

    pub fn hold(&self) -> Hold {
        self.held.store(true, Ordering::SeqCst);
        Hold(self.held.clone())
    }

    /// While it lives, pours stand still at half of the target.
    pub fn hold_at_half(&self) -> Hold {
        self.halved.store(true, Ordering::SeqCst);
        Hold(self.halved.clone())
    }
}

impl Rig for Bench {
    fn kind(&self) -> BenchKind {
        BenchKind::Simulated
    }

    fn exchanges_vials(&self) -> bool {
        true
    }

    fn halt(&self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn readability_mg(&self) -> Option<f64> {
        Some(1.0)
    }

    /// Half of the target, then all of it, unless stopped.
    fn pour(&self, pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool) -> Poured {
        self.pours.fetch_add(1, Ordering::SeqCst);
        while self.held.load(Ordering::SeqCst) && !stop.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(1));
        }
        let _recorded = on_event(&Event::Phase(Phase::Dosing));
        let mut ticks = Vec::new();
        for step in 0..3_u32 {
            if stop.load(Ordering::SeqCst) {
                break;
            }
            let mass_mg = pouring.task.order.target_mg * f64::from(step) / 2.0;
            let action = Action::once(1.0, 4.0);
            let (t_s, pitch_deg) = (f64::from(step) * 0.7, f64::from(step));
            let tick = Tick {
                step,
                t_s,
                pitch_deg,
                action,
                reading: Reading { mass_mg, stable: true },
                spoonful: 1,
            };
            let _recorded = on_event(&Event::Tick(&tick));
            ticks.push(tick);
            while step == 1 && self.halved.load(Ordering::SeqCst) && !stop.load(Ordering::SeqCst) {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        let stopped = stop.load(Ordering::SeqCst);
        let reading_mg = ticks.last().map_or(0.0, |tick| tick.reading.mass_mg);
        Poured {
            outcome: if stopped { Outcome::Stopped } else { Outcome::Within },
            dispensed_mg: Some(reading_mg),
            reading_mg: Some(reading_mg),
            measured: None,
            shakes: 2,
            seconds: 1.4,
            ticks,
            stroke: None,
            error: None,
            must_look: None,
        }
    }
}

/// A heap whose angle grows with friction and cohesion: 20 to 65 degrees.
fn heap(set: &ParameterSet, _settings: &Settings, _seed: u64) -> Result<Repose, Refusal> {
    let unit = set.to_unit();
    let angle = 20.0 + 30.0 * unit[4] + 15.0 * unit[7];
    Ok(Repose {
        tip_deg: angle,
        tip_sd_deg: None,
        cone_deg: angle,
        creep_deg_per_s: 0.0,
        speed_rms_mm_s: 0.0,
        particles_on_base: 1000,
        overlap_mean: 0.0,
        overlap_max: 0.0,
        simulated_s: 1.0,
    })
}

/// Id, manifest and bytes of a policy that needs no training.
fn fixed_policy() -> (String, String, Vec<u8>) {
    let step = ScheduledStep { pitch_deg: 20.0, shake_mm: 8.0 };
    let manifest = Manifest::of_untrained(Kind::Fixed { step }, Rules::FLIP, 1);
    let text = serde_json::to_string(&manifest).unwrap();
    let bytes = policy::encode(&Policy { manifest, controller: Controller::Fixed(step) });
    (policy::id(&bytes), text, bytes)
}

/// Puts a calibrated salt and a policy into the database of a data folder, as a calibration and a
/// training would.
pub async fn calibrate_salt(data_dir: &Path) {
    let pool = flip_testing::pool(data_dir).await;
    let set = ParameterSet::default();
    sqlx::query(
        "INSERT INTO job (id, kind, spec, spec_sha256, state, result, created_at, finished_at)
         VALUES ('toy', 'calibration', '{}', $1, 'succeeded', '{}', 0, 0)",
    )
    .bind(vec![0_u8; 32])
    .execute(&pool)
    .await
    .unwrap();
    sqlx::query(
        "INSERT INTO parameter_set (id, powder, calibration, position, parameters, repose_deg, runs, error_deg, created_at)
         VALUES ($1, 'salt', 'toy', 0, $2, 36, 1, 0, 0)",
    )
    .bind(set.id())
    .bind(serde_json::to_string(&set).unwrap())
    .execute(&pool)
    .await
    .unwrap();
    let (id, manifest, bytes) = fixed_policy();
    sqlx::query(
        "INSERT INTO policy (id, kind, manifest, bytes, sha256, created_at) VALUES ($1, 'fixed', $2, $3, $4, 0)",
    )
    .bind(id)
    .bind(manifest)
    .bind(&bytes)
    .bind(hex::encode(Sha256::digest(&bytes)))
    .execute(&pool)
    .await
    .unwrap();
    pool.close().await;
}
