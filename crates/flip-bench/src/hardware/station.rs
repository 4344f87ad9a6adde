//! A bench made of devices: a balance, an arm that holds the spoon, optionally a gripper on it. It
//! cannot tell emulated devices from real ones.

use super::arm::{Arm, Deadlines, Stopper};
use super::balance::{Balance, Sample};
use super::bench_file::{BenchFile, Readings};
use super::clock::Clock;
use super::gripper::{Gripper, fault_words};
use super::settle::{Settling, Shown, settled, standing};
use super::wire::Tap;
use super::{Bench, DeviceError};
use flip_core::domain::apparatus::{Stroke, StrokeResponse};
use flip_core::domain::bench::{Action, Moment, PitchLimits, Reach, Reading, Standing, Tare};
use flip_core::domain::bench_check::ShakeCalibration;
use flip_core::domain::spoon::FilledBy;
use std::collections::BTreeMap;

/// Bench time between two requests to the balance, s: its frames are a tenth or two apart.
const ASK_EVERY_S: f64 = 0.05;
/// The same while averaging over many seconds: the wander of the display is correlated for longer.
const WATCH_EVERY_S: f64 = 0.5;
/// The spoon counts as being at a pitch this near, degrees.
const PITCH_DEG_MIN: f64 = 1e-6;
/// A vial may weigh this much less than the one tared before, mg.
const LIGHTER_MG_MAX: f64 = 2000.0;
/// For a bench whose arm does not scoop.
const BY_HAND: &str = "filled by a person or a station before each dose, for the arm does not";
/// Largest display step accepted for weighing, mg, where the file does not give one.
const STEP_MG_DEFAULT: f64 = 1.0;

/// The devices of one bench, open and under control. Dropping it levels and retracts the spoon.
pub struct Station {
    balance: Balance,
    arm: Arm,
    gripper: Option<Gripper>,
    /// The arm fills the spoon; otherwise someone has filled it before the dose.
    fills: bool,
    clock: Clock,
    readings: Readings,
    settling: Settling,
    shakes: Option<ShakeCalibration>,
    pitch_deg: f64,
    /// End of the last motion, bench time, s.
    moved_at_s: f64,
    /// Displayed mass, mg.
    shown_mg: Option<f64>,
    /// When the display last changed, bench time, s.
    lived_at_s: f64,
    began_s: f64,
}

impl Station {
    /// Open every device, take control of the arm, and check that a spoon is held.
    ///
    /// `shakes` is the arm's shake calibration, if there is one: commanded amplitudes are then
    /// corrected so that the desired ones are executed.
    ///
    /// # Errors
    /// The first device that is not available, or must not be used.
    pub fn open(
        file: &BenchFile,
        shakes: Option<ShakeCalibration>,
        clock: Clock,
        tap: &Tap,
    ) -> Result<Self, DeviceError> {
        Self::open_within(file.arm.deadlines(), file, shakes, clock, tap)
    }

