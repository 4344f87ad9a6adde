//! A mechanism hidden in the powder of an emulated laboratory, for whoever has to find it.
//!
//! | mechanism | what it does | form |
//! |---|---|---|
//! | `attraction` | grains attract each other, less friction keeps the heap | simulator's |
//! | `humidity` | water bridges between grains, less friction keeps the heap | simulator's |
//! | `consolidation` | contacts grow stronger with age, less friction keeps the heap | simulator's |
//! | `rolling` | grains turn, and resist turning | simulator's |
//! | `size_spread` | grains differ in size | simulator's |
//! | `spoon_adhesion`, `charge`, `spoon_friction` | grains stick to the spoon, are drawn to it by charge, rub on it | simulator's |
//! | `hold_up` | a share of what would fall stays in the spoon | `1 - a` |
//! | `weak_strokes` | play: every stroke is shorter than reported | `A - b`, not below zero |
//! | `under_filling` | the spoon holds less than a full one | fewer grains |
//! | `drift` | powder sticks more the longer ago the spoon was filled | `1 - a (1 - exp(-n / 6))`, n steps |
//! | `packing` | strokes pack the powder | `1 - a (1 - exp(-s / 60))`, s mm of strokes |
//!
//! What has a form of its own is no code of the simulator: it acts on what the simulated spoon lets
//! fall. What it keeps back stays in the spoon until that is emptied.
//!
//! The size is drawn log-uniformly between the one that changes a full course by some 30 % and
//! three times that, where there is as much: `humidity`, `rolling`, `size_spread`, `attraction` at
//! an unchanged angle and `weak_strokes` change less at their smallest. How far what falls is
//! changed `make discovery-report ONLY=spoon` prints for every mechanism.

use super::arm::{GrainsSpoon, Pour, Spoon};
use flip_core::domain::bench::Action;
use flip_core::domain::conditions::Patch;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_sim::dispense::Settings;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::collections::BTreeMap;

/// What may be hidden.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Mechanism {
    /// Grains attract each other.
    Attraction,
    /// Water bridges grains.
    Humidity,
    /// Contacts grow stronger with their age.
    Consolidation,
    /// Grains turn, and resist turning.
    Rolling,
    /// Grains differ in size.
    SizeSpread,
    /// Grains stick to the spoon.
    SpoonAdhesion,
    /// Charged grains are attracted by the spoon.
    Charge,
    /// The spoon is rough.
    SpoonFriction,
    /// A share of what would fall stays in the spoon.
    HoldUp,
    /// Strokes are shorter than reported.
    WeakStrokes,
    /// The spoon holds less than a full one.
    UnderFilling,
    /// Powder sticks more with time since filling.
    Drift,
    /// Strokes pack the powder.
    Packing,
}

/// Steps after which 63 % of a drift have come.
const DRIFT_STEPS: f64 = 6.0;
/// Strokes after which 63 % of a packing have come, mm.
const PACKING_MM: f64 = 60.0;
/// From the smallest to the largest size.
const SPAN: f64 = 3.0;

impl Mechanism {
    /// Every mechanism.
    pub const ALL: [Self; 13] = [
        Self::Attraction,
        Self::Humidity,
        Self::Consolidation,
        Self::Rolling,
        Self::SizeSpread,
        Self::SpoonAdhesion,
        Self::Charge,
        Self::SpoonFriction,
        Self::HoldUp,
        Self::WeakStrokes,
        Self::UnderFilling,
        Self::Drift,
        Self::Packing,
    ];

