//! From the nine parameters to the kernel's dimensionless strengths: one documented law each.

use super::constraints::Contact;
use super::mechanisms::{Extensions, Mechanisms, Site};
use flip_core::domain::parameters::ParameterSet;

/// Standard gravity, m/s^2.
pub const GRAVITY: f64 = 9.81;
/// Substep, s. Overlaps shrink with its square: a heap of 2000 grains has 0.3 % of d on average.
pub const SUBSTEP_S: f64 = 0.000_08;
/// Share of an overlap that one substep removes, both sides together.
const RELAX_NORMAL: f64 = 0.3;
/// Share of a tangential stretch that one substep removes, both sides together. Together with the
/// normal share it determines whether the one Jacobi iteration of a substep is stable in a dense
/// packing: at 0.2 cohesive heaps tremble and creep, at 0.1 none does.
const RELAX_TANGENTIAL: f64 = 0.1;
/// Share of the approach velocity of two isolated grains that one substep removes. Near the
/// critical 2 (sqrt(k) - k) = 0.5: impacts are inelastic.
const DAMP_NORMAL: f64 = 0.5;
/// Share of the slip velocity of two isolated grains that one substep removes.
const DAMP_TANGENTIAL: f64 = 0.2;
/// Factor at walls. A wall does not yield: the same share on one side alone would make stiff grains
/// ring between wall and neighbours.
const RELAX_WALL: f64 = 0.6;
/// Share of the approach velocity that one substep removes at a wall, before the factor above.
const DAMP_WALL: f64 = 0.8;

/// Coulomb coefficient at `friction` 0: grains in air are never frictionless, and a heap needs a
/// start.
pub const FRICTION_BASE: f64 = 0.06;
/// Coulomb coefficient per unit of `friction`. Grains here do not rotate, which by itself holds a
/// heap like strong rolling resistance; this map makes the published range 0-1.3 span 25 to 45 deg
/// without any attraction.
pub const FRICTION_PER_UNIT: f64 = 0.2;
/// Attraction over reference weight per unit of `cohesion`.
pub const BOND_PER_COHESION: f64 = 0.4;
/// Attraction over reference weight per unit of `adhesion * particle_adhesion_scale`, between
/// grains.
pub const BOND_PER_PARTICLE_ADHESION: f64 = 0.1;
/// Attraction over reference weight per unit of `adhesion`, between grain and wall.
pub const BOND_PER_WALL_ADHESION: f64 = 1.0;
/// Diameter at which the attractions above hold, mm: the middle of the published range.
pub const DIAMETER_REFERENCE_MM: f64 = 0.27;
/// Gap at which attraction ends, in diameters, at `adhesion_offset_scale` 0.
pub const REACH_BASE: f64 = 0.05;
/// Widening of that gap per unit of `adhesion_offset_scale`, diameters: 0.05 at the upper published
/// bound.
pub const REACH_PER_OFFSET_SCALE: f64 = 1000.0;

/// A powder in the kernel's terms. Lengths in grain diameters, time in substeps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Law {
    /// Magnitude of gravity, diameters per substep squared.
    pub gravity: f32,
    /// Factor on every velocity, per substep.
    pub drag: f32,
    /// Contacts between grains.
    pub grain: Contact,
    /// Contacts between a grain and a wall.
    pub wall: Contact,
    /// Mechanisms not in the base simulator.
    pub mechanisms: Mechanisms,
    /// Whether the kernel runs the mechanisms.
    pub extended: bool,
    /// Grain diameter, m.
    pub diameter_m: f64,
    /// Substep, s.
    pub substep_s: f64,
}

