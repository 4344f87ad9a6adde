//! The bench: its state, whether it may be used, who cleared it, and the record of everything that
//! happened on it.

use super::benches::stored_status;
use super::check::Check;
use super::weighings::latched;
use super::{App, Error, Result};
use crate::jobs::bench::{Bench, Change, Standing, Unwritten};
use flip_bench::hardware::DeviceError;
use flip_bench::rig::{PileInMaking, PileStand};
use flip_core::domain::FieldError;
use flip_core::domain::bench::BenchKind;
use flip_core::domain::bench_check::{CheckKind, Repeatability, ShakeCalibration};
use flip_core::domain::vial::Vial;
use flip_store::bench::Latch;
use flip_store::holds::Held;
use flip_store::now;
use flip_store::pan::Reservation;
use flip_store::weighings::{Waiting, Weighing};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Maximum length of a person's name and note, characters.
const WORDS_MAX: usize = 2000;

/// The bench, and whether it may be used.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BenchStatus {
    /// Kind of bench; absent if another process has it.
    pub kind: Option<BenchKind>,
    /// Devices by role, as they identify themselves.
    pub devices: BTreeMap<String, String>,
    /// Each dose gets an empty vial without human help; absent if another process has the bench.
    pub exchanges_vials: Option<bool>,
    /// Why it may not be used until a person clears it.
    pub latch: Option<Latch>,
    /// After a stop: nothing starts until a person resumes.
    pub held: Option<Held>,
    /// The weighing in motion.
    pub moving: Option<String>,
    /// The pile being made: the gate may be open. Stopping the bench ends it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub piling: Option<PileInMaking>,
    /// Waiting weighings, in order.
    pub waiting: Vec<Waiting>,
    /// The vial on the pan, as far as known.
    pub vial: Option<Vial>,
    /// The current reservation of the bench.
    pub reservation: Option<Reservation>,
    /// The end of a dose that could not be recorded yet: nothing starts until it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unwritten: Option<Unwritten>,
    /// The newest repeatability check of the balance.
    pub repeatability: Option<Repeatability>,
}

/// A person confirms having checked the bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClearRequest {
    /// Name of the person who checked.
    pub by: String,
    /// What was found and done.
    #[serde(default)]
    pub note: String,
    /// Confirms that the bench was checked. Must be true.
    pub looked: bool,
    /// Confirms that the vial is empty or new and that the balance will be tared. Must be true.
    pub vial_ready: bool,
    /// Waiting weighings may start at once, even after a stop; otherwise the bench is held until a
    /// person resumes.
    #[serde(default)]
    pub resume: bool,
}

/// A person lets weighings start again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResumeRequest {
    /// Name of the person resuming.
    pub by: String,
    /// What was found and done.
    #[serde(default)]
    pub note: String,
}

/// Weighings of one test weight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RepeatabilityRequest {
    /// Readings, mg, the weight reloaded for each; at least ten.
    pub readings_mg: Vec<f64>,
    /// Readability (display step) of the balance, mg.
    pub readability_mg: f64,
}

impl App {
    /// The state of the bench, and whether it may be used.
    ///
    /// # Errors
    /// `Internal`
    pub async fn bench(&self) -> Result<BenchStatus> {
        if let Some(jobs) = &self.inner.jobs {
            return Ok(status(jobs.bench()));
        }
        let stored = stored_status(self.store()).await?;
        Ok(BenchStatus { kind: None, moving: None, ..stored })
    }

    /// Stops anything that moves on the bench, and lets nothing start until a person resumes. Not
    /// an emergency stop.
    ///
    /// This does not block: the stop flag and the hold are set when it returns, the arm is being
    /// notified, and the record follows when the database allows. `by` is the person who stops, if
    /// known.
    ///
    /// # Errors
    /// `Unavailable` if opened read-only.
    pub fn halt(&self, by: Option<&str>) -> Result<BenchStatus> {
        let bench = self.jobs_or_refuse()?.bench();
        bench.halt(by);
        Ok(status(bench))
    }

    /// The same, if it is this weighing that moves; returns what is known of it.
    ///
    /// # Errors
    /// `Unavailable` if opened read-only.
    pub fn halt_weighing(&self, id: &str, by: Option<&str>) -> Result<Option<Weighing>> {
        Ok(self.jobs_or_refuse()?.bench().halt_weighing(id, by))
    }