    /// Name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Attraction => "attraction",
            Self::Humidity => "humidity",
            Self::Consolidation => "consolidation",
            Self::Rolling => "rolling",
            Self::SizeSpread => "size_spread",
            Self::SpoonAdhesion => "spoon_adhesion",
            Self::Charge => "charge",
            Self::SpoonFriction => "spoon_friction",
            Self::HoldUp => "hold_up",
            Self::WeakStrokes => "weak_strokes",
            Self::UnderFilling => "under_filling",
            Self::Drift => "drift",
            Self::Packing => "packing",
        }
    }

    /// Smallest size, in the unit of its form, and the largest that it can have.
    fn sizes(self) -> [f64; 2] {
        match self {
            Self::Attraction => [0.4, 1.2],
            Self::Humidity | Self::Rolling => [1.0 / SPAN, 1.0],
            Self::Consolidation => [2.3, 6.9],
            Self::SizeSpread => [0.1, 0.3],
            Self::SpoonAdhesion => [1.0, 3.0],
            Self::Charge => [0.9, 2.7],
            Self::SpoonFriction => [0.15, 0.45],
            Self::HoldUp => [0.3, 0.9],
            Self::UnderFilling => [0.22, 0.66],
            Self::WeakStrokes => [1.5, 4.5],
            Self::Drift | Self::Packing => [0.6, 1.0],
        }
    }

    /// Change of the coefficient of friction by a unit of it, which keeps the default powder's heap
    /// about as steep.
    fn friction(self) -> f64 {
        match self {
            Self::Attraction => -0.5,
            Self::Humidity => -0.8,
            Self::Consolidation => -0.1,
            _ => 0.0,
        }
    }
}

/// A mechanism and its size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hidden {
    /// Which.
    pub mechanism: Mechanism,
    /// How strong, in the unit of its form.
    pub size: f64,
}

/// Seed indices.
const WHICH: u64 = 0x41DD;
const SIZE: u64 = 0x51FE;

impl Hidden {
    /// The mechanism hidden by a seed; 0 hides none.
    pub fn drawn(seed: u64) -> Option<Self> {
        let which = derive(seed, &[WHICH]) % Mechanism::ALL.len() as u64;
        (seed != 0).then(|| Self::of(Mechanism::ALL[which as usize], seed))
    }

    /// This mechanism with the size that a seed draws.
    pub fn of(mechanism: Mechanism, seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(derive(seed, &[SIZE]));
        let [smallest, largest] = mechanism.sizes();
        let size = smallest * libm::pow(SPAN, rng.random::<f64>());
        Self { mechanism, size: size.min(largest) }
    }

    /// What it changes in the grains, wherever they lie: in a spoon as in a heap. Empty where it
    /// belongs to the spoon or its motion, or has a form of its own.
    pub fn grains(&self) -> Patch {
        let named = |pairs: &[(&str, f64)]| -> BTreeMap<String, f64> {
            pairs.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect()
        };
        let size = self.size;
        let amplitudes = match self.mechanism {
            Mechanism::Rolling => named(&[("rotation", 1.0), ("rolling_friction", size)]),
            Mechanism::Humidity
            | Mechanism::Consolidation
            | Mechanism::SizeSpread
            | Mechanism::SpoonAdhesion
            | Mechanism::Charge => named(&[(self.mechanism.name(), size)]),
            _ => BTreeMap::new(),
        };
        let less = self.mechanism.friction() * size;
        let mut parameters = BTreeMap::new();
        if less != 0.0 {
            parameters.insert("friction".to_owned(), less);
        }
        if self.mechanism == Mechanism::Attraction {
            parameters.insert("cohesion".to_owned(), size);
        }
        Patch { parameters, amplitudes, ..Patch::default() }
    }

    /// The spoon's settings with it.
    pub fn spoon(&self, usual: &Settings) -> Settings {
        let mut settings = *usual;
        match self.mechanism {
            Mechanism::SpoonFriction => settings.friction += self.size,
            Mechanism::UnderFilling => {
                let grains = f64::from(usual.particles) * (1.0 - self.size);
                settings.particles = (grains.round() as u32).max(1);
            }
            _ => {
                let extended = usual.extensions.patched(&self.grains());
                settings.extensions = extended.unwrap_or(usual.extensions);
            }
        }
        settings
    }

    /// Share of what would fall that stays, after so many steps and so many mm of strokes.
    fn stays(&self, steps: f64, stroked_mm: f64) -> f64 {
        match self.mechanism {
            Mechanism::HoldUp => self.size,
            Mechanism::Drift => self.size * (1.0 - libm::exp(-steps / DRIFT_STEPS)),
            Mechanism::Packing => self.size * (1.0 - libm::exp(-stroked_mm / PACKING_MM)),
            _ => 0.0,
        }
    }

    /// The stroke that the spoon makes when this one is reported, mm.
    fn stroke(&self, reported_mm: f64) -> f64 {
        let play = if self.mechanism == Mechanism::WeakStrokes { self.size } else { 0.0 };
        (reported_mm - play).max(0.0)
    }
}

