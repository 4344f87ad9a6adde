//! An extended simulator as data: how strong each cause is under given conditions, and how that
//! changes the simulated powder.
//!
//! ```text
//! u = (s(x) - s_0) / (s_1 - s_0)      amplitude = A f u      shift = e u
//! ```
//!
//! Here s is the form over the covariates x and s_0 its value at the reference, where u is 0 and
//! the extended simulator equals its parent bit for bit; s_1 is its value after a change as from
//! the 5th to the 95th percentile seen in the campaign. A is the amplitude of the simulator's
//! mechanism there, f a powder's factor and e its effect in degrees. Amplitudes are never negative,
//! so the reference is the end of the range seen at which the mechanism is weakest. Corrections of
//! readings (`method`, `operator`, place in the session) change no grain, only which angle is
//! meant: their reference is the campaign's average.

use crate::causes::catalogue::Mechanism;
pub use crate::causes::hook::Hook;
use crate::data::scenario::quantile;
pub use crate::report::FitSet;
use crate::report::ParameterReport;
use flip_core::domain::FieldError;
use flip_core::domain::conditions::{Condition, Conditions, Patch};
use flip_core::domain::powder::Flowability;
use flip_core::domain::seed::derive;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How strong a cause is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Form {
    /// A form of the catalogue over the covariates, by name.
    Named(String),
    /// Points and strengths of a course over one covariate, interpolated linearly.
    Course(Vec<[f64; 2]>),
    /// A strength for each name.
    Levels(BTreeMap<String, f64>),
    /// 1 for the powders listed, whatever the conditions, and 0 for all others.
    Constant,
}

/// A covariate that an extension acts through.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Through {
    /// Name of the campaign's column.
    pub name: String,
    /// Where the mechanism is weakest.
    pub reference: Condition,
    /// Quantiles of the values seen in the campaign, evenly spaced from minimum to maximum, which
    /// bound valid requests; empty for names.
    pub quantiles: Vec<f64>,
    /// Share of the campaign's runs with each name; empty for numbers.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub shares: BTreeMap<String, f64>,
}

/// What an extension does to one powder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OnPowder {
    /// Powder id.
    pub powder: String,
    /// Change of its angle at strength 1, degrees.
    pub effect_deg: f64,
    /// Factor on the amplitude: 1 if it follows the effect as simulated powders do.
    pub factor: f64,
}

/// One cause as a mechanism of the simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Extension {
    /// Cause, as named in reports.
    pub mechanism: String,
    /// Where it enters the simulator.
    pub hook: Hook,
    /// How strong it is.
    pub form: Form,
    /// The covariates it acts through, in the order of the form's arguments.
    pub through: Vec<Through>,
    /// The form's value at strength 0 and at strength 1.
    pub strength: [f64; 2],
    /// Change of the angle at strength 1, degrees, on average over powders.
    pub effect_deg: f64,
    /// Its 95 % interval.
    pub effect_ci95: [f64; 2],
    /// Amplitude at strength 1; for readings, the effect itself.
    pub amplitude: ParameterReport,
    /// Differences between powders; the others have the mean effect and a factor of 1.
    pub powders: Vec<OnPowder>,
    /// Simulated heaps behind the amplitude; absent where it is read off the table of the
    /// simulator's responses.
    pub fit: Option<Fit>,
}

/// How an amplitude was found and verified.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// The powders and the sets that stood for them.
    pub sets: Vec<FitSet>,
    /// Number of heaps, including those of the verification.
    pub runs: u32,
    /// Each simulated amplitude, with the mean shift from the reference and its standard error,
    /// degrees.
    pub shifts: Vec<[f64; 3]>,
    /// Shift at the fitted amplitude, over fresh seeds, and its standard error, degrees.
    pub verification: [f64; 2],
    /// The interval the shift had to lie in: the effect's, widened by twice the standard error.
    pub accepted: [f64; 2],
    /// Whether it does.
    pub verified: bool,
}

/// A powder's angle at the reference.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AtReference {
    /// Powder id.
    pub powder: String,
    /// The extended simulator's prediction at the reference.
    pub repose: Flowability,
}

/// What a version of the simulator adds to its base.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Extended {
    /// Its causes.
    pub extensions: Vec<Extension>,
    /// The campaign's powders.
    pub powders: Vec<AtReference>,
}

impl Extended {
    /// Both together; a powder of both has the angle of the first.
    #[must_use]
    pub fn and(mut self, other: Self) -> Self {
        let is_known = |it: &AtReference| self.powders.iter().any(|own| own.powder == it.powder);
        let new: Vec<_> = other.powders.into_iter().filter(|it| !is_known(it)).collect();
        self.extensions.extend(other.extensions);
        self.powders.extend(new);
        self
    }

