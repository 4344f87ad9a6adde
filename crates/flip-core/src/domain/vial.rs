//! The vial on the pan of a bench that cannot exchange it: what is known of it, and what the display must not show if another, empty one is to be on it.
//!
//! Each dose sets the display to zero, so that before the next one it shows what was poured if nobody has exchanged the vial, and the difference of two
//! empty vials if somebody has. Adding up what it showed each time gives the mass of every vial from one origin, as long as nobody else sets it to zero.

use super::timestamp::Timestamp;
use super::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// Displays this many steps apart may be of one load.
const STEPS_ALIKE: f64 = 3.0;
/// However fine the display: a balance's zero wanders between two doses by this much, mg.
const WANDER_MG: f64 = 2.0;
/// Empty vials that must have been seen before others are compared with them.
const EMPTIES_MIN: usize = 5;
/// Empty vials that are remembered.
const EMPTIES_MAX: usize = 20;
/// An empty vial is within so many standard deviations of the mean of five.
const SPREADS: f64 = 6.0;
/// And within this of it, mg, however alike the five were.
const ALIKE_MG: f64 = 5.0;

/// Whether a person must confirm that the vial is in before a dose starts, where the bench cannot exchange vials.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum VialCheck {
    /// A person confirms, and the balance checks that it is another vial and empty.
    #[default]
    Confirm,
    /// No confirmation and no check: FLIP doses into whatever is on the pan.
    Skip,
}

impl VialCheck {
    /// The default.
    pub fn is_confirm(&self) -> bool {
        *self == Self::Confirm
    }
}

/// What an empty vial of a lab weighs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EmptyVial {
    /// In the mean, mg.
    pub empty_mg: f64,
    /// Most that one differs from it, mg.
    pub spread_mg: f64,
}

impl EmptyVial {
    /// It, if it can be.
    ///
    /// # Errors
    /// The field that is out of its bounds.
    pub fn checked(self) -> Result<Self, FieldError> {
        bounded("empty_mg", self.empty_mg, 1.0, 1e7, "mg")?;
        bounded("spread_mg", self.spread_mg, 0.1, self.empty_mg, "mg")?;
        Ok(self)
    }

    fn holds(&self, mass_mg: f64) -> bool {
        (mass_mg - self.empty_mg).abs() <= self.spread_mg
    }

    /// Displays that show one where zero stands for this load, mg.
    fn band(&self, zero_mg: f64) -> Band {
        let middle_mg = self.empty_mg - zero_mg;
        Band { lower_mg: middle_mg - self.spread_mg, upper_mg: middle_mg + self.spread_mg }
    }
}

/// The vial on the pan, as far as known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Vial {
    /// Its name, if one was given.
    pub name: Option<String>,
    /// The weighing that last poured into it.
    pub weighing: String,
    /// Mass poured into it by the display, mg; absent if unknown.
    pub holds_mg: Option<f64>,
    /// Start of the first dose into it.
    pub since: Timestamp,
}

/// What is known of the pan.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Pan {
    /// What stands on it; none: nothing is known, or a person has emptied or exchanged it.
    pub vial: Option<Vial>,
    /// The load that the display's zero stands for, mg from an origin that stays; none: nobody knows.
    pub zero_mg: Option<f64>,
    /// What the display showed when the last dose had ended, mg.
    pub shown_mg: Option<f64>,
    /// What vials weighed that somebody had said were empty, mg from the same origin, the newest last.
    #[serde(default)]
    pub empties_mg: Vec<f64>,
}

/// What a dose did to the pan.
#[derive(Debug, Clone, PartialEq)]
pub struct Dosed {
    /// The weighing.
    pub weighing: String,
    /// The vial that it was for, where it has a name.
    pub vial: Option<String>,
    /// When it began.
    pub at: Timestamp,
    /// What the display showed when it was set to zero, mg.
    pub tare_mg: f64,
    /// What it showed in the end, mg.
    pub shown_mg: f64,
    /// Somebody had said that the vial is empty, and the balance did not contradict.
    pub confirmed: bool,
    /// Step of the display, mg.
    pub step_mg: f64,
}

/// Displays from here to there, mg.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Band {
    /// Smallest.
    pub lower_mg: f64,
    /// Largest.
    pub upper_mg: f64,
}

