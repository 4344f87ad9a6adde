//! What a solver outside this crate needs to carry out the same experiment: the law's numbers, the
//! state of a settled spoon, the motion of an action, and where departed grains fall.
//!
//! Such a solver follows the theory of the [crate]. It starts from [`Dispenser::state`],
//! carries out the [`Plan`] of each action substep by substep, and hands the grains that left back
//! to [`Spoon::landed`].

use super::super::batch::Motion;
use super::super::grains::Departure;
use super::super::law::Law;
use super::super::snapshot::Snapshot;
use super::super::walls::Shape;
use super::motion::{self, Pose};
use super::{Dispenser, REST_M_S, REST_S, SETTLE_WAITS, SLICE, Settings};
use crate::constraints::{Contact, vector};

/// Strengths of one kind of contact; shares are of one substep and one side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Strengths {
    /// Share of an overlap.
    pub normal: f32,
    /// Share of a tangential stretch.
    pub tangential: f32,
    /// Share of the approach velocity of a grain with one contact.
    pub normal_damping: f32,
    /// Share of the slip velocity of a grain with one contact.
    pub tangential_damping: f32,
    /// Coulomb friction coefficient.
    pub friction: f32,
    /// Attraction of touching bodies, diameters per substep squared.
    pub attraction: f32,
    /// Gap at which bodies begin to touch, diameters.
    pub onset: f32,
    /// Gap at which the attraction ends, diameters.
    pub reach: f32,
}

impl From<&Contact> for Strengths {
    fn from(contact: &Contact) -> Self {
        Self {
            normal: contact.normal,
            tangential: contact.tangential,
            normal_damping: contact.normal_damping,
            tangential_damping: contact.tangential_damping,
            friction: contact.friction,
            attraction: contact.attraction,
            onset: contact.onset,
            reach: contact.reach,
        }
    }
}

/// Mechanisms beyond the base simulator. One of strength 0 does nothing; the equations are those of
/// [`crate::mechanisms`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mechanisms {
    /// Freedom of grains to turn: 0 none, 1 as for solid spheres.
    pub freedom: f32,
    /// Largest rolling torque over push and radius.
    pub rolling_friction: f32,
    /// Share of a rolling stretch, and of a turn, that one substep removes from one side.
    pub rolling_stiffness: f32,
    /// See there.
    pub rolling_damping: f32,
    /// Attraction of the spoon, diameters per substep squared.
    pub film: f32,
    /// The same, in addition, for a grain that clings.
    pub cling: f32,
    /// Gap at which both end, diameters.
    pub film_reach: f32,
    /// Attraction of a charged grain to a wall at contact, diameters per substep squared.
    pub charge: f32,
    /// Gap at which it is cut off, diameters.
    pub charge_reach: f32,
    /// Attraction of a contact that has lasted for long, diameters per substep squared.
    pub ageing: f32,
    /// Age at which it is half of that, substeps.
    pub ageing_half_life: f32,
    /// Attraction by a liquid bridge at contact, diameters per substep squared.
    pub bridge: f32,
    /// Gap at which the bridge breaks, diameters.
    pub bridge_rupture: f32,
    /// 1 over the length in which its attraction falls, per diameter.
    pub bridge_inverse_length: f32,
    /// Share of a slow velocity that air takes in a substep.
    pub air: f32,
    /// How that share grows with the velocity, substeps per diameter.
    pub air_inertia: f32,
    /// Peak of the vertical acceleration of a spoon that vibrates, diameters per substep squared.
    pub vibration: f32,
    /// Its angle, radians per substep, counted from the first substep of the spoon.
    pub vibration_pace: f64,
    /// Largest radius of a grain, diameters.
    pub widest: f32,
}

