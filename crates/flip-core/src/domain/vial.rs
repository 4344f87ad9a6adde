//! The vial on the pan of a bench that cannot exchange vials: what is known about it, and which
//! displays rule out that a new, empty one is in place.
//!
//! Each dose tares the balance. Before the next dose the display therefore shows the poured mass if
//! the vial has not been exchanged, and the difference between two empty vials if it has. Summing
//! the displays yields the mass of every vial from one origin, as long as nobody else tares the
//! balance.

use super::timestamp::Timestamp;
use super::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// Displays within this many steps may be of the same load.
const STEPS_ALIKE: f64 = 3.0;
/// Wander of a balance's zero between two doses, mg, however fine its display.
const WANDER_MG: f64 = 2.0;
/// Number of empty vials that must have been seen before others are compared with them.
const EMPTIES_MIN: usize = 5;
/// Number of empty vials remembered.
const EMPTIES_MAX: usize = 20;
/// An empty vial lies within this many standard deviations of the mean of five.
const SPREADS: f64 = 6.0;
/// It must also lie within this distance of the mean, mg, however alike the five were.
const ALIKE_MG: f64 = 5.0;

/// Whether a person must confirm that the vial is in place before a dose starts, on a bench that
/// cannot exchange vials.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VialCheck {
    /// A person confirms, and the balance checks that the vial is a new one and empty.
    #[default]
    Confirm,
    /// No confirmation and no check: FLIP doses into whatever is on the pan.
    Skip,
}

impl VialCheck {
    /// Whether this is the default.
    pub fn is_confirm(&self) -> bool {
        *self == Self::Confirm
    }
}

/// Mass of a lab's empty vials.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EmptyVial {
    /// Mean mass, mg.
    pub empty_mg: f64,
    /// Largest deviation of a single vial from the mean, mg.
    pub spread_mg: f64,
}

impl EmptyVial {
    /// Validates the values.
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

    /// Displays that an empty vial can give if zero stands for this load, mg.
    fn band(&self, zero_mg: f64) -> Band {
        let middle_mg = self.empty_mg - zero_mg;
        Band { lower_mg: middle_mg - self.spread_mg, upper_mg: middle_mg + self.spread_mg }
    }
}

/// The vial on the pan, as far as is known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Vial {
    /// Its name, if one was given.
    pub name: Option<String>,
    /// The weighing that last poured into the vial.
    pub weighing: String,
    /// Mass poured into it according to the display, mg; absent if unknown.
    pub holds_mg: Option<f64>,
    /// Start of the first dose into it.
    pub since: Timestamp,
}

/// What is known about the pan.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Pan {
    /// The vial on the pan; none if nothing is known, or a person has emptied or exchanged it.
    pub vial: Option<Vial>,
    /// The load that the display's zero stands for, mg from a fixed origin; none if unknown.
    pub zero_mg: Option<f64>,
    /// The display at the end of the last dose, mg.
    pub shown_mg: Option<f64>,
    /// Masses of vials that had been declared empty, mg from the same origin, newest last.
    #[serde(default)]
    pub empties_mg: Vec<f64>,
}

/// The effect of a dose on the pan.
#[derive(Debug, Clone, PartialEq)]
pub struct Dosed {
    /// The weighing.
    pub weighing: String,
    /// Name of the vial used, if it has one.
    pub vial: Option<String>,
    /// Start of the dose.
    pub at: Timestamp,
    /// Display when the balance was tared, mg.
    pub tare_mg: f64,
    /// Display at the end, mg.
    pub shown_mg: f64,
    /// Whether the vial was declared empty and the balance did not contradict it.
    pub confirmed: bool,
    /// Display step, mg.
    pub step_mg: f64,
}

/// A range of displays, mg.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Band {
    /// Lower end.
    pub lower_mg: f64,
    /// Upper end.
    pub upper_mg: f64,
}

impl Band {
    fn holds(&self, shown_mg: f64) -> bool {
        (self.lower_mg..=self.upper_mg).contains(&shown_mg)
    }
}

/// Conditions on the display before anything moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PanCheck {
    /// Displays of the vial from the previous dose, which holds powder.
    pub before: Option<Band>,
    /// Displays of an empty vial of this lab, for each of the loads that zero may stand for.
    pub empty: [Option<Band>; 2],
}

