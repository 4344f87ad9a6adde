//! The replays of one powder: as calibrated, and with each cause at each amplitude.

use super::ask::{Calibrated, Change, Simulator, SpoonHeap, SpoonReplay};
use super::causes::{AMPLITUDES, SpoonCause};
use super::readings::{Scatter, shown};
use super::summaries::Frame;
use super::{Plan, Settings};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_core::domain::shake::Spoonful;
use flip_core::stats::summary::mean;

/// What fell as a balance showed it, `[spoonful][step]`, mg.
pub(super) type Fell = Vec<Vec<f64>>;

/// Replays of all spoonfuls with one set.
#[derive(Debug, Clone)]
pub(super) struct Campaign {
    pub set: usize,
    pub fell: Fell,
}

/// A cause at one amplitude with one set.
#[derive(Debug, Clone)]
pub(super) struct Node {
    pub cause: SpoonCause,
    /// Place among the amplitudes, from 0.
    pub place: usize,
    pub set: usize,
    pub change: Change,
    /// Its heap, deg; `None` if it has no angle.
    pub angle_deg: Option<f64>,
    pub replays: Vec<Fell>,
}

/// One powder: measured, as calibrated, and with every cause.
#[derive(Debug, Clone)]
pub(super) struct Field<'a> {
    /// The judged spoonfuls and their places among all.
    pub spoonfuls: Vec<(usize, &'a Spoonful)>,
    pub measured: Fell,
    /// As calibrated, in order of the draw; the same number for every powder.
    pub base: Vec<Campaign>,
    /// Angle of each set's heap, deg.
    pub angles_deg: Vec<Option<f64>>,
    pub nodes: Vec<Node>,
}

/// Seed indices.
const BASE: u64 = 1;
const CAUSE: u64 = 2;
const HEAP: u64 = 3;
const NOISE: u64 = 4;
const DRAW: u64 = 5;
/// Offset of friction by which its effect on the angle is measured.
const FRICTION: f64 = 0.3;
/// Least change of the angle by friction, deg per unit: below, friction compensates nothing.
const SLOPE_MIN: f64 = 3.0;

impl<'a> Field<'a> {
    /// The spoonfuls of a powder that the budget allows, spread over all of them and over their places
    /// in a weighing: a probing run makes each of its spoonfuls with another stroke.
    pub fn of(powder: &str, all: &'a [Spoonful], most: usize) -> Self {
        let own: Vec<(usize, &Spoonful)> =
            all.iter().enumerate().filter(|(_, it)| it.powder == powder).collect();
        let count = own.len().min(most);
        let spoonfuls: Vec<(usize, &Spoonful)> =
            (0..count).map(|k| own[k * own.len() / count + k % (own.len() / count)]).collect();
        let fell = |it: &Spoonful| it.shakes.iter().map(|shake| shake.fell_mg).collect();
        let measured = spoonfuls.iter().map(|(_, it)| fell(it)).collect();
        Self { spoonfuls, measured, base: vec![], angles_deg: vec![], nodes: vec![] }
    }

    /// The same with the replays of one cause alone.
    pub fn with_only(&self, cause: SpoonCause) -> Self {
        let mut alone = self.clone();
        alone.nodes.retain(|node| node.cause == cause);
        alone
    }