/// A spoon and its powder's law, without the grains. Lengths in grain diameters and times in
/// substeps unless a name says otherwise.
#[derive(Debug, Clone, Copy)]
pub struct Spoon {
    settings: Settings,
    law: Law,
    /// Factor on every velocity per substep.
    pub drag: f32,
    /// Between grains.
    pub grain: Strengths,
    /// Between a grain and the spoon.
    pub wall: Strengths,
    /// Mechanisms beyond the base simulator, if its powder has any.
    pub mechanisms: Option<Mechanisms>,
    /// Semi-axes of the bowl: the lower half of an ellipsoid about the origin, open at z = 0, tip
    /// towards +x.
    pub semi_axes: [f32; 3],
    /// Mass of a grain, mg.
    pub grain_mg: f64,
    /// Substep, s.
    pub substep_s: f64,
    /// Substeps between two checks for departed grains and for rest.
    pub slice: u32,
    /// Speed below which all grains must stay for the powder to rest.
    pub rest_speed: f32,
    /// Substeps for which they must stay below it.
    pub quiet: u32,
    /// How long the last grain of a loose heap falls, s.
    fall_s: f64,
}

/// A grain of a spoon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grain {
    /// Number in the order of pouring.
    pub id: u32,
    /// Radius.
    pub radius: f32,
    /// Centre.
    pub x: [f32; 3],
    /// Velocity.
    pub v: [f32; 3],
    /// Number of contacts in the last substep, with the spoon's.
    pub contacts: f32,
    /// Where its contact with the spoon stuck, if it touches the spoon.
    pub wall_anchor: Option<[f32; 3]>,
}

/// How a grain turns.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Turning {
    /// Spin, radians per substep.
    pub spin: [f32; 3],
    /// Stretch of its rolling at the spoon since the contact stuck, radians.
    pub wall_stretch: [f32; 3],
    /// Whether it clings to spoons.
    pub clings: bool,
}

/// Grains and the memory of their contacts.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct State {
    /// The grains, in no particular order.
    pub grains: Vec<Grain>,
    /// Touching pairs by their places in `grains`, and the position of the first relative to the
    /// second where the contact stuck.
    pub stuck: Vec<([u32; 2], [f32; 3])>,
    /// How the grains turn, in the order of `grains`; empty in the base simulator.
    pub turning: Vec<Turning>,
    /// Stretch of the pairs' rolling since the contact stuck, radians, in the order of `stuck`; empty
    /// in the base simulator.
    pub rolls: Vec<[f32; 3]>,
    /// How long the pairs have touched, substeps, in the order of `stuck`; empty in the base simulator.
    /// Counted only where contacts age.
    pub ages: Vec<f32>,
    /// Pairs that no longer touch and that a liquid bridge spans, by their places in `grains`.
    pub bridged: Vec<[u32; 2]>,
    /// Substeps of the spoon so far, by which it vibrates; 0 in the base simulator.
    pub elapsed: u32,
}

/// A motion of the spoon, then rest if any.
#[derive(Debug, Clone)]
pub struct Part {
    /// Gravity and inertia along x and z in each substep of the motion, diameters per substep
    /// squared.
    pub body: Vec<[f32; 2]>,
    /// Duration of the motion, s.
    pub duration_s: f64,
    /// The same while the spoon stands after it.
    pub standing: [f32; 2],
    /// Most substeps for which rest is awaited after the motion, a multiple of the slice; 0 where
    /// the next motion follows at once.
    pub rest_max: u32,
    kind: Kind,
}

#[derive(Debug, Clone, Copy)]
enum Kind {
    Incline { from_deg: f64, to_deg: f64 },
    Shake { pitch_deg: f64, amplitude_m: f64 },
    Fall,
}

/// An action, part by part.
#[derive(Debug, Clone, Default)]
pub struct Plan {
    /// In the order in which they are carried out.
    pub parts: Vec<Part>,
    /// Pitch afterwards, degrees.
    pub pitch_deg: f64,
}