/// Why the vial on the pan is rejected.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum VialFlaw {
    /// It is the vial from the previous dose.
    #[error(
        "the balance shows {shown_mg:.1} mg, as at the end of the dose before: the vial that was poured into is still on the pan"
    )]
    SameAsBefore {
        /// Display before anything moved, mg.
        shown_mg: f64,
    },
    /// It is heavier than an empty one.
    #[error(
        "what is on the pan weighs {over_mg:.1} mg more than the heaviest empty vial of this lab: it is not empty, or of another kind"
    )]
    NotEmpty {
        /// Excess, mg.
        over_mg: f64,
    },
    /// It is lighter than an empty one.
    #[error(
        "what is on the pan weighs {under_mg:.1} mg less than the lightest empty vial of this lab: is a vial on it?"
    )]
    TooLight {
        /// Shortfall, mg.
        under_mg: f64,
    },
}

impl PanCheck {
    /// Accepts any display.
    pub const NONE: Self = Self { before: None, empty: [None, None] };

    /// The flaw that this display reveals, if any; display in mg.
    pub fn flaw(&self, shown_mg: f64) -> Option<VialFlaw> {
        if self.before.is_some_and(|band| band.holds(shown_mg)) {
            return Some(VialFlaw::SameAsBefore { shown_mg });
        }
        let bands = || self.empty.iter().flatten();
        if bands().next().is_none() || bands().any(|band| band.holds(shown_mg)) {
            return None;
        }
        let over_mg = bands()
            .map(|band| shown_mg - band.upper_mg)
            .filter(|mg| *mg > 0.0)
            .fold(f64::INFINITY, f64::min);
        let under_mg = bands()
            .map(|band| band.lower_mg - shown_mg)
            .filter(|mg| *mg > 0.0)
            .fold(f64::INFINITY, f64::min);
        Some(if over_mg <= under_mg {
            VialFlaw::NotEmpty { over_mg }
        } else {
            VialFlaw::TooLight { under_mg }
        })
    }
}

impl Pan {
    /// The check to make before a dose into a vial that a person has declared in place and empty.
    pub fn check(&self, step_mg: f64, lab: Option<EmptyVial>) -> PanCheck {
        PanCheck { before: self.filled_band(step_mg), empty: self.empty_bands(lab) }
    }

    fn filled_band(&self, step_mg: f64) -> Option<Band> {
        let (vial, shown_mg) = (self.vial.as_ref()?, self.shown_mg?);
        let alike_mg = (STEPS_ALIKE * step_mg).max(WANDER_MG);
        // An empty vial of equal mass would show less, by the powder in this one.
        let lower_mg = match vial.holds_mg {
            Some(holds_mg) if holds_mg <= step_mg / 2.0 => return None,
            Some(holds_mg) => alike_mg.min(holds_mg / 2.0),
            None => alike_mg,
        };
        Some(Band { lower_mg: shown_mg - lower_mg, upper_mg: shown_mg + alike_mg })
    }

    /// Bands for the known zero, and for a zero set on the empty pan or, if no zero is known, on a
    /// pan with an empty vial.
    fn empty_bands(&self, lab: Option<EmptyVial>) -> [Option<Band>; 2] {
        match (lab, self.zero_mg) {
            (Some(lab), zero_mg) => {
                [Some(lab.band(zero_mg.unwrap_or(lab.empty_mg))), Some(lab.band(0.0))]
            }
            (None, Some(zero_mg)) => {
                let learned = self.learned();
                [learned.map(|it| it.band(zero_mg)), learned.map(|it| it.band(0.0))]
            }
            (None, None) => [None, None],
        }
    }

    /// Mass of the vials declared empty, once there are enough of them.
    fn learned(&self) -> Option<EmptyVial> {
        if self.empties_mg.len() < EMPTIES_MIN {
            return None;
        }
        let n = self.empties_mg.len() as f64;
        let empty_mg = self.empties_mg.iter().sum::<f64>() / n;
        let squares: f64 = self.empties_mg.iter().map(|mg| (mg - empty_mg).powi(2)).sum();
        Some(EmptyVial {
            empty_mg,
            spread_mg: (SPREADS * (squares / (n - 1.0)).sqrt()).max(ALIKE_MG),
        })
    }

