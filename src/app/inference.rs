//! A policy driving another robot: takes observations and returns the next action. Nothing moves
//! here, and nothing is stored.

use super::Result;
use flip_core::domain::bench::Action;
use flip_core::domain::{FieldError, bounded};
use flip_policy::{self as policy, Done, Dosing, Episode, Observation, Policy, Rules};
use serde::Serialize;

/// What a policy proposes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Proposal {
    /// The action: the robot's own guard must bound it, as the policy does not know the robot's
    /// limits.
    #[serde(flatten)]
    pub action: Action,
    /// Whether the rules that the policy was made for would continue: if not, level the spoon
    /// instead.
    pub episode: Episode,
}

/// Largest reading of a tared vial into which nothing was poured, mg.
const TARE_MG_MAX: f64 = 1.0;

/// A policy loaded from its file.
#[derive(Debug, Clone)]
pub struct Driver(Policy);

/// One weighing driven by a policy; it remembers observations and proposals.
#[derive(Debug)]
pub struct Driving<'a> {
    dosing: Dosing<'a>,
    rules: Rules,
    readability_mg: f64,
    remembers: bool,
    steps: u32,
    target_mg: Option<f64>,
}

impl Driver {
    /// Loads the policy in these bytes; `field` names them in errors.
    ///
    /// # Errors
    /// `Invalid` if they are not a policy.
    pub fn read(field: &str, bytes: &[u8]) -> Result<Self> {
        let policy =
            policy::decode(bytes).map_err(|error| FieldError::new(field, error.to_string()))?;
        Ok(Self(policy))
    }

    /// Starts a weighing on a balance with display steps of `readability_mg`.
    ///
    /// # Errors
    /// `Invalid` outside 0.001 to 10 mg.
    pub fn begin(&self, readability_mg: f64) -> Result<Driving<'_>> {
        bounded("readability_mg", readability_mg, 0.001, 10.0, "mg")?;
        let rules = self.0.manifest.rules;
        let dosing = self.0.controller.begin(&rules, readability_mg);
        let remembers = !self.0.controller.is_memoryless();
        Ok(Driving { dosing, rules, readability_mg, remembers, steps: 0, target_mg: None })
    }
}

impl Driving<'_> {
    /// Adds steps that were carried out before, in order.
    ///
    /// # Errors
    /// `Invalid` names the first impossible number, such as `history[0].before.reading_mg`.
    pub fn resume(&mut self, history: &[Done]) -> Result<()> {
        for (k, step) in history.iter().enumerate() {
            self.check(&format!("history[{k}].before."), &step.before)?;
            self.check(&format!("history[{k}].after."), &step.after)?;
            self.check_beginning(&format!("history[{k}].before."), &step.before)?;
            let action = format!("history[{k}].action.");
            bounded(
                &format!("{action}incline_change_deg"),
                step.action.incline_change_deg,
                -90.0,
                90.0,
                "deg",
            )?;
            bounded(&format!("{action}shake_mm"), step.action.shake_mm, 0.0, 1000.0, "mm")?;
            self.dosing.resume(*step);
            self.steps += 1;
        }
        Ok(())
    }

    /// The action for the next step; the previous one is taken as carried out.
    ///
    /// # Errors
    /// `Invalid` names what is impossible.
    pub fn next(&mut self, seen: &Observation) -> Result<Proposal> {
        self.check("", seen)?;
        self.check_beginning("", seen)?;
        let episode = self.rules.after(self.steps, seen, self.readability_mg);
        self.steps += 1;
        Ok(Proposal { action: self.dosing.propose(seen), episode })
    }

    /// A policy with memory would take a first reading for powder released by the previous step.
    fn check_beginning(&self, path: &str, seen: &Observation) -> Result<()> {
        if self.steps > 0 || !self.remembers || seen.reading_mg.abs() <= TARE_MG_MAX {
            return Ok(());
        }
        let message = format!(
            "must be within {TARE_MG_MAX} mg of the tare, 0, before the first step, got {} mg: this policy remembers the weighing; give the earlier \
             steps too (--history, or one line each to --stdin)",
            seen.reading_mg
        );
        Err(FieldError::new(format!("{path}reading_mg"), message).into())
    }

    /// Checks that the numbers are possible for a balance and an arm, and that the target stays the
    /// same throughout the weighing.
    fn check(&mut self, path: &str, seen: &Observation) -> Result<()> {
        bounded(&format!("{path}reading_mg"), seen.reading_mg, -1e6, 1e6, "mg")?;
        bounded(&format!("{path}target_mg"), seen.target_mg, 0.1, 1e6, "mg")?;
        bounded(&format!("{path}pitch_deg"), seen.pitch_deg, -90.0, 90.0, "deg")?;
        let target_mg = *self.target_mg.get_or_insert(seen.target_mg);
        if target_mg != seen.target_mg {
            let message =
                format!("must stay {target_mg} mg throughout a weighing, got {}", seen.target_mg);
            return Err(FieldError::new(format!("{path}target_mg"), message).into());
        }
        Ok(())
    }
}