/// A grain that left the spoon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Departed {
    /// Place of the part of the plan.
    pub part: u32,
    /// Substep of its motion after which the grain was found gone, counted from 0; none during the
    /// rest.
    pub substep: Option<u32>,
    /// Its number, by which it has its mass; any number where all grains have one size.
    pub id: u32,
    /// Centre.
    pub x: [f32; 3],
    /// Velocity.
    pub v: [f32; 3],
}

impl Spoon {
    /// Takes a motion apart for a spoon at this pitch, as [`Dispenser::step`],
    /// [`Dispenser::level`] and [`Dispenser::settle`] carry it out.
    pub fn plan(&self, pitch_deg: f64, motion: impl Into<Motion>) -> Plan {
        let limits = self.settings.pitch;
        let (to_deg, shake_mm, strokes) = match motion.into() {
            Motion::Settle => {
                return Plan { parts: vec![self.part(Kind::Fall, SETTLE_WAITS)], pitch_deg: 0.0 };
            }
            Motion::Level => (0.0, 0.0, 0),
            Motion::Act(action) => {
                let to_deg = pitch_deg + action.incline_change_deg;
                let to_deg = to_deg.clamp(limits.lower_deg, limits.upper_deg);
                (to_deg, action.executed_shake_mm(), action.strokes)
            }
        };
        let strokes = if shake_mm > 0.0 { strokes } else { 0 };
        let mut kinds = Vec::new();
        if to_deg != pitch_deg {
            let waits = if strokes == 0 { 1.0 } else { 0.0 };
            kinds.push((Kind::Incline { from_deg: pitch_deg, to_deg }, waits));
        }
        let shake = Kind::Shake { pitch_deg: to_deg, amplitude_m: shake_mm * 1e-3 };
        kinds.extend((0..strokes).map(|_| (shake, 1.0)));
        let parts = kinds.into_iter().map(|(kind, waits)| self.part(kind, waits)).collect();
        Plan { parts, pitch_deg: to_deg }
    }

    /// A motion and then, at most, so many of the longest waits for rest.
    fn part(&self, kind: Kind, waits: f64) -> Part {
        let (duration_s, moments) = self.moments(kind);
        let body = |(pose, acceleration)| {
            let body = motion::body(&self.law, pose, acceleration);
            [body[0], body[2]]
        };
        let slices = self.law.substeps(waits * self.settings.settle_max_s).div_ceil(SLICE);
        Part {
            body: moments.into_iter().map(body).collect(),
            duration_s,
            standing: body((standing(kind), 0.0)),
            rest_max: slices * SLICE,
            kind,
        }
    }

    /// Duration of a motion, s, and the pose and acceleration of each of its substeps.
    fn moments(&self, kind: Kind) -> (f64, Vec<(Pose, f64)>) {
        let times = |duration: f64| {
            (0..self.law.substeps(duration)).map(|k| f64::from(k) * self.law.substep_s)
        };
        match kind {
            Kind::Incline { from_deg, to_deg } => {
                let (duration, motion) = motion::incline(&self.settings, [from_deg, to_deg]);
                (duration, times(duration).map(motion).collect())
            }
            Kind::Shake { pitch_deg, amplitude_m } => {
                let (duration, motion) =
                    motion::shake(&self.settings, &self.law, pitch_deg, amplitude_m);
                (duration, times(duration).map(motion).collect())
            }
            Kind::Fall => {
                (self.fall_s, times(self.fall_s).map(|_| (Pose::default(), 0.0)).collect())
            }
        }
    }

    /// A state of this spoon as a [`Snapshot`] at a simulated time.
    pub fn snapshot(&self, state: &State, time_s: f64) -> Snapshot {
        let centre = |grain: &Grain| [grain.x[0], grain.x[1], grain.x[2], grain.radius];
        let ids: Vec<u32> = state.grains.iter().map(|grain| grain.id).collect();
        let centres: Vec<_> = state.grains.iter().map(centre).collect();
        Snapshot::of(&ids, &centres, self.law.diameter_m, time_s)
    }

