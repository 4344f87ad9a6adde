//! What is drawn for an episode before it is played: powder, conditions, target, heap.

use super::environment::Filling;
#[cfg(feature = "libtorch")]
use super::environment::Simulated;
use super::record::Level;
use super::settings::{Extended, Order, Settings};
use super::spoons::Spoons;
use super::surrogate::{Surrogate, SurrogateSpoon};
use flip_core::domain::FieldError;
use flip_core::domain::conditions::Patch;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
#[cfg(feature = "libtorch")]
use flip_sim::dispense::Dispenser;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Identifiers of the random streams: the first index after the training's seed.
pub(super) mod stream {
    #[cfg(feature = "libtorch")]
    pub const INITIALISE: u64 = 1;
    pub const EPISODE: u64 = 2;
    #[cfg(feature = "libtorch")]
    pub const UPDATE: u64 = 3;
    pub const SPOONS: u64 = 4;
}

/// A planned episode: everything is drawn from its own seed.
pub struct Planned {
    /// Index within the whole training.
    pub index: u32,
    /// Level it belongs to.
    pub level: u32,
    /// Whether its powder is drawn from the whole box; it then does not count towards the level.
    pub randomised: bool,
    /// Powder parameters, with its conditions applied.
    pub set: ParameterSet,
    /// The other changes made by its conditions.
    patch: Patch,
    heap: u32,
    /// Angle of repose of its level, degrees; none if its powder is drawn from the box.
    pub repose_deg: Option<f64>,
    /// Target, mg.
    pub target_mg: f64,
    /// Generator of what is drawn while it is played.
    #[cfg(feature = "libtorch")]
    pub(super) rng: Pcg64Mcg,
    /// Its seed: of the balance's noise, and of the spoonful on the surrogate.
    pub(super) seed: u64,
}

/// Seed index of the spoonful in an episode played on the surrogate.
const SPOONFUL: u64 = 2;
/// Seed index of an episode's conditions.
const CONDITIONS: u64 = 3;

/// Plans episode `index` of a training currently at `level`.
#[cfg(feature = "libtorch")]
pub fn plan(index: u32, level: u32, levels: &[Level], settings: &Settings) -> Planned {
    plan_of(settings.seed, index, level, levels, settings)
}

/// Plans episode `index` of this seed.
pub(super) fn plan_of(
    seed: u64,
    index: u32,
    level: u32,
    levels: &[Level],
    settings: &Settings,
) -> Planned {
    let seed = derive(seed, &[stream::EPISODE, index.into()]);
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let target_mg = settings.target_mg_min
        + (settings.target_mg_max - settings.target_mg_min) * rng.random::<f64>();
    let level = match settings.order {
        Order::Random => rng.random_range(0..levels.len() as u32),
        Order::DomainRandomisation => 0,
        Order::Curriculum | Order::Reverse => level,
    };
    let randomised = settings.order == Order::DomainRandomisation
        || (settings.box_share > 0.0 && rng.random::<f64>() < settings.box_share);
    let set = if randomised {
        ParameterSet::from_unit(std::array::from_fn(|_| rng.random()))
    } else {
        let sets = &levels[level as usize].sets;
        sets[rng.random_range(0..sets.len())]
    };
    let heap = rng.random_range(0..settings.fills_per_set);
    let powder =
        levels.get(level as usize).filter(|_| !randomised).map(|level| level.powder.as_str());
    let patch = settings.extended.as_ref().map_or_else(Patch::default, |extended| {
        extended.drawn(powder, derive(seed, &[CONDITIONS])).clone()
    });
    let set = patch.powder(&set);
    let repose_deg =
        levels.get(level as usize).filter(|_| !randomised).map(|level| level.repose_deg);
    Planned {
        index,
        level,
        randomised,
        set,
        patch,
        heap,
        repose_deg,
        target_mg,
        #[cfg(feature = "libtorch")]
        rng,
        seed,
    }
}

impl Planned {
    /// Its spoonful on the surrogate.
    pub(super) fn surrogate(&self, settings: &Settings) -> SurrogateSpoon {
        Surrogate::new(settings.rules.pitch).fill(&self.set, derive(self.seed, &[SPOONFUL]))
    }