impl Band {
    fn holds(&self, shown_mg: f64) -> bool {
        (self.lower_mg..=self.upper_mg).contains(&shown_mg)
    }
}

/// What the display must show before anything moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PanCheck {
    /// Displays of the vial of the dose before, which holds powder.
    pub before: Option<Band>,
    /// Displays of an empty vial of this lab, by each of the loads that zero may stand for.
    pub empty: [Option<Band>; 2],
}

/// Why nothing is poured into what stands on the pan.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum VialFlaw {
    /// It is the vial of the dose before.
    #[error(
        "the balance shows {shown_mg:.1} mg, as at the end of the dose before: the vial that was poured into is still on the pan"
    )]
    SameAsBefore {
        /// Before anything moved, mg.
        shown_mg: f64,
    },
    /// It weighs more than an empty one.
    #[error(
        "what is on the pan weighs {over_mg:.1} mg more than the heaviest empty vial of this lab: it is not empty, or of another kind"
    )]
    NotEmpty {
        /// How much more, mg.
        over_mg: f64,
    },
    /// It weighs less than an empty one.
    #[error(
        "what is on the pan weighs {under_mg:.1} mg less than the lightest empty vial of this lab: is a vial on it?"
    )]
    TooLight {
        /// How much less, mg.
        under_mg: f64,
    },
}

impl PanCheck {
    /// Whatever it shows.
    pub const NONE: Self = Self { before: None, empty: [None, None] };

    /// What is wrong with the pan if the display shows this, mg.
    pub fn flaw(&self, shown_mg: f64) -> Option<VialFlaw> {
        if self.before.is_some_and(|band| band.holds(shown_mg)) {
            return Some(VialFlaw::SameAsBefore { shown_mg });
        }
        let bands = || self.empty.iter().flatten();
        if bands().next().is_none() || bands().any(|band| band.holds(shown_mg)) {
            return None;
        }
        let over_mg = bands().map(|band| shown_mg - band.upper_mg).filter(|mg| *mg > 0.0).fold(f64::INFINITY, f64::min);
        let under_mg =
            bands().map(|band| band.lower_mg - shown_mg).filter(|mg| *mg > 0.0).fold(f64::INFINITY, f64::min);
        Some(if over_mg <= under_mg { VialFlaw::NotEmpty { over_mg } } else { VialFlaw::TooLight { under_mg } })
    }
}

impl Pan {
    /// What the display must show before a dose into a vial that somebody says is in and empty.
    pub fn check(&self, step_mg: f64, lab: Option<EmptyVial>) -> PanCheck {
        PanCheck { before: self.filled_band(step_mg), empty: self.empty_bands(lab) }
    }

    fn filled_band(&self, step_mg: f64) -> Option<Band> {
        let (vial, shown_mg) = (self.vial.as_ref()?, self.shown_mg?);
        let alike_mg = (STEPS_ALIKE * step_mg).max(WANDER_MG);
        // An empty vial that weighs the same would show less by what this one holds.
        let lower_mg = match vial.holds_mg {
            Some(holds_mg) if holds_mg <= step_mg / 2.0 => return None,
            Some(holds_mg) => alike_mg.min(holds_mg / 2.0),
            None => alike_mg,
        };
        Some(Band { lower_mg: shown_mg - lower_mg, upper_mg: shown_mg + alike_mg })
    }

    /// By the zero that is known, and by a zero of the empty pan or, where none is known, of a pan with an empty vial.
    fn empty_bands(&self, lab: Option<EmptyVial>) -> [Option<Band>; 2] {
        match (lab, self.zero_mg) {
            (Some(lab), zero_mg) => [Some(lab.band(zero_mg.unwrap_or(lab.empty_mg))), Some(lab.band(0.0))],
            (None, Some(zero_mg)) => {
                let learned = self.learned();
                [learned.map(|it| it.band(zero_mg)), learned.map(|it| it.band(0.0))]
            }
            (None, None) => [None, None],
        }
    }