    /// Mass of a grain with this number, relative to a mean grain.
    pub fn mass(&self, id: u32) -> f64 {
        match self.mechanisms.is_some_and(|it| it.widest != 0.5) {
            true => (2.0 * f64::from(self.law.mechanisms.sizes.radius(id))).powi(3),
            false => 1.0,
        }
    }

    /// Mass of these grains that fell into the vial and mass that missed it, relative to a mean grain. A
    /// grain that names a part or substep that the plan does not have counts as having missed.
    pub fn landed(&self, plan: &Plan, departed: &[Departed]) -> [f64; 2] {
        let mut landed = [0.0; 2];
        let in_plan = |it: &&Departed| (it.part as usize) < plan.parts.len();
        for (place, part) in plan.parts.iter().enumerate() {
            let of_part = || departed.iter().filter(|it| it.part as usize == place);
            let moving = of_part().any(|it| it.substep.is_some());
            let moments = if moving { self.moments(part.kind).1 } else { Vec::new() };
            for it in of_part() {
                let pose = match it.substep {
                    None => Some(standing(part.kind)),
                    Some(substep) => moments.get(substep as usize).map(|(pose, _)| *pose),
                };
                let [x, v] = [it.x, it.v].map(|it| vector(it[0], it[1], it[2]));
                let meets = pose.is_some_and(|pose| {
                    let departure = Departure { id: 0, x, v };
                    pose.flight(&departure, &self.law).meets_the_mouth(&self.settings)
                });
                landed[usize::from(!meets)] += self.mass(it.id);
            }
        }
        let elsewhere = departed.iter().filter(|it| !in_plan(it)).map(|it| self.mass(it.id));
        landed[1] += elsewhere.sum::<f64>();
        landed
    }
}

/// The pose after a motion.
fn standing(kind: Kind) -> Pose {
    let pitch_deg = match kind {
        Kind::Incline { to_deg, .. } => to_deg,
        Kind::Shake { pitch_deg, .. } => pitch_deg,
        Kind::Fall => 0.0,
    };
    Pose { pitch_rad: pitch_deg.to_radians(), ..Pose::default() }
}

impl Dispenser {
    /// This spoon's shape and law.
    pub fn spoon(&self) -> Spoon {
        let law = self.law;
        Spoon {
            settings: self.settings,
            law,
            drag: law.drag,
            grain: Strengths::from(&law.grain),
            wall: Strengths::from(&law.wall),
            mechanisms: law.extended.then(|| law.mechanisms.outside()),
            semi_axes: self.bowl.semi_axes,
            grain_mg: self.grain_mg,
            substep_s: law.substep_s,
            slice: SLICE,
            rest_speed: (REST_M_S * law.substep_s / law.diameter_m) as f32,
            quiet: law.substeps(REST_S),
            fall_s: self.fall_s,
        }
    }

    /// The grains in it and the memory of their contacts.
    pub fn state(&self) -> State {
        let three = |it: &[f32; 4]| [it[0], it[1], it[2]];
        let grains = &self.grains;
        let moving = grains.centres().iter().zip(grains.velocities());
        let known = grains.ids().iter().zip(grains.wall_anchors());
        let described = moving.zip(known).map(|((x, v), (id, anchor))| Grain {
            id: *id,
            radius: x[3],
            x: three(x),
            v: three(v),
            contacts: v[3],
            wall_anchor: (anchor[3] > 0.0).then(|| three(anchor)),
        });
        let mut state = State { grains: described.collect(), ..State::default() };
        for (ends, anchor, [x, y, z, age]) in grains.stuck() {
            state.stuck.push((ends, anchor));
            state.rolls.extend(self.law.extended.then_some([x, y, z]));
            state.ages.extend(self.law.extended.then_some(age));
        }
        if self.law.extended {
            state.bridged = grains.bridged();
            state.elapsed = grains.elapsed();
            let turning = grains.turning().zip(&state.grains);
            let turning = turning.map(|((spin, stretch), grain)| Turning {
                spin: three(spin),
                // One that has let go is forgotten at the next touch.
                wall_stretch: grain.wall_anchor.map_or([0.0; 3], |_| three(stretch)),
                clings: stretch[3] > 0.0,
            });
            state.turning = turning.collect();
        }
        state
    }