    /// Returns the changes to a powder under these conditions; without a powder, or for one not in
    /// the campaign, those to an average one. Conditions that only correct readings may be left
    /// out.
    ///
    /// # Errors
    /// Every condition that is missing, outside the range the campaign saw, or that no cause acts
    /// through, as `conditions.<name>`.
    pub fn at(
        &self,
        powder: Option<&str>,
        conditions: &Conditions,
    ) -> Result<Patch, Vec<FieldError>> {
        self.checked(conditions, |extension| extension.hook != Hook::Reading)?;
        let mut patch = Patch::default();
        for extension in &self.extensions {
            let strength =
                extension.on(powder).1 * extension.strength_at(conditions).unwrap_or(0.0);
            let more = extension.patch(extension.amplitude.value * strength);
            let slots = [
                (&mut patch.amplitudes, more.amplitudes),
                (&mut patch.parameters, more.parameters),
                (&mut patch.heap, more.heap),
            ];
            for (slot, more) in slots {
                more.into_iter().for_each(|(name, more)| *slot.entry(name).or_default() += more);
            }
        }
        Ok(patch)
    }

    /// Difference between the angle read under these conditions and the one at the reference,
    /// degrees.
    ///
    /// # Errors
    /// As [`Self::at`].
    pub fn shift_deg(
        &self,
        powder: Option<&str>,
        conditions: &Conditions,
    ) -> Result<f64, Vec<FieldError>> {
        self.checked(conditions, |_| true)?;
        Ok(self.extensions.iter().map(|extension| extension.shift_deg(powder, conditions)).sum())
    }

    /// Conditions of `count` days, seeded: held conditions are as given, the rest follow the
    /// campaign's distribution evenly. Causes of readings do not count.
    ///
    /// # Errors
    /// As [`Self::at`], but nothing has to be held.
    pub fn days(
        &self,
        held: &Conditions,
        count: usize,
        seed: u64,
    ) -> Result<Vec<Conditions>, Vec<FieldError>> {
        self.checked(held, |_| false)?;
        let mut days = vec![held.clone(); count];
        for (k, through) in self
            .through()
            .into_iter()
            .filter(|through| !held.contains_key(&through.name))
            .enumerate()
        {
            let mut rng = Pcg64Mcg::seed_from_u64(derive(seed, &[k as u64]));
            let mut shares: Vec<f64> =
                (0..count).map(|i| (i as f64 + rng.random::<f64>()) / count as f64).collect();
            shares.shuffle(&mut rng);
            for (day, share) in days.iter_mut().zip(shares) {
                day.insert(through.name.clone(), through.drawn(share));
            }
        }
        Ok(days)
    }

    /// Every covariate the causes act through, each once.
    pub fn through(&self) -> Vec<&Through> {
        let mut all: Vec<&Through> = Vec::new();
        for through in self.extensions.iter().flat_map(|extension| &extension.through) {
            if !all.iter().any(|known| known.name == through.name) {
                all.push(through);
            }
        }
        all
    }

    fn checked(
        &self,
        conditions: &Conditions,
        needed: impl Fn(&Extension) -> bool,
    ) -> Result<(), Vec<FieldError>> {
        let all = self.through();
        let field = |name: &str| format!("conditions.{name}");
        let names =
            || all.iter().map(|through| through.name.as_str()).collect::<Vec<_>>().join(", ");
        let mut errors = Vec::new();
        for (name, condition) in conditions {
            match all.iter().find(|through| through.name == *name) {
                Some(through) => errors.extend(
                    through.refusal(condition).map(|why| FieldError::new(field(name), why)),
                ),
                None => {
                    let why = format!(
                        "does nothing in this version, which acts through {}: leave it out",
                        names()
                    );
                    errors.push(FieldError::new(field(name), why));
                }
            }
        }
        let is_needed = |name: &str| {
            self.extensions.iter().any(|extension| {
                needed(extension) && extension.through.iter().any(|through| through.name == name)
            })
        };
        let missing = all
            .iter()
            .filter(|through| !conditions.contains_key(&through.name) && is_needed(&through.name));
        errors.extend(missing.map(|through| {
            FieldError::new(
                field(&through.name),
                format!("is missing: the version acts through it; give {}", through.bounds()),
            )
        }));
        if errors.is_empty() { Ok(()) } else { Err(errors) }
    }
}