    /// The same with other deadlines for the arm: for benches with slow motions, and for emulated
    /// ones, whose motions take no time.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_within(
        deadlines: Deadlines,
        file: &BenchFile,
        shakes: Option<ShakeCalibration>,
        clock: Clock,
        tap: &Tap,
    ) -> Result<Self, DeviceError> {
        let balance = Balance::open(&file.balance, tap.clone(), clock.clone())?
            .with_noise_mg(file.readings.noise_mg);
        let mut gripper =
            file.gripper.as_ref().map(|it| Gripper::open(&it.port, tap.clone())).transpose()?;
        let mut arm = Arm::connect(&file.arm.url, tap.clone(), deadlines)?;
        if let Some(gripper) = &mut gripper {
            require_spoon(gripper)?;
        }
        arm.acquire()?;
        let fills = file.spoon.filled_by != FilledBy::Hand && arm.description().can_scoop;
        let step_mg =
            file.balance.readability_mg.unwrap_or(STEP_MG_DEFAULT).max(file.readings.noise_mg);
        let began_s = clock.now_s();
        Ok(Self {
            balance,
            arm,
            gripper,
            fills,
            clock,
            readings: file.readings,
            settling: Settling::new(step_mg),
            shakes,
            pitch_deg: 0.0,
            moved_at_s: began_s,
            shown_mg: None,
            lived_at_s: f64::NEG_INFINITY,
            began_s,
        })
    }

    /// A handle that stops the arm at once from any thread.
    ///
    /// # Errors
    /// The arm cannot be reached.
    pub fn stopper(&self) -> Result<Stopper, DeviceError> {
        self.arm.stopper()
    }

    /// How the arm strokes, within its own limits and by its calibration.
    pub fn stroke(&self) -> Stroke {
        let limits = self.arm.limits();
        let response = self.shakes.as_ref().map(StrokeResponse::from);
        Stroke { shake_mm_max: limits.shake_mm_max, limits: limits.motion, response }
    }

    /// Identities of the devices, by role.
    ///
    /// # Errors
    /// The balance failed.
    pub fn devices(&mut self) -> Result<BTreeMap<String, String>, DeviceError> {
        let identity = match self.balance.identify() {
            Ok(identity) => identity,
            // Some balances report nothing about themselves and weigh all the same.
            Err(DeviceError::Silent { .. }) => Default::default(),
            Err(error) => return Err(error),
        };
        let told = [
            Some(identity.maker),
            identity.model,
            identity.serial.map(|serial| format!("serial {serial}")),
        ];
        let balance = told
            .into_iter()
            .flatten()
            .filter(|part| !part.is_empty())
            .collect::<Vec<_>>()
            .join(", ");
        let arm = self.arm.description();
        let arm = format!("{}, serial {}", arm.name, arm.serial);
        let gripper =
            self.gripper.as_ref().map(|_| ("gripper".to_owned(), "Robotiq 2F-85".to_owned()));
        let spoon = (!self.fills).then(|| ("spoon".to_owned(), BY_HAND.to_owned()));
        let roles = [("balance".to_owned(), balance), ("arm".to_owned(), arm)];
        Ok(roles.into_iter().chain(gripper).chain(spoon).collect())
    }

    /// Fill the spoon, if the arm does that.
    fn fill(&mut self) -> Result<(), DeviceError> {
        if !self.fills {
            return Ok(());
        }
        match self.arm.scoop() {
            // It claimed more than it can do.
            Err(DeviceError::Unsupported { .. }) => self.fills = false,
            filled => drop(filled?),
        }
        Ok(())
    }

    fn moved(&mut self) {
        self.moved_at_s = self.clock.now_s();
    }

    /// Read the display, and note whether it changed.
    fn look(&mut self) -> Result<Sample, DeviceError> {
        let sample = self.balance.immediate()?;
        self.arm.attend();
        if self.shown_mg.is_some_and(|shown_mg| shown_mg != sample.mass_mg) {
            self.lived_at_s = sample.t_s;
        }
        self.shown_mg = Some(sample.mass_mg);
        Ok(sample)
    }

    /// Readings since the last motion, until the display is final or the time is up.
    fn watch(
        &mut self,
        limit_s: f64,
        is_final: impl Fn(&[Shown]) -> bool,
    ) -> Result<Vec<Shown>, DeviceError> {
        let from_s = self.clock.now_s();
        let mut shown = Vec::new();
        loop {
            let Sample { t_s, mass_mg, stable, .. } = self.look()?;
            shown.push(Shown { t_s: t_s - self.moved_at_s, mass_mg, flag: stable });
            if is_final(&shown) || t_s - from_s >= limit_s {
                return Ok(shown);
            }
            self.clock.wait_s(ASK_EVERY_S);
        }
    }
}

fn require_spoon(gripper: &mut Gripper) -> Result<(), DeviceError> {
    let status = gripper.status()?;
    if status.fault != 0 {
        let cause = format!("fault {}: {}", status.fault, fault_words(status.fault));
        return Err(DeviceError::Faulted { device: "the gripper", cause });
    }
    match status.holds() {
        true => Ok(()),
        false => Err(DeviceError::Forbidden {
            device: "the gripper",
            cause: "it holds no spoon: put one between its fingers and close them".to_owned(),
        }),
    }
}

impl Bench for Station {
    fn approach(&mut self) -> Result<(), DeviceError> {
        self.fill()?;
        if let Some(gripper) = &mut self.gripper {
            require_spoon(gripper)?;
        }
        self.arm.approach()?;
        self.pitch_deg = 0.0;
        self.moved();
        Ok(())
    }

    fn tare(&mut self) -> Result<Tare, DeviceError> {
        let vial = self.balance.stable(self.readings.stand_max_s)?;
        if vial.mass_mg < -LIGHTER_MG_MAX {
            let cause = format!(
                "it shows {} mg less than when it was tared: is a vial on it?",
                -vial.mass_mg
            );
            return Err(DeviceError::Forbidden { device: "the balance", cause });
        }
        self.balance.tare()?;
        // Zero is not a change: it was requested.
        self.shown_mg = None;
        self.moved();
        Ok(Tare { tare_mg: Some(vial.mass_mg) })
    }

    fn read(&mut self) -> Result<Reading, DeviceError> {
        let settling = self.settling;
        if let Some(wait_s) = self.readings.fixed_wait_s {
            self.clock.wait_s(wait_s - (self.clock.now_s() - self.moved_at_s));
            let Sample { mass_mg, stable, .. } = self.look()?;
            return Ok(Reading { mass_mg, stable });
        }
        let shown =
            self.watch(self.readings.settle_max_s, |shown| settled(&settling, shown).is_some())?;
        let last = shown.last().ok_or(DeviceError::Silent { device: "the balance" })?;
        // Our own criterion, or the balance's flag if the previous reading agrees.
        let before = shown.len().checked_sub(2).map(|k| shown[k].mass_mg);
        let agrees =
            before.is_some_and(|mass_mg| (mass_mg - last.mass_mg).abs() <= settling.step_mg + 1e-9);
        let stable = settled(&settling, &shown).is_some() || (last.flag && agrees);
        Ok(Reading { mass_mg: last.mass_mg, stable })
    }