    /// Advances by one substep for each of these accelerations along x and z, diameters per substep
    /// squared, without looking for departed grains: for comparing solvers.
    pub fn drive(&mut self, body: &[[f32; 2]]) {
        for [x, z] in body {
            let body = vector(*x, 0.0, *z);
            self.grains.substep(&self.law, body, &Shape::Bowl(self.bowl));
        }
        self.substeps += body.len() as u32;
    }
}

#[cfg(test)]
mod tests {
    use super::super::Poured;
    use super::*;
    use flip_core::domain::bench::Action;
    use flip_core::domain::parameters::ParameterSet;

    #[test]
    fn a_plan_carried_out_by_hand_pours_what_a_step_pours() {
        let settings =
            Settings { particles: 300, semi_axes_mm: [2.4, 1.7, 1.0], ..Default::default() };
        let mut stepped = Dispenser::loose(&ParameterSet::default(), &settings, 3);
        let mut driven = stepped.clone();
        let spoon = driven.spoon();
        let mut pitch_deg = 0.0;
        for motion in [
            Motion::Settle,
            Motion::Act(Action::once(8.0, 0.0)),
            Motion::Act(Action::once(8.0, 9.0)),
            Motion::Act(Action { strokes: 2, ..Action::once(8.0, 12.0) }),
            Motion::Level,
        ] {
            let poured = match motion {
                Motion::Act(action) => stepped.step(action),
                Motion::Level => stepped.level(),
                Motion::Settle => Poured { duration_s: stepped.settle(), ..Poured::default() },
            };
            let plan = spoon.plan(pitch_deg, motion);
            pitch_deg = plan.pitch_deg;
            let mut departed = Vec::new();
            let mut duration_s = 0.0;
            let mut collect = |driven: &mut Dispenser, part: usize, substep| {
                let gone = driven.grains.take_departed(&Shape::Bowl(driven.bowl));
                departed.extend(gone.into_iter().map(|it| Departed {
                    part: part as u32,
                    substep,
                    id: it.id,
                    x: [it.x[0], it.x[1], it.x[2]],
                    v: [it.v[0], it.v[1], it.v[2]],
                }));
            };
            for (place, part) in plan.parts.iter().enumerate() {
                for (k, body) in part.body.iter().enumerate() {
                    driven.drive(&[*body]);
                    if k as u32 % spoon.slice == spoon.slice - 1 {
                        collect(&mut driven, place, Some(k as u32));
                    }
                }
                let (mut spent, mut calm) = (0, 0);
                while spent < part.rest_max && calm < spoon.quiet {
                    driven.drive(&[part.standing; 8]);
                    collect(&mut driven, place, None);
                    spent += spoon.slice;
                    let still = driven.grains.speeds().0 < spoon.rest_speed;
                    calm = if still { calm + spoon.slice } else { 0 };
                }
                duration_s += part.duration_s + f64::from(spent) * spoon.substep_s;
            }
            let settles = matches!(motion, Motion::Settle);
            let [vial, spilled] = if settles { [0.0; 2] } else { spoon.landed(&plan, &departed) };
            assert!((poured.vial_mg - vial * spoon.grain_mg).abs() < 1e-9);
            assert!((poured.spilled_mg - spilled * spoon.grain_mg).abs() < 1e-9);
            assert!((poured.duration_s - duration_s).abs() < 1e-9);
            assert_eq!(stepped.state(), driven.state());
            let seen = spoon.snapshot(&driven.state(), driven.snapshot().time_s);
            assert_eq!(seen, driven.snapshot());
        }
        assert!(stepped.vial_mg() > 0.0, "nothing was poured, so nothing was compared");
    }
}