impl Law {
    /// The law of a parameter set against a wall of Coulomb coefficient `wall_friction`.
    ///
    /// ```text
    /// d    = particle_diameter                         grain diameter
    /// g    = gravity_scale * 9.81 m/s^2
    /// v   <- v (1 - damping * h)                       every substep h
    /// mu   = 0.06 + 0.2 friction                       between grains
    /// Bo   = (0.4 cohesion + 0.1 adhesion * particle_adhesion_scale) (d_ref / d)^2       between grains
    /// Bo_w = 1.0 adhesion (d_ref / d)^2                grain to wall
    /// reach = (0.05 + 1000 adhesion_offset_scale) d    gap at which attraction ends
    /// ```
    ///
    /// Bo is attraction over the weight of a grain under *standard* gravity: gravity_scale changes
    /// the weight and not the attraction, so it acts as 1/Bo. Attraction between small bodies grows
    /// with their diameter and weight with its cube, hence the square. particle_mass does not
    /// appear: equal masses cancel, it only converts counts to mg.
    pub(super) fn new(set: &ParameterSet, wall_friction: f64, substep_s: f64) -> Self {
        let diameter_m = set.particle_diameter_mm() * 1e-3;
        let per_substep2 = substep_s * substep_s / diameter_m;
        let smallness = (DIAMETER_REFERENCE_MM / set.particle_diameter_mm()).powi(2);
        let weight = GRAVITY * per_substep2 * smallness;
        let bond = BOND_PER_COHESION * set.cohesion()
            + BOND_PER_PARTICLE_ADHESION * set.adhesion() * set.particle_adhesion_scale();
        let reach = (REACH_BASE + REACH_PER_OFFSET_SCALE * set.adhesion_offset_scale()) as f32;
        let bare = |side: f64, damping: f64, friction: f64| Contact {
            normal: (side * RELAX_NORMAL) as f32,
            tangential: (side * RELAX_TANGENTIAL) as f32,
            normal_damping: (side * damping) as f32,
            tangential_damping: (side * DAMP_TANGENTIAL) as f32,
            friction: friction as f32,
            attraction: 0.0,
            onset: 0.0,
            reach,
        };
        let grain = bare(0.5, DAMP_NORMAL, FRICTION_BASE + FRICTION_PER_UNIT * set.friction());
        let grain = grain.attracted((bond * weight) as f32);
        let wall = bare(RELAX_WALL, DAMP_WALL, wall_friction);
        let wall = wall.attracted((BOND_PER_WALL_ADHESION * set.adhesion() * weight) as f32);
        Self {
            gravity: (set.gravity_scale() * GRAVITY * per_substep2) as f32,
            drag: (1.0 - set.damping() * substep_s) as f32,
            grain,
            wall,
            mechanisms: Mechanisms::default(),
            extended: false,
            diameter_m,
            substep_s,
        }
    }

    /// The same law with mechanisms added to the base simulator.
    ///
    /// Rotating grains yield in their contacts: the contact point of a solid sphere has 1 + 5/2
    /// times the compliance of a non-rotating grain, and the tangential shares shrink by the same
    /// factor, so that the one iteration stays stable.
    pub(super) fn extended(self, extensions: &Extensions, set: &ParameterSet, site: Site) -> Self {
        let ease = 1.0 / (1.0 + 2.5 * extensions.rotation as f32);
        let eased = |contact: Contact| Contact {
            tangential: contact.tangential * ease,
            tangential_damping: contact.tangential_damping * ease,
            ..contact
        };
        let (grain, wall) = (eased(self.grain), eased(self.wall));
        let bond = (GRAVITY * self.substep_s * self.substep_s / self.diameter_m
            * (DIAMETER_REFERENCE_MM / set.particle_diameter_mm()).powi(2))
            as f32;
        let mechanisms =
            Mechanisms::new(extensions, set, bond, grain.tangential, self.substep_s, site);
        Self { grain, wall, mechanisms, extended: !extensions.is_none(), ..self }
    }

    /// Converts a speed in diameters per substep to m/s.
    pub(super) fn speed_m_s(&self, speed: f32) -> f64 {
        f64::from(speed) * self.diameter_m / self.substep_s
    }

    /// Number of substeps in a time, rounded to the nearest.
    pub(super) fn substeps(&self, seconds: f64) -> u32 {
        (seconds / self.substep_s).round() as u32
    }
}