/// A spoon of simulated grains in which a mechanism may be hidden; without one it is a
/// [`GrainsSpoon`] to the last bit.
pub fn spoon(
    hidden: Option<Hidden>,
    set: &ParameterSet,
    settings: &Settings,
    seed: u64,
) -> Box<dyn Spoon> {
    match hidden {
        None => Box::new(GrainsSpoon::new(set, settings, seed)),
        Some(hidden) => {
            let set = hidden.grains().powder(set);
            let grains = GrainsSpoon::new(&set, &hidden.spoon(settings), seed);
            Box::new(HiddenSpoon { grains, hidden, steps: 0.0, stroked_mm: 0.0, kept_mg: 0.0 })
        }
    }
}

/// A spoon with something hidden in it.
struct HiddenSpoon {
    grains: GrainsSpoon,
    hidden: Hidden,
    /// Steps since it was filled.
    steps: f64,
    /// Strokes since then, mm.
    stroked_mm: f64,
    /// Powder that was kept from falling, mg.
    kept_mg: f64,
}

impl HiddenSpoon {
    fn forget(&mut self) {
        (self.steps, self.stroked_mm, self.kept_mg) = (0.0, 0.0, 0.0);
    }
}

impl Spoon for HiddenSpoon {
    fn step(&mut self, action: Action) -> Pour {
        let shake_mm = self.hidden.stroke(action.shake_mm);
        let mass_mg = self.grains.step(Action { shake_mm, ..action }).mass_mg;
        let stays_mg = mass_mg * self.hidden.stays(self.steps, self.stroked_mm);
        self.steps += 1.0;
        self.stroked_mm += shake_mm * f64::from(action.strokes);
        self.kept_mg += stays_mg;
        Pour { mass_mg: mass_mg - stays_mg }
    }

    fn keep(&mut self, mass_mg: f64) {
        self.grains.keep(mass_mg);
    }

    fn refill(&mut self) {
        self.forget();
        self.grains.refill();
    }

    fn empty(&mut self) {
        self.forget();
        self.grains.empty();
    }

    fn pitch_deg(&self) -> f64 {
        self.grains.pitch_deg()
    }