    /// Its filled spoon.
    pub(super) fn spoon<F: Filling>(&self, spoons: &Spoons<F>, settings: &Settings) -> F::Spoon {
        // If days do not recur, keeping their spoons is not worth the memory.
        let recurs = !self.randomised && settings.extended.as_ref().is_none_or(Extended::is_held);
        match recurs {
            true => spoons.take(&self.set, self.own_heap(), &self.patch),
            false => spoons.fill(&self.set, self.own_heap(), &self.patch),
        }
    }

    /// Its spoon before the powder has fallen.
    #[cfg(feature = "libtorch")]
    pub(super) fn loose(&self, spoons: &Spoons<Simulated>) -> Dispenser {
        spoons.loose(&self.set, self.own_heap(), &self.patch)
    }

    fn own_heap(&self) -> u32 {
        if self.randomised { self.index } else { self.heap }
    }
}

/// The levels in training order; none where powders are drawn from the whole box.
///
/// # Errors
/// There is no level, or one without a parameter set or with an angle that is none.
pub(super) fn ordered(levels: &[Level], settings: &Settings) -> Result<Vec<Level>, FieldError> {
    if settings.order == Order::DomainRandomisation {
        return Ok(Vec::new());
    }
    if levels.is_empty() {
        return Err(FieldError::new("levels", "must name at least one powder"));
    }
    for (k, level) in levels.iter().enumerate() {
        if level.sets.is_empty() {
            let advice = format!("`{}` has no parameter set; calibrate it first", level.powder);
            return Err(FieldError::new(format!("levels[{k}].sets"), advice));
        }
        flip_core::domain::bounded(
            &format!("levels[{k}].repose_deg"),
            level.repose_deg,
            0.0,
            90.0,
            "deg",
        )?;
    }
    let mut levels = levels.to_vec();
    levels.sort_by(|a, b| {
        a.repose_deg.total_cmp(&b.repose_deg).then_with(|| a.powder.cmp(&b.powder))
    });
    if settings.order == Order::Reverse {
        levels.reverse();
    }
    Ok(levels)
}

#[cfg(all(test, feature = "libtorch"))]
mod tests {
    use super::super::settings::Preset;
    use super::*;
    use flip_core::domain::conditions::Under;

    #[test]
    fn days_change_the_powder_and_nothing_else_that_is_drawn() {
        let sets =
            vec![ParameterSet::default(), ParameterSet::default().with("friction", 0.7).unwrap()];
        let levels = [Level { powder: "salt".into(), repose_deg: 36.0, sets }];
        let base = Settings { box_share: 0.3, ..Settings::of(Preset::Flip, Order::Curriculum, 1) };
        let more = |cohesion: f64| Patch {
            parameters: [("cohesion".to_owned(), cohesion)].into(),
            ..Patch::default()
        };
        let under = Under { simulator: "sv-1".into(), conditions: Default::default() };
        let powders = [("salt".to_owned(), vec![more(0.2), more(0.4)])].into();
        let extended = Settings {
            extended: Some(Extended { under, days: vec![more(0.1)], powders }),
            ..base.clone()
        };
        let mut met = std::collections::BTreeSet::new();
        for index in 0..60 {
            let [a, b] = [&base, &extended].map(|settings| plan(index, 0, &levels, settings));
            assert_eq!(
                (a.target_mg, a.heap, a.randomised, a.seed),
                (b.target_mg, b.heap, b.randomised, b.seed)
            );
            assert_eq!(a.set.friction(), b.set.friction());
            assert!(a.patch.is_none());
            let added = b.patch.parameters["cohesion"];
            assert!(b.set.cohesion() == (a.set.cohesion() + added).min(1.2));
            assert_eq!(added == 0.1, b.randomised, "powders out of the box have the average day");
            met.insert((added * 10.0) as u32);
        }
        assert_eq!(met.into_iter().collect::<Vec<_>>(), [1, 2, 4]);
        let none = Extended { days: Vec::new(), ..extended.extended.clone().unwrap() };
        assert_eq!(
            Settings { extended: Some(none), ..base }.checked().unwrap_err().field,
            "extended.days"
        );
    }
}