    /// As [`App::halt`], by an unknown person.
    ///
    /// # Errors
    /// `Unavailable` if opened read-only.
    pub async fn stop_bench(&self) -> Result<BenchStatus> {
        self.halt(None)
    }

    /// Lets weighings start again after a stop. A stop that comes after the request was made still
    /// holds the bench.
    ///
    /// # Errors
    /// `Invalid`; `Conflict` (`bench_not_held`, `bench_latched`, `stopped_meanwhile`).
    pub async fn resume_bench(&self, request: ResumeRequest) -> Result<BenchStatus> {
        let stops = self.stops_when_asked()?;
        let mut check = Check::default();
        let by = check_person(&mut check, &request.by, &request.note);
        check.done()?;
        let bench = self.jobs_or_refuse()?.bench();
        if let Some(latch) = bench.standing().latch {
            return Err(latched(&latch));
        }
        match bench.resume(by, &request.note, stops).await? {
            Change::Made => self.bench().await,
            Change::Nothing => Err(Error::conflict(
                "bench_not_held",
                "the bench is not held: there is nothing to resume",
            )),
            Change::Void => Err(stopped_meanwhile("look at it, and resume it again")),
        }
    }

    /// Clears the bench, or its arm if that alone is latched, after a person's check. If weighings
    /// are waiting, the bench is held unless they are to start, and the hold of a stop stays too.
    /// If two people clear at once, one succeeds.
    ///
    /// # Errors
    /// `Invalid`; `Conflict` (`bench_not_latched`, `bench_differs`, `arm_not_recovered`,
    /// `ending_unwritten`, `stopped_meanwhile`).
    pub async fn clear_bench(&self, request: ClearRequest) -> Result<BenchStatus> {
        let bench = self.jobs_or_refuse()?.bench();
        let stops = self.stops_when_asked()?;
        let mut check = Check::default();
        let by = check_person(&mut check, &request.by, &request.note);
        if !request.looked {
            check
                .refuse("looked", "must be true: look at spoon, vial and balance first".to_owned());
        }
        if !request.vial_ready {
            check.refuse("vial_ready", "must be true: empty or exchange the vial first".to_owned());
        }
        check.done()?;
        let alone = bench.alone().await;
        let cleared = self.clear_alone(by, &request, stops).await;
        drop(alone);
        // Anything that could not start meanwhile, and waiting weighings.
        bench.wake();
        cleared?;
        self.bench().await
    }

    /// Clears while no other clearance runs and no dose starts or ends.
    async fn clear_alone(&self, by: &str, request: &ClearRequest, stops: u64) -> Result<()> {
        let bench = self.jobs_or_refuse()?.bench();
        let Standing { moving, unwritten, .. } = bench.standing();
        if let Some(moving) = moving {
            let advice =
                format!("weighing {moving} is moving: stop it, and look when it has ended");
            return Err(Error::conflict("bench_not_latched", advice));
        }
        if let Some(unwritten) = unwritten {
            let advice = format!(
                "the end of weighing {} is not recorded yet: {}",
                unwritten.weighing, unwritten.why
            );
            return Err(Error::conflict("ending_unwritten", advice));
        }
        let latch = bench.latch().await?;
        if latch.as_ref().and_then(|latch| latch.bench) == Some(BenchKind::Devices)
            && bench.kind() != BenchKind::Devices
        {
            let advice = "the bench that is latched is made of devices, and this process has another one: its arm would not hear of it. Name the bench's \
                          file (`flip bench clear --bench FILE`, or `flip serve --bench FILE`)";
            return Err(Error::conflict("bench_differs", advice));
        }
        let void = || stopped_meanwhile("look at it, and clear it again");
        if bench.stops() != stops {
            return Err(void());
        }
        self.recover(by, latch.is_some()).await?;
        match bench.clear(by, &request.note, request.resume, stops).await? {
            Change::Made | Change::Nothing => Ok(()),
            Change::Void => Err(void()),
        }
    }