    /// The state during a dose: the vial's content is unknown; this is what remains if the process
    /// ends.
    #[must_use]
    pub fn begun(&self, weighing: &str, vial: Option<&str>, at: Timestamp) -> Self {
        let vial = Vial {
            name: vial.map(str::to_owned),
            weighing: weighing.to_owned(),
            holds_mg: None,
            since: at,
        };
        Self {
            vial: Some(vial),
            zero_mg: None,
            shown_mg: None,
            empties_mg: self.empties_mg.clone(),
        }
    }

    /// The state after a dose that began with this pan.
    #[must_use]
    pub fn after(&self, dosed: &Dosed) -> Self {
        let tare_mg = dosed.tare_mg;
        let same = self.vial.as_ref().filter(|_| self.is_where_it_was(tare_mg, dosed.step_mg));
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

    /// The load that zero stands for from now on, and the empty vials comparable with it.
    fn zero_after(&self, tare_mg: f64) -> (f64, Vec<f64>) {
        let learned = self.learned();
        match self.zero_mg {
            Some(zero_mg)
                if learned.is_none_or(|it| it.holds(zero_mg + tare_mg) || !it.holds(tare_mg)) =>
            {
                (zero_mg + tare_mg, self.empties_mg.clone())
            }
            // The empty pan was tared, as at the beginning.
            _ if learned.is_some_and(|it| it.holds(tare_mg)) => (tare_mg, self.empties_mg.clone()),
            // A new origin: earlier vials cannot be compared with it.
            _ => (tare_mg, Vec::new()),
        }
    }

    /// The state after the balance was tared or zeroed between doses, where it showed this before,
    /// mg. The vial stays what it is if that is where it was left.
    #[must_use]
    pub fn zeroed(&self, before_mg: f64, readability_mg: Option<f64>) -> Self {
        let step_mg = readability_mg.unwrap_or_default();
        let same = self.is_where_it_was(before_mg, step_mg);
        let (zero_mg, empties_mg) = self.zero_after(before_mg);
        Self {
            vial: self.vial.clone().filter(|_| same),
            zero_mg: Some(zero_mg),
            shown_mg: same.then_some(0.0),
            empties_mg,
        }
    }

    /// Whether the display is where the last dose left it.
    fn is_where_it_was(&self, shown_mg: f64, step_mg: f64) -> bool {
        let alike_mg = (STEPS_ALIKE * step_mg).max(WANDER_MG);
        self.shown_mg.is_some_and(|mg| (mg - shown_mg).abs() <= alike_mg)
    }

    /// The state after a person has emptied or exchanged the vial; the display continues from where
    /// it was.
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

    /// A pan after these doses, its display zeroed on the vial of the previous one.
    fn after(doses: &[(f64, f64)]) -> Pan {
        doses.iter().fold(Pan::default(), |pan, (tare_mg, shown_mg)| {
            pan.after(&dosed(*tare_mg, *shown_mg, "A"))
        })
    }

    #[test]
    fn the_vial_of_the_dose_before_is_known_by_what_it_holds_and_any_other_passes() {
        let check = after(&[(11_999.0, 8.0)]).check(1.0, None);
        for shown_mg in [6.0, 8.0, 9.0, 11.0] {
            assert_eq!(
                check.flaw(shown_mg),
                Some(VialFlaw::SameAsBefore { shown_mg }),
                "{shown_mg}"
            );
        }
        // Empty vials of equal mass, lighter and heavier.
        for shown_mg in [0.0, -60.0, 130.0, 3.0] {
            assert_eq!(check.flaw(shown_mg), None, "{shown_mg}");
        }
    }

    #[test]
    fn two_doses_in_one_vial_are_still_that_vial_and_a_dose_of_nothing_leaves_it_empty() {
        let pan = after(&[(11_999.0, 8.0), (8.0, 3.0)]);
        assert_eq!(pan.vial.as_ref().unwrap().holds_mg, Some(11.0));
        assert!(
            pan.check(1.0, None).flaw(3.0).is_some() && pan.check(1.0, None).flaw(-8.0).is_none()
        );
        assert_eq!(after(&[(11_999.0, 0.0)]).check(1.0, None).flaw(0.0), None);
        // A small dose against an empty vial of equal mass.
        let small = after(&[(11_999.0, 2.0)]).check(1.0, None);
        assert!(
            small.flaw(0.0).is_none() && small.flaw(2.0).is_some() && small.flaw(1.0).is_some()
        );
    }

    #[test]
    fn a_vial_that_was_filled_some_doses_ago_is_not_empty_where_the_lab_says_what_one_weighs() {
        let lab = EmptyVial { empty_mg: 12_000.0, spread_mg: 15.0 };
        let pan = after(&[(11_999.0, 20.0), (1.0, 9.0)]);
        assert_eq!(pan.zero_mg, Some(12_000.0));
        let check = pan.check(1.0, Some(lab));
        // The first vial again, with its 20 mg; then an empty one, nothing, and a balance zeroed on
        // its empty pan.
        assert_eq!(check.flaw(19.0), Some(VialFlaw::NotEmpty { over_mg: 4.0 }));
        assert_eq!(check.flaw(-5.0), None);
        assert!(matches!(check.flaw(-12_000.0), Some(VialFlaw::TooLight { .. })));
        assert_eq!(check.flaw(12_003.0), None);
        // Nothing is known about zero: it stands for the empty pan, or for a pan with an empty
        // vial.
        let first = Pan::default().check(1.0, Some(lab));
        assert!(first.flaw(11_990.0).is_none() && first.flaw(3.0).is_none());
        assert!(
            first.flaw(12_040.0).is_some()
                && first.flaw(40.0).is_some()
                && first.flaw(6000.0).is_some()
        );
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
        // After a crash the meaning of zero is unknown: only a pan zeroed without a vial can be
        // compared.
        let lost = pan.begun("w", None, Timestamp::from_unix_ms(AT));
        assert_eq!(lost.check(1.0, None), PanCheck::NONE);
        assert_eq!(lost.after(&dosed(12_001.0, 5.0, "B")).empties_mg.len(), 6);
        assert_eq!(lost.after(&dosed(33.0, 5.0, "B")).empties_mg, [33.0]);
    }

    #[test]
    fn a_vial_tared_between_doses_stays_that_vial_and_another_one_does_not() {
        let lab = EmptyVial { empty_mg: 12_000.0, spread_mg: 15.0 };
        let pan = after(&[(11_999.0, 8.0)]);
        let same = pan.zeroed(9.0, Some(1.0));
        assert_eq!((same.shown_mg, same.zero_mg), (Some(0.0), Some(12_008.0)));
        assert_eq!(same.vial, pan.vial);
        let check = same.check(1.0, Some(lab));
        assert_eq!(check.flaw(1.0), Some(VialFlaw::SameAsBefore { shown_mg: 1.0 }));
        assert_eq!(check.flaw(-12.0), None, "an empty vial");
        // What is tared is twice tared, and the vial is known by the same display.
        assert_eq!(same.zeroed(0.0, Some(1.0)).check(1.0, None), same.check(1.0, None));
        // The vial was taken away, the empty pan was zeroed, and an empty vial was put on.
        let bare = pan.zeroed(-11_999.0, None);
        assert_eq!((&bare.vial, bare.shown_mg, bare.zero_mg), (&None, None, Some(0.0)));
        assert_eq!(bare.check(1.0, Some(lab)).flaw(12_003.0), None);
        let heavier = bare.check(1.0, Some(lab)).flaw(12_020.0);
        assert_eq!(heavier, Some(VialFlaw::NotEmpty { over_mg: 5.0 }));
    }

    #[test]
    fn after_a_person_has_emptied_the_pan_the_balance_counts_on() {
        let pan = after(&[(11_999.0, 8.0)]);
        let emptied = pan.emptied();
        assert_eq!((emptied.vial.as_ref(), emptied.zero_mg), (None, Some(11_999.0)));
        assert_eq!(emptied.check(1.0, None).flaw(8.0), None);
    }
}