    fn held_mg(&self) -> f64 {
        self.grains.held_mg() + self.kept_mg
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_core::domain::bench::PitchLimits;

    /// 500 grains in a spoon that they fill as 2500 fill the usual one.
    fn small() -> Settings {
        let usual = Settings::default();
        let semi_axes_mm = usual.semi_axes_mm.map(|mm| mm * libm::cbrt(500.0 / 2500.0));
        Settings { particles: 500, semi_axes_mm, pitch: PitchLimits::OPEN, ..usual }
    }

    /// What has fallen after each step of a full course, 20 to 60 deg with two strokes at each
    /// pitch, as a mean over seeds, and what was filled, mg.
    fn course(hidden: Option<Hidden>, stroke_mm: f64) -> (Vec<f64>, f64) {
        let set = ParameterSet::default().with("friction", 0.9).unwrap();
        let (mut all, mut filled) = (vec![0.0; 12], 0.0);
        for seed in 0..SEEDS {
            let mut spoon = spoon(hidden, &set, &small(), seed);
            spoon.refill();
            filled += spoon.held_mg() / SEEDS as f64;
            let mut fallen = 0.0;
            for (step, sum) in all.iter_mut().enumerate() {
                let pitch = 20.0 + 8.0 * (step / 2) as f64;
                fallen += spoon.step(Action::once(pitch - spoon.pitch_deg(), stroke_mm)).mass_mg;
                *sum += fallen / SEEDS as f64;
            }
        }
        (all, filled)
    }

    const SEEDS: u64 = 3;

    /// Mean difference of what has fallen, over all steps, over the mean of what falls usually.
    fn changed(usual: &[f64], with: &[f64]) -> f64 {
        with.iter().sum::<f64>() / usual.iter().sum::<f64>() - 1.0
    }

    #[test]
    fn a_seed_hides_one_mechanism_and_zero_none_and_all_are_drawn() {
        assert_eq!((Hidden::drawn(0), Hidden::drawn(7)), (None, Hidden::drawn(7)));
        for mechanism in Mechanism::ALL {
            let of: Vec<Hidden> = (1..200).filter_map(Hidden::drawn).collect();
            assert!(of.iter().any(|it| it.mechanism == mechanism), "{mechanism:?}");
            let [low, high] = mechanism.sizes();
            let sizes: Vec<f64> = (1..200).map(|seed| Hidden::of(mechanism, seed).size).collect();
            assert!(sizes.iter().all(|size| (low..=high).contains(size)), "{mechanism:?}");
            assert!(sizes.iter().any(|size| *size > 0.8 * high), "{mechanism:?}");
            // The simulator takes the largest.
            let largest = Hidden { mechanism, size: high };
            let extended = Settings::default().extensions.patched(&largest.grains()).unwrap();
            let asked = largest.grains().amplitudes;
            let mut given = extended;
            let given = given.amplitudes();
            for (name, value) in asked {
                let got = given.iter().find(|it| it.0 == name).unwrap();
                assert_eq!(*got.1, value, "{name}");
            }
        }
    }

    #[test]
    fn without_a_mechanism_it_is_the_usual_spoon_and_with_one_the_same_again() {
        let set = ParameterSet::default();
        let mut usual = GrainsSpoon::new(&set, &small(), 3);
        let mut none = spoon(None, &set, &small(), 3);
        usual.refill();
        none.refill();
        for _ in 0..4 {
            let action = Action::once(8.0, 6.0);
            assert_eq!(usual.step(action), none.step(action));
        }
        assert_eq!(usual.held_mg(), none.held_mg());
        let hidden = Hidden::drawn(5);
        assert_eq!(course(hidden, 8.0), course(hidden, 8.0));
        assert_ne!(course(hidden, 8.0), course(None, 8.0));
    }

    #[test]
    fn every_mechanism_changes_what_falls_as_its_name_says() {
        let (usual, filled) = course(None, 4.0);
        for mechanism in Mechanism::ALL {
            let [.., size] = mechanism.sizes();
            let (with, held) = course(Some(Hidden { mechanism, size }), 4.0);
            let change = changed(&usual, &with);
            println!("{mechanism:?} {size}: {change:+.2}");
            // Grains that turn flow. Of attraction and friction that make the same angle, friction
            // holds back more in a spoon.
            let is_more = matches!(mechanism, Mechanism::Rolling | Mechanism::Attraction);
            assert_eq!(change > 0.0, is_more, "{mechanism:?}: {change}");
            let is_less = mechanism == Mechanism::UnderFilling;
            assert_eq!(held < 0.5 * filled, is_less, "{mechanism:?} {held} {filled}");
        }
    }

    #[test]
    fn what_is_kept_back_stays_in_the_spoon_until_it_is_emptied() {
        let hidden = Hidden { mechanism: Mechanism::HoldUp, size: 0.5 };
        let set = ParameterSet::default();
        let (mut usual, mut held) =
            (spoon(None, &set, &small(), 1), spoon(Some(hidden), &set, &small(), 1));
        usual.refill();
        held.refill();
        let filled = held.held_mg();
        let fall = |spoon: &mut Box<dyn Spoon>| -> f64 {
            (0..6).map(|_| spoon.step(Action::once(8.0, 8.0)).mass_mg).sum()
        };
        let (all, half) = (fall(&mut usual), fall(&mut held));
        assert!(all > 1.0 && (half - all / 2.0).abs() < 1e-9, "{all} {half}");
        assert!((held.held_mg() - usual.held_mg() - all / 2.0).abs() < 1e-9);
        held.empty();
        held.refill();
        assert!(held.held_mg() > 0.9 * filled && held.held_mg() < 1.1 * filled);
    }

    #[test]
    fn strokes_are_shortened_by_the_play_and_drift_and_packing_grow() {
        let of = |mechanism, size| Hidden { mechanism, size };
        let play = of(Mechanism::WeakStrokes, 2.0);
        assert_eq!([play.stroke(8.0), play.stroke(1.5)], [6.0, 0.0]);
        assert_eq!(of(Mechanism::HoldUp, 0.5).stroke(8.0), 8.0);
        let drift = of(Mechanism::Drift, 1.0);
        assert!(drift.stays(0.0, 9.0) == 0.0 && drift.stays(12.0, 0.0) > 0.8);
        let packing = of(Mechanism::Packing, 1.0);
        assert!(packing.stays(9.0, 0.0) == 0.0 && packing.stays(0.0, 120.0) > 0.8);
    }
}