    /// Before the latch is removed: a bench whose arm cannot move must not appear free. The arm may
    /// be latched when the bench is not.
    async fn recover(&self, by: &str, is_latched: bool) -> Result<()> {
        let bench = self.jobs_or_refuse()?.bench();
        let failed = |error: DeviceError| Error::conflict("arm_not_recovered", error.to_string());
        if bench.arm_latch().await.map_err(failed)?.is_some() {
            return bench.recover(by).await.map_err(failed);
        }
        match (is_latched, bench.kind()) {
            (true, _) => Ok(()),
            (false, BenchKind::Devices) => {
                let advice = "neither the bench nor its arm is latched: there is nothing to clear";
                Err(Error::conflict("bench_not_latched", advice))
            }
            (false, _) => {
                let advice = "the bench is not latched: there is nothing to clear. If it is an arm that is latched, name the bench's file \
                              (`flip bench clear --bench FILE`)";
                Err(Error::conflict("bench_not_latched", advice))
            }
        }
    }

    /// Stores a repeatability check of the balance.
    ///
    /// # Errors
    /// `Invalid`
    pub async fn check_repeatability(
        &self,
        request: RepeatabilityRequest,
    ) -> Result<Repeatability> {
        let RepeatabilityRequest { readings_mg, readability_mg } = request;
        if !(readability_mg.is_finite() && (1e-4..=1000.0).contains(&readability_mg)) {
            let advice = format!("must be from 0.0001 to 1000 mg, got {readability_mg}");
            return Err(FieldError::new("readability_mg", advice).into());
        }
        let found = Repeatability::of(readings_mg, readability_mg)?;
        self.keep_check(CheckKind::Repeatability, &found).await?;
        self.jobs_or_refuse()?.bench().repeats(found.clone());
        Ok(found)
    }

    /// The arm's actual shakes against the commanded ones, as last measured.
    ///
    /// # Errors
    /// `Conflict` (`shakes_not_calibrated`).
    pub(super) async fn shakes(&self) -> Result<ShakeCalibration> {
        let measured: Option<(_, ShakeCalibration)> =
            self.store().newest_check(CheckKind::Shakes).await?;
        let advice =
            "the arm's shakes have not been measured yet: run `flip bench calibrate-shake` first";
        measured
            .map(|(_, calibration)| calibration)
            .ok_or_else(|| Error::conflict("shakes_not_calibrated", advice))
    }

    /// Stores the arm's actual shakes against the commanded ones; weighings command accordingly
    /// from now on.
    ///
    /// # Errors
    /// `Unavailable` if opened read-only.
    pub async fn keep_shakes(&self, found: &ShakeCalibration) -> Result<()> {
        self.keep_check(CheckKind::Shakes, found).await
    }

    /// Stores a dry test of the devices, whatever its result.
    ///
    /// # Errors
    /// `Unavailable` if opened read-only.
    pub async fn keep_conformance(&self, found: &impl Serialize) -> Result<()> {
        self.keep_check(CheckKind::Conformance, found).await
    }

    async fn keep_check(&self, kind: CheckKind, found: &impl Serialize) -> Result<()> {
        self.jobs_or_refuse()?;
        let mut tx = self.store().write().await?;
        tx.insert_check(kind, found, now()).await?;
        tx.commit().await?;
        Ok(())
    }
}

/// The refusal of a request made before a stop.
pub(super) fn stopped_meanwhile(advice: &str) -> Error {
    Error::conflict(
        "stopped_meanwhile",
        format!("the bench was stopped after this was requested: {advice}"),
    )
}

/// The status of a bench, from memory.
fn status(bench: &Bench) -> BenchStatus {
    let Standing { latch, held, waiting, vial, repeatability, reservation, moving, unwritten } =
        bench.standing();
    BenchStatus {
        kind: Some(bench.kind()),
        devices: bench.devices(),
        exchanges_vials: Some(bench.exchanges_vials()),
        latch,
        held,
        moving,
        piling: bench.stand().and_then(PileStand::piling),
        waiting,
        vial,
        reservation,
        unwritten,
        repeatability,
    }
}

/// The person's name, checked together with the note.
pub(super) fn check_person<'a>(check: &mut Check, by: &'a str, note: &str) -> &'a str {
    let by = by.trim();
    if by.is_empty() || by.len() > WORDS_MAX || by.chars().any(char::is_control) {
        check.refuse("by", "must name the person, in one line".to_owned());
    }
    if note.len() > WORDS_MAX {
        check.refuse("note", format!("must be at most {WORDS_MAX} bytes, got {}", note.len()));
    }
    by
}