    /// What vials weighed that were said to be empty, once there were enough.
    fn learned(&self) -> Option<EmptyVial> {
        if self.empties_mg.len() < EMPTIES_MIN {
            return None;
        }
        let n = self.empties_mg.len() as f64;
        let empty_mg = self.empties_mg.iter().sum::<f64>() / n;
        let squares: f64 = self.empties_mg.iter().map(|mg| (mg - empty_mg).powi(2)).sum();
        Some(EmptyVial { empty_mg, spread_mg: (SPREADS * (squares / (n - 1.0)).sqrt()).max(ALIKE_MG) })
    }

    /// While a dose is made nobody knows what the vial holds; if the process ends, that is what is left.
    #[must_use]
    pub fn begun(&self, weighing: &str, vial: Option<&str>, at: Timestamp) -> Self {
        let vial = Vial { name: vial.map(str::to_owned), weighing: weighing.to_owned(), holds_mg: None, since: at };
        Self { vial: Some(vial), zero_mg: None, shown_mg: None, empties_mg: self.empties_mg.clone() }
    }

    /// After a dose that began with this pan.
    #[must_use]
    pub fn after(&self, dosed: &Dosed) -> Self {
        let tare_mg = dosed.tare_mg;
        let alike_mg = (STEPS_ALIKE * dosed.step_mg).max(WANDER_MG);
        let same = self.vial.as_ref().filter(|_| self.shown_mg.is_some_and(|mg| (mg - tare_mg).abs() <= alike_mg));
        let before_mg = same.map_or(Some(0.0), |vial| vial.holds_mg);
        let vial = Vial {
            name: dosed.vial.clone().or_else(|| same.and_then(|vial| vial.name.clone())),
            weighing: dosed.weighing.clone(),
            holds_mg: before_mg.map(|before_mg| before_mg + dosed.shown_mg),
            since: same.map_or(dosed.at, |vial| vial.since),
        };
        let (zero_mg, mut empties_mg) = self.zero_after(tare_mg);
        if dosed.confirmed {
            empties_mg.push(zero_mg);
        }
        let oldest = empties_mg.len().saturating_sub(EMPTIES_MAX);
        Self {
            vial: Some(vial),
            zero_mg: Some(zero_mg),
            shown_mg: Some(dosed.shown_mg),
            empties_mg: empties_mg.split_off(oldest),
        }
    }

    /// The load that zero stands for from now on, and the empty vials that can be compared with it.
    fn zero_after(&self, tare_mg: f64) -> (f64, Vec<f64>) {
        let learned = self.learned();
        match self.zero_mg {
            Some(zero_mg) if learned.is_none_or(|it| it.holds(zero_mg + tare_mg) || !it.holds(tare_mg)) => {
                (zero_mg + tare_mg, self.empties_mg.clone())
            }
            // Somebody set the empty pan to zero, as it was in the beginning.
            _ if learned.is_some_and(|it| it.holds(tare_mg)) => (tare_mg, self.empties_mg.clone()),
            // Another origin: nothing from before can be compared with it.
            _ => (tare_mg, Vec::new()),
        }
    }