    fn stand(&mut self, seconds: f64) -> Result<Standing, DeviceError> {
        let settling = self.settling;
        let limit_s = seconds.max(self.readings.stand_max_s);
        let from_s = self.clock.now_s() - self.moved_at_s;
        let enough = |shown: &[Shown]| {
            let last = shown.last();
            last.is_some_and(|last| last.flag && last.t_s - from_s >= seconds)
                && settled(&settling, shown).is_some()
        };
        let shown = self.watch(limit_s, enough)?;
        // The slope covers only the requested time: before it the load may still have been
        // settling.
        let from_s = shown.last().map_or(0.0, |last| last.t_s - seconds.max(1.0));
        let recent: Vec<Shown> = shown.iter().copied().filter(|one| one.t_s >= from_s).collect();
        let mut found =
            standing(&settling, &recent).ok_or(DeviceError::Silent { device: "the balance" })?;
        found.rest.at_s += self.moved_at_s - self.began_s;
        Ok(found)
    }

    fn readings(&mut self, seconds: f64) -> Result<Vec<Moment>, DeviceError> {
        let until_s = self.clock.now_s() + seconds;
        let mut seen = Vec::new();
        loop {
            let Sample { t_s, mass_mg, .. } = self.look()?;
            seen.push(Moment { t_s: t_s - self.began_s, mass_mg });
            self.clock.wait_s(WATCH_EVERY_S);
            if self.clock.now_s() >= until_s {
                return Ok(seen);
            }
        }
    }

    fn is_the_same(&mut self) -> Result<(), DeviceError> {
        self.balance.is_the_same()
    }

    fn lived_s(&self) -> f64 {
        self.lived_at_s - self.began_s
    }

    fn watch_for_life(&mut self, seconds: f64) -> Result<bool, DeviceError> {
        let from_s = self.clock.now_s();
        loop {
            let t_s = self.look()?.t_s;
            if self.lived_at_s >= from_s {
                return Ok(true);
            }
            if t_s - from_s >= seconds {
                return Ok(false);
            }
            self.clock.wait_s(ASK_EVERY_S);
        }
    }

    fn act(&mut self, action: Action) -> Result<(), DeviceError> {
        if let Some(gripper) = &mut self.gripper {
            require_spoon(gripper)?;
        }
        // An allowed pitch is within the limits up to the rounding of a sum.
        let PitchLimits { lower_deg, upper_deg } = self.arm.limits().pitch;
        let pitch_deg = (self.pitch_deg + action.incline_change_deg).clamp(lower_deg, upper_deg);
        if action.incline_change_deg.abs() > PITCH_DEG_MIN {
            self.pitch_deg = self.arm.pitch(pitch_deg)?.pitch_deg;
            self.moved();
        }
        let wanted_mm = action.executed_shake_mm();
        if wanted_mm > 0.0 {
            let commanded_mm =
                self.shakes.as_ref().map_or(wanted_mm, |line| line.commanded_mm(wanted_mm));
            let commanded_mm = commanded_mm.min(self.arm.limits().shake_mm_max);
            for _ in 0..action.strokes.max(1) {
                self.arm.shake(commanded_mm)?;
                self.moved();
            }
        }
        Ok(())
    }

    fn level(&mut self) -> Result<(), DeviceError> {
        let levelled = self.arm.pitch(0.0);
        self.moved();
        // After a stop the arm executes only a retract, which levels the spoon first.
        match levelled {
            Ok(executed) => {
                self.pitch_deg = executed.pitch_deg;
                Ok(())
            }
            Err(_) => self.retract(),
        }
    }

    fn retract(&mut self) -> Result<(), DeviceError> {
        self.arm.retract()?;
        self.pitch_deg = 0.0;
        self.moved();
        Ok(())
    }

    fn discard(&mut self) -> Result<(), DeviceError> {
        if !self.arm.description().can_discard {
            return Ok(());
        }
        match self.arm.discard() {
            // The rest stays in the spoon, as with an arm that declares this beforehand.
            Err(DeviceError::Unsupported { .. }) => Ok(()),
            emptied => emptied.map(drop),
        }
    }

    fn can_refill(&self) -> bool {
        self.fills
    }

    fn reach(&self) -> Reach {
        let limits = self.arm.limits();
        Reach { pitch: limits.pitch, shake_mm_max: limits.shake_mm_max }
    }

    fn pitch_deg(&self) -> f64 {
        self.pitch_deg
    }

    fn elapsed_s(&self) -> f64 {
        self.clock.now_s() - self.began_s
    }
}
