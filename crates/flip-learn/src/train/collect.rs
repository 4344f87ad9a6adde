//! One round of episodes, played with one snapshot of the policy: a batch of experiments.

use super::environment::{Filling, Played, Spoon, play};
use super::episodes::Episode;
use super::record::{Flow, Level};
use super::replay::Memory;
use super::settings::{Extended, Order, Settings};
use super::spoons::Spoons;
use super::surrogate::Surrogate;
use flip_core::domain::conditions::Patch;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_policy::{Actor, Carried, OUTPUTS};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

/// Identifiers of the random streams: the first index after the training's seed.
pub(super) mod stream {
    pub const INITIALISE: u64 = 1;
    pub const EPISODE: u64 = 2;
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
    /// Angle of repose of its level, degrees.
    repose_deg: Option<f64>,
    target_mg: f64,
    rng: Pcg64Mcg,
    seed: u64,
}

/// Seed index of the spoonful in an episode played on the surrogate.
const SPOONFUL: u64 = 2;
/// Seed index of an episode's conditions.
const CONDITIONS: u64 = 3;

/// Plans episode `index` of a training currently at `level`.
pub fn plan(index: u32, level: u32, levels: &[Level], settings: &Settings) -> Planned {
    let seed = derive(settings.seed, &[stream::EPISODE, index.into()]);
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
    Planned { index, level, randomised, set, patch, heap, repose_deg, target_mg, rng, seed }
}

/// The episodes of a round.
pub struct Round<'a> {
    /// They are played independently of each other.
    pub planned: Vec<Planned>,
    /// The policy; without one the actions are random.
    pub actor: Option<&'a Actor>,
    /// Settings of the training.
    pub settings: &'a Settings,
}

/// Where the rounds of a training are played: on this machine's cores by [`Spoons`].
pub trait Rounds {
    /// Plays a round; results are in order and depend on nothing else. None if `flow` requested a
    /// stop before all were played.
    fn play(&self, round: Round<'_>, flow: &Flow<'_>) -> Option<Vec<(Planned, Played)>>;
}

impl<F: Filling> Rounds for Spoons<'_, F> {
    fn play(&self, round: Round<'_>, flow: &Flow<'_>) -> Option<Vec<(Planned, Played)>> {
        let Round { planned, actor, settings } = round;
        let play = |mut plan: Planned| {
            if flow().is_break() {
                return None;
            }
            let played = if plan.index < settings.surrogate_episodes {
                let seed = derive(plan.seed, &[SPOONFUL]);
                let spoon = Surrogate::new(settings.rules.pitch).fill(&plan.set, seed);
                play_planned(&mut plan, spoon, actor, settings)
            } else {
                let spoon = spoon(self, &plan, settings);
                play_planned(&mut plan, spoon, actor, settings)
            };
            Some((plan, played))
        };
        planned.into_par_iter().map(play).collect()
    }
}

fn spoon<F: Filling>(spoons: &Spoons<'_, F>, plan: &Planned, settings: &Settings) -> F::Spoon {
    // If days do not recur, keeping their spoons is not worth the memory.
    let recur = settings.extended.as_ref().is_none_or(Extended::is_held);
    match (plan.randomised, recur) {
        (true, _) => spoons.fill(&plan.set, plan.index, &plan.patch),
        (false, false) => spoons.fill(&plan.set, plan.heap, &plan.patch),
        (false, true) => spoons.take(&plan.set, plan.heap, &plan.patch),
    }
}

fn play_planned(
    plan: &mut Planned,
    mut spoon: impl Spoon,
    actor: Option<&Actor>,
    settings: &Settings,
) -> Played {
    let (target_mg, seed, rng) = (plan.target_mg, plan.seed, &mut plan.rng);
    let begun = actor.map(Actor::begin).unwrap_or_default();
    let mut carried = Carried { repose_deg: plan.repose_deg, ..begun };
    let tilt = settings.warmup_tilt as f32 * rng.random::<f32>();
    play(&mut spoon, &settings.rules, &settings.balance, target_mg, seed, |seen| match actor {
        Some(actor) => actor.sample(seen, &mut carried, rng),
        None => random_action(tilt, rng),
    })
}

/// Uniform over all actions, with the incline change shifted by `tilt`.
fn random_action(tilt: f32, rng: &mut Pcg64Mcg) -> [f32; OUTPUTS] {
    let mut uniform = || 2.0 * rng.random::<f32>() - 1.0;
    [(uniform() + tilt).clamp(-1.0, 1.0), uniform()]
}

/// Converts an episode for the replay memory; `actor` is the current one, whether or not it played.
pub fn remembered(plan: &Planned, played: &Played, actor: &Actor, settings: &Settings) -> Episode {
    let parameters = plan.set.to_unit().map(|x| x as f32);
    let (target_mg, repose_deg) = (played.target_mg as f32, plan.repose_deg.unwrap_or(0.0) as f32);
    let steps = played
        .steps
        .iter()
        .map(|&step| Memory { step, target_mg, repose_deg, parameters })
        .collect();
    Episode::new(steps, actor, settings)
}

#[cfg(test)]
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