    /// A person has emptied or exchanged the vial; the display counts on from where it did.
    #[must_use]
    pub fn emptied(&self) -> Self {
        Self { vial: None, shown_mg: None, ..self.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AT: i64 = 1_795_248_000_000;

    fn dosed(tare_mg: f64, shown_mg: f64, vial: &str) -> Dosed {
        Dosed {
            weighing: format!("w-{vial}"),
            vial: Some(vial.to_owned()),
            at: Timestamp::from_unix_ms(AT),
            tare_mg,
            shown_mg,
            confirmed: true,
            step_mg: 1.0,
        }
    }

    /// What a display shows whose zero stands for the vial of the dose before.
    fn after(doses: &[(f64, f64)]) -> Pan {
        doses.iter().fold(Pan::default(), |pan, (tare_mg, shown_mg)| pan.after(&dosed(*tare_mg, *shown_mg, "A")))
    }

    #[test]
    fn the_vial_of_the_dose_before_is_known_by_what_it_holds_and_any_other_passes() {
        let check = after(&[(11_999.0, 8.0)]).check(1.0, None);
        for shown_mg in [6.0, 8.0, 9.0, 11.0] {
            assert_eq!(check.flaw(shown_mg), Some(VialFlaw::SameAsBefore { shown_mg }), "{shown_mg}");
        }
        // An empty vial of the same mass, lighter and heavier ones.
        for shown_mg in [0.0, -60.0, 130.0, 3.0] {
            assert_eq!(check.flaw(shown_mg), None, "{shown_mg}");
        }
    }

    #[test]
    fn two_doses_in_one_vial_are_still_that_vial_and_a_dose_of_nothing_leaves_it_empty() {
        let pan = after(&[(11_999.0, 8.0), (8.0, 3.0)]);
        assert_eq!(pan.vial.as_ref().unwrap().holds_mg, Some(11.0));
        assert!(pan.check(1.0, None).flaw(3.0).is_some() && pan.check(1.0, None).flaw(-8.0).is_none());
        assert_eq!(after(&[(11_999.0, 0.0)]).check(1.0, None).flaw(0.0), None);
        // A small dose beside an empty vial that weighs the same.
        let small = after(&[(11_999.0, 2.0)]).check(1.0, None);
        assert!(small.flaw(0.0).is_none() && small.flaw(2.0).is_some() && small.flaw(1.0).is_some());
    }

    #[test]
    fn a_vial_that_was_filled_some_doses_ago_is_not_empty_where_the_lab_says_what_one_weighs() {
        let lab = EmptyVial { empty_mg: 12_000.0, spread_mg: 15.0 };
        let pan = after(&[(11_999.0, 20.0), (1.0, 9.0)]);
        assert_eq!(pan.zero_mg, Some(12_000.0));
        let check = pan.check(1.0, Some(lab));
        // The first vial again, with its 20 mg; then an empty one, nothing, and a balance whose empty pan was set to zero.
        assert_eq!(check.flaw(19.0), Some(VialFlaw::NotEmpty { over_mg: 4.0 }));
        assert_eq!(check.flaw(-5.0), None);
        assert!(matches!(check.flaw(-12_000.0), Some(VialFlaw::TooLight { .. })));
        assert_eq!(check.flaw(12_003.0), None);
        // Nothing is known of zero: it stands for the empty pan, or for one with an empty vial.
        let first = Pan::default().check(1.0, Some(lab));
        assert!(first.flaw(11_990.0).is_none() && first.flaw(3.0).is_none());
        assert!(first.flaw(12_040.0).is_some() && first.flaw(40.0).is_some() && first.flaw(6000.0).is_some());
    }

    #[test]
    fn what_an_empty_vial_weighs_is_learned_from_five_that_somebody_called_empty() {
        // 12000, 11990, 12005, 11998, 12003 mg: mean 11999.2, SD 5.8.
        let four = [(12_000.0, 18.0), (-10.0, 18.0), (15.0, 18.0), (-7.0, 18.0)];
        assert_eq!(after(&four).check(1.0, None).empty, [None, None]);
        let pan = after(&[&four[..], &[(5.0, 18.0)]].concat());
        let check = pan.check(1.0, None);
        assert_eq!(check.flaw(20.0), Some(VialFlaw::SameAsBefore { shown_mg: 20.0 }));
        assert!(check.flaw(25.0).is_none() && check.flaw(-30.0).is_none(), "{check:?}");
        assert!(matches!(check.flaw(45.0), Some(VialFlaw::NotEmpty { .. })), "{check:?}");
        // After a crash nobody knows what zero stands for: only the pan that was set to zero without a vial can be compared.
        let lost = pan.begun("w", None, Timestamp::from_unix_ms(AT));
        assert_eq!(lost.check(1.0, None), PanCheck::NONE);
        assert_eq!(lost.after(&dosed(12_001.0, 5.0, "B")).empties_mg.len(), 6);
        assert_eq!(lost.after(&dosed(33.0, 5.0, "B")).empties_mg, [33.0]);
    }

    #[test]
    fn after_a_person_has_emptied_the_pan_the_balance_counts_on() {
        let pan = after(&[(11_999.0, 8.0)]);
        let emptied = pan.emptied();
        assert_eq!((emptied.vial.as_ref(), emptied.zero_mg), (None, Some(11_999.0)));
        assert_eq!(emptied.check(1.0, None).flaw(8.0), None);
    }
}