    /// The frame of the spoonfuls at these places.
    pub fn frame(&self, keep: &[usize]) -> Frame<'a> {
        Frame::of(keep.iter().map(|&k| self.spoonfuls[k].1).collect())
    }

    /// Replays every spoonful as calibrated, each campaign with a set of its own draw.
    pub fn replay(
        &mut self,
        of: &Calibrated,
        settings: &Settings,
        simulator: &dyn Simulator,
        seed: u64,
    ) {
        let campaigns = 0..u64::from(settings.campaigns);
        let sets: Vec<usize> =
            campaigns.map(|b| (derive(seed, &[DRAW, b]) % of.sets.len() as u64) as usize).collect();
        let asked = sets.iter().map(|&set| (of.sets[set], Change::default())).collect::<Vec<_>>();
        let fell = self.poured(&asked, settings, simulator, derive(seed, &[BASE]));
        self.base = sets
            .into_iter()
            .zip(fell)
            .map(|(set, fell)| Campaign { set, fell: fell.unwrap_or_default() })
            .collect();
    }

    /// Replays every spoonful with every cause at every amplitude.
    pub fn extend(&mut self, plan: &Plan<'_>, used: &[usize], seed: u64) {
        let mut nodes = self.planned(&plan.settings.causes, used);
        if plan.of.angle.is_some() {
            self.compensate(&mut nodes, plan, seed);
        }
        let repeats = plan.settings.repeats as usize;
        let asked: Vec<(ParameterSet, Change)> = nodes
            .iter()
            .flat_map(|node| {
                std::iter::repeat_n((plan.of.sets[node.set], node.change.clone()), repeats)
            })
            .collect();
        let fell = self.poured(&asked, plan.settings, plan.simulator, derive(seed, &[CAUSE]));
        for (node, fell) in nodes.iter_mut().zip(fell.chunks(repeats)) {
            node.replays = fell.iter().flatten().cloned().collect();
        }
        nodes.retain(|node| !node.replays.is_empty());
        self.nodes = nodes;
    }

    fn planned(&self, causes: &[SpoonCause], used: &[usize]) -> Vec<Node> {
        let node = |cause: SpoonCause, place: usize, set: usize| Node {
            cause,
            place,
            set,
            change: cause.change(cause.amplitudes()[place]),
            angle_deg: None,
            replays: Vec::new(),
        };
        let of = |cause: SpoonCause| {
            (0..AMPLITUDES)
                .flat_map(move |place| used.iter().map(move |&set| node(cause, place, set)))
        };
        causes.iter().filter(|cause| self.may_be(**cause)).flat_map(|cause| of(*cause)).collect()
    }

    /// Whether the data leave room for a cause: a filling that was weighed is known.
    pub fn may_be(&self, cause: SpoonCause) -> bool {
        let is_weighed = |it: &Spoonful| it.shakes.first().is_some_and(|it| it.spoon_mg.is_some());
        cause != SpoonCause::FillLevel || !self.spoonfuls.iter().all(|(_, it)| is_weighed(it))
    }

    /// What the balance would show of replays; `None` where one diverged.
    fn poured(
        &self,
        asked: &[(ParameterSet, Change)],
        settings: &Settings,
        simulator: &dyn Simulator,
        seed: u64,
    ) -> Vec<Option<Fell>> {
        let replay = |(k, (set, change)): (usize, &(ParameterSet, Change))| {
            let of = |&(spoonful, _): &(usize, &Spoonful)| SpoonReplay {
                set: *set,
                spoonful,
                change: change.clone(),
                seed: derive(seed, &[k as u64, spoonful as u64]),
            };
            self.spoonfuls.iter().map(of).collect::<Vec<_>>()
        };
        let replays: Vec<SpoonReplay> = asked.iter().enumerate().flat_map(replay).collect();
        let answers = simulator.pour(&replays);
        let scatter = Scatter { spoonful: settings.spoonful_sd, day: settings.day_sd };
        let campaign = |(k, answers): (usize, &[Option<Vec<f64>>])| {
            let noise = derive(seed, &[NOISE, k as u64]);
            let each = self.spoonfuls.iter().zip(answers).enumerate();
            each.map(|(at, ((_, of), mg))| Some(shown(of, mg.as_ref()?, scatter, noise, at)))
                .collect::<Option<Fell>>()
        };
        answers.chunks(self.spoonfuls.len()).enumerate().map(campaign).collect()
    }

    /// Gives every node the friction with which its heap keeps the measured angle.
    fn compensate(&mut self, nodes: &mut [Node], plan: &Plan<'_>, seed: u64) {
        let seed = derive(seed, &[HEAP]);
        let Some(target) = plan.of.angle.map(|angle| angle.repose_deg) else { return };
        let used: Vec<usize> = (0..plan.of.sets.len())
            .filter(|set| nodes.iter().any(|node| node.set == *set))
            .collect();
        let (angles, slopes) = self.heaps_of_sets(plan, &used, seed);
        self.angles_deg = angles;
        let first = angles_of(nodes, plan, derive(seed, &[1]));
        for (node, angle) in nodes.iter_mut().zip(first) {
            let Some(angle) = angle else { continue };
            node.angle_deg = Some(angle);
            let friction = plan.of.sets[node.set].friction();
            let more = (target - angle) / slopes[node.set];
            let more = more.clamp(-friction, 1.3 - friction);
            node.change.patch.parameters.insert("friction".to_owned(), more);
        }
        let second = angles_of(nodes, plan, derive(seed, &[2]));
        for (node, angle) in nodes.iter_mut().zip(second) {
            node.angle_deg =
                if node.cause.moves_heaps() { angle } else { self.angles_deg[node.set] };
        }
    }

    /// Angle of each set's heap, and how friction changes it, deg per unit.
    fn heaps_of_sets(
        &self,
        plan: &Plan<'_>,
        used: &[usize],
        seed: u64,
    ) -> (Vec<Option<f64>>, Vec<f64>) {
        let offset = |set: usize, more: f64| {
            let friction = plan.of.sets[set].friction();
            (friction + more).clamp(0.0, 1.3) - friction
        };
        let heap = |set: usize, more: f64, k: u64| {
            let mut patch = Change::default().patch;
            if more != 0.0 {
                patch.parameters.insert("friction".to_owned(), offset(set, more));
            }
            SpoonHeap { set: plan.of.sets[set], patch, seed: derive(seed, &[0, set as u64, k]) }
        };
        let asked: Vec<SpoonHeap> = used
            .iter()
            .flat_map(|&set| {
                [
                    heap(set, 0.0, 0),
                    heap(set, 0.0, 1),
                    heap(set, -FRICTION, 2),
                    heap(set, FRICTION, 3),
                ]
            })
            .collect();
        let answers = plan.simulator.heaps(&asked);
        let mut angles = vec![None; plan.of.sets.len()];
        let mut slopes = vec![f64::INFINITY; plan.of.sets.len()];
        for (&set, of) in used.iter().zip(answers.chunks(4)) {
            angles[set] = mean(&of[..2].iter().flatten().copied().collect::<Vec<_>>());
            if let [Some(low), Some(high)] = of[2..] {
                let apart = offset(set, FRICTION) - offset(set, -FRICTION);
                slopes[set] = ((high - low) / apart).max(SLOPE_MIN);
            }
        }
        (angles, slopes)
    }
}

/// The heaps of those nodes that a heap knows of, deg.
fn angles_of(nodes: &[Node], plan: &Plan<'_>, seed: u64) -> Vec<Option<f64>> {
    let known: Vec<usize> = (0..nodes.len()).filter(|&k| nodes[k].cause.moves_heaps()).collect();
    let heap = |&k: &usize| SpoonHeap {
        set: plan.of.sets[nodes[k].set],
        patch: nodes[k].change.patch.clone(),
        seed: derive(seed, &[k as u64]),
    };
    let answers = plan.simulator.heaps(&known.iter().map(heap).collect::<Vec<_>>());
    let mut all = vec![None; nodes.len()];
    known.into_iter().zip(answers).for_each(|(k, angle)| all[k] = angle);
    all
}