impl Extension {
    /// The changes an amplitude makes to a powder. Zero is not written down: the patch of the
    /// reference is empty.
    pub(crate) fn patch(&self, amplitude: f64) -> Patch {
        let mut patch = Patch::default();
        let (slot, name) = match &self.hook {
            Hook::Extension(name) => (&mut patch.amplitudes, name),
            Hook::Parameter(name) => (&mut patch.parameters, name),
            Hook::Heap(name) => (&mut patch.heap, name),
            Hook::Reading => return patch,
        };
        if amplitude != 0.0 {
            slot.insert(name.clone(), amplitude);
        }
        patch
    }

    /// Its contribution to a powder's angle, degrees; zero where a condition is missing.
    pub(crate) fn shift_deg(&self, powder: Option<&str>, conditions: &Conditions) -> f64 {
        self.on(powder).0 * self.strength_at(conditions).unwrap_or(0.0)
    }

    /// Effect in degrees and factor of a powder.
    fn on(&self, powder: Option<&str>) -> (f64, f64) {
        let own = self.powders.iter().find(|on| Some(on.powder.as_str()) == powder);
        let other = if self.form == Form::Constant { (0.0, 0.0) } else { (self.effect_deg, 1.0) };
        own.map_or(other, |own| (own.effect_deg, own.factor))
    }

    /// u; `None` where a condition is missing or of the wrong kind.
    fn strength_at(&self, conditions: &Conditions) -> Option<f64> {
        let value = match &self.form {
            Form::Levels(strengths) => {
                *strengths.get(&conditions.get(&self.through.first()?.name)?.to_string())?
            }
            form => {
                let number = |through: &Through| match conditions.get(&through.name)? {
                    Condition::Number(number) => Some(*number),
                    Condition::Name(_) => None,
                };
                let values: Vec<f64> = self.through.iter().map(number).collect::<Option<_>>()?;
                match form {
                    Form::Named(name) => self.named(name, &values)?,
                    Form::Course(course) => along(course, *values.first()?)?,
                    Form::Constant => 1.0,
                    Form::Levels(_) => return None,
                }
            }
        };
        let [zero, one] = self.strength;
        let u = (value - zero) / (one - zero);
        // Forms are monotonic and the reference is an end, so only rounding goes below; for
        // readings, values below the average exist.
        Some(if self.hook == Hook::Reading { u } else { u.max(0.0) })
    }

    fn named(&self, form: &str, values: &[f64]) -> Option<f64> {
        let mechanism =
            Mechanism::ALL.into_iter().find(|mechanism| mechanism.name().0 == self.mechanism)?;
        mechanism.strength(form, values)
    }
}

/// A course at a point, constant beyond its ends.
fn along(course: &[[f64; 2]], at: f64) -> Option<f64> {
    let next =
        course.iter().position(|place| place[0] >= at).unwrap_or(course.len().checked_sub(1)?);
    let ([low, below], [high, above]) = (course[next.saturating_sub(1)], course[next]);
    let share = if high > low { ((at - low) / (high - low)).clamp(0.0, 1.0) } else { 0.0 };
    Some(below + share * (above - below))
}

impl Through {
    /// The valid values, in words.
    fn bounds(&self) -> String {
        match (self.quantiles.first(), self.quantiles.last()) {
            (Some(low), Some(high)) => {
                format!("a number from {low} to {high}, which is what the campaign saw")
            }
            _ => format!("one of {}", self.shares.keys().cloned().collect::<Vec<_>>().join(", ")),
        }
    }

    /// Why this condition is refused.
    fn refusal(&self, condition: &Condition) -> Option<String> {
        let is_seen = match (condition, self.quantiles.first(), self.quantiles.last()) {
            (Condition::Number(number), Some(low), Some(high)) => (*low..=*high).contains(number),
            (Condition::Name(_), Some(_), _) => false,
            (condition, ..) => self.shares.contains_key(&condition.to_string()),
        };
        let advice = "measure there and investigate again to go further";
        (!is_seen).then(|| format!("must be {}, got {condition}: {advice}", self.bounds()))
    }

    /// The condition below which this share of the campaign's values lies.
    fn drawn(&self, share: f64) -> Condition {
        if let Some(value) = quantile(&self.quantiles, share) {
            return Condition::Number(value);
        }
        let mut below = 0.0;
        let reached = self.shares.iter().find(|(_, of)| {
            below += **of;
            share < below
        });
        reached
            .or(self.shares.iter().next_back())
            .map_or(self.reference.clone(), |(name, _)| Condition::Name(name.clone()))
    }
}

#[cfg(test)]
#[path = "extension_tests.rs"]
mod tests;
