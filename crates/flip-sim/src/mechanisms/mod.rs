//! Mechanisms not in the base simulator, one per file, each with an amplitude that is zero by
//! default.
//!
//! A mechanism acts through one hook per kind of event ([`Mechanism`]): a step of the frame, a
//! grain's predicted velocity, a pair of grains, a contact with a wall. To add one, create its
//! file, a field of [`Extensions`], a field of [`Mechanisms`] and its place in `each!`; and what a
//! solver outside this crate has to know of it ([`outside::Mechanisms`]).
//!
//! With every amplitude at zero the kernel is compiled without any of this. Results would be the
//! same: at zero amplitude each hook is the bitwise identity, which `sim/mechanisms/tests.rs`
//! checks by running the kernel with the hooks and all amplitudes zero.

mod air;
mod bridges;
mod charge;
mod consolidation;
mod film;
mod rolling;
mod sizes;
mod vibration;

#[cfg(test)]
mod tests;

use super::constraints::{V3, Vector};
use super::dispense::outside;
use super::lanes::{Lanes, Mask, WIDTH};
use flip_core::domain::conditions::Patch;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// Amplitudes of the mechanisms; all zero is the base simulator, bit for bit.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Extensions {
    /// Freedom of grains to rotate: 0 none, 1 as for solid spheres.
    #[serde(skip_serializing_if = "is_zero")]
    pub rotation: f64,
    /// Rolling friction: largest rolling torque over normal force and radius. Acts only on grains
    /// that rotate.
    #[serde(skip_serializing_if = "is_zero")]
    pub rolling_friction: f64,
    /// Standard deviation of the logarithm of the radii.
    #[serde(skip_serializing_if = "is_zero")]
    pub size_spread: f64,
    /// Bond number gained by an ageing contact; half of it is reached after 0.1 s.
    #[serde(skip_serializing_if = "is_zero")]
    pub consolidation: f64,
    /// Water in the powder: 0 dry, 1 bridges of bond number 2 that reach 0.1 d.
    #[serde(skip_serializing_if = "is_zero")]
    pub humidity: f64,
    /// Bond number of grains to the spoon, in addition to the effect of `adhesion`.
    #[serde(skip_serializing_if = "is_zero")]
    pub spoon_adhesion: f64,
    /// Share of the grains that stay on the spoon once they touch it.
    #[serde(skip_serializing_if = "is_zero")]
    pub hold_up: f64,
    /// Peak acceleration of a vertical vibration of the base or the spoon, in g.
    #[serde(skip_serializing_if = "is_zero")]
    pub vibration_g: f64,
    /// Bond number of grains to walls due to charge, at contact.
    #[serde(skip_serializing_if = "is_zero")]
    pub charge: f64,
    /// Viscosity of the air relative to 20 deg C; 1 is air, 0 is vacuum.
    #[serde(skip_serializing_if = "is_zero")]
    pub air: f64,
}

#[allow(clippy::trivially_copy_pass_by_ref)] // serde hands a reference.
fn is_zero(amplitude: &f64) -> bool {
    *amplitude == 0.0
}

impl Extensions {
    /// All mechanisms: name, amplitude and largest sensible amplitude.
    pub fn amplitudes(&mut self) -> [(&'static str, &mut f64, f64); 10] {
        [
            ("rotation", &mut self.rotation, 1.0),
            ("rolling_friction", &mut self.rolling_friction, 1.0),
            ("size_spread", &mut self.size_spread, 0.3),
            ("consolidation", &mut self.consolidation, 10.0),
            ("humidity", &mut self.humidity, 1.0),
            ("spoon_adhesion", &mut self.spoon_adhesion, 10.0),
            ("hold_up", &mut self.hold_up, 1.0),
            ("vibration_g", &mut self.vibration_g, 5.0),
            ("charge", &mut self.charge, 10.0),
            ("air", &mut self.air, 10.0),
        ]
    }

    /// Sets the amplitude of the mechanism called `name`.
    ///
    /// # Errors
    /// An unknown name, or an amplitude outside its bounds.
    pub fn with(mut self, name: &str, amplitude: f64) -> Result<Self, FieldError> {
        let mut all = self.amplitudes();
        let names = all.iter().map(|(name, ..)| *name).collect::<Vec<_>>().join(", ");
        let Some((_, slot, upper)) = all.iter_mut().find(|(known, ..)| *known == name) else {
            let message = format!("there is no extension `{name}`; the extensions are {names}");
            return Err(FieldError::new("extension", message));
        };
        **slot = bounded(name, amplitude, 0.0, *upper, "")?;
        Ok(self)
    }

    /// Adds the amplitudes due to conditions, each capped at the largest sensible one.
    ///
    /// # Errors
    /// An unknown name.
    pub fn patched(mut self, patch: &Patch) -> Result<Self, FieldError> {
        for (name, more) in &patch.amplitudes {
            let (now, upper) = match self.amplitudes().into_iter().find(|(known, ..)| known == name)
            {
                Some((_, now, upper)) => (*now, upper),
                None => (0.0, 0.0),
            };
            self = self.with(name, (now + more).min(upper))?;
        }
        Ok(self)
    }

    /// Whether every amplitude is zero.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// Kind of walls in a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Site {
    /// The base of a heap.
    Base,
    /// A spoon.
    Spoon,
}

pub(super) use consolidation::AGE;

/// Numbers in a pair's memory.
pub(super) const SLOTS: usize = 5;
/// Memory of sixteen pairs in addition to their anchors: rolling stretch (three), age, and whether
/// a liquid bridge spans them.
pub(super) type Memory = [[f32; WIDTH]; SLOTS];

/// Sixteen pairs as seen by the hooks. Lengths in grain diameters, time in substeps, masses
/// relative to a mean grain; forces and torques act on the first grain, with opposite ones on the
/// second.
pub(super) struct Pair<'a, L> {
    /// Distance between the surfaces, beyond the onset of contact.
    pub gap: L,
    /// Radii of both.
    pub radii: [L; 2],
    /// Effective diameter, `4 r_1 r_2 / (r_1 + r_2)`: attraction grows with it.
    pub effective: L,
    /// Twice the reduced mass, `2 m_1 m_2 / (m_1 + m_2)`: 1 for grains of the mean size.
    pub reduced_mass: L,
    /// Lanes in contact.
    pub touch: Mask,
    /// Push along the normal in contact.
    pub push: L,
    /// Spin of the first grain minus that of the second, radians per substep.
    pub turning: V3<L>,
    /// Memory of the pairs; zero when they meet. The first three numbers are a vector from one
    /// grain to the other.
    pub memory: &'a mut Memory,
    /// Lanes that keep their memory without touching.
    pub linked: &'a mut Mask,
    /// Attraction added by the mechanisms.
    pub pull: L,
    /// Torque on the first grain.
    pub torque: V3<L>,
}

/// Sixteen contacts with a wall as seen by the hooks; units as in [`Pair`], but with accelerations
/// instead of forces.
pub(super) struct AtWall<'a, L> {
    /// Distance between the surfaces.
    pub gap: L,
    /// The grain's radius.
    pub radius: L,
    /// Acceleration of the grain per unit of force.
    pub lightness: L,
    /// Lanes in contact.
    pub touch: Mask,
    /// Push along the normal in contact.
    pub push: L,
    /// Spin, radians per substep.
    pub spin: V3<L>,
    /// Rolling stretch.
    pub stretch: &'a mut V3<L>,
    /// 1 for a grain that stays on a spoon.
    pub clings: L,
    /// Attraction added by the mechanisms.
    pub pull: L,
    /// Torque on the grain over its mass.
    pub torque: V3<L>,
}

/// One hook per kind of event. The default does nothing, and at zero amplitude a hook must be the
/// bitwise identity.
#[allow(clippy::inline_always)] // See `lanes`.
pub(super) trait Mechanism {
    /// Upward acceleration added by the frame at a substep, diameters per substep squared.
    #[inline(always)]
    fn step(&self, _substep: u32) -> f32 {
        0.0
    }
    /// Modifies the predicted velocity of sixteen grains of these radii.
    #[inline(always)]
    fn grain<L: Lanes>(&self, u: V3<L>, _radius: L) -> V3<L> {
        u
    }
    /// Acts on sixteen pairs of grains, near or in contact.
    #[inline(always)]
    fn pair<L: Lanes>(&self, _pair: &mut Pair<L>) {}
    /// Acts on sixteen grains near a wall or in contact with it.
    #[inline(always)]
    fn wall<L: Lanes>(&self, _contact: &mut AtWall<L>) {}
}

/// The mechanisms in the kernel's units.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Mechanisms {
    /// Share of a solid sphere's freedom to rotate.
    pub freedom: f32,
    pub sizes: sizes::Sizes,
    pub film: film::Film,
    rolling: rolling::Rolling,
    consolidation: consolidation::Consolidation,
    bridges: bridges::Bridges,
    vibration: vibration::Vibration,
    charge: charge::Charge,
    air: air::Air,
}

/// Inputs from which mechanisms are built.
struct Scene<'a> {
    set: &'a ParameterSet,
    /// The weight of a grain of the reference diameter under standard gravity, as an acceleration:
    /// a bond number of 1.
    bond: f32,
    /// Largest share of a rolling stretch that one substep may remove from one side.
    grip: f32,
    substep_s: f64,
    site: Site,
}

/// Calls a hook of every mechanism, in this order.
macro_rules! each {
    ($mechanisms:ident . $hook:ident ($($argument:expr),*)) => {
        $mechanisms.rolling.$hook($($argument),*);
        $mechanisms.consolidation.$hook($($argument),*);
        $mechanisms.bridges.$hook($($argument),*);
        $mechanisms.film.$hook($($argument),*);
        $mechanisms.charge.$hook($($argument),*);
    };
}

impl Mechanisms {
    /// `bond` and `grip` are as in [`Scene`].
    pub(super) fn new(
        extensions: &Extensions,
        set: &ParameterSet,
        bond: f32,
        grip: f32,
        substep_s: f64,
        site: Site,
    ) -> Self {
        let scene = Scene { set, bond, grip, substep_s, site };
        Self {
            freedom: extensions.rotation as f32,
            sizes: sizes::Sizes::new(extensions),
            film: film::Film::new(extensions, &scene),
            rolling: rolling::Rolling::new(extensions, &scene),
            consolidation: consolidation::Consolidation::new(extensions, &scene),
            bridges: bridges::Bridges::new(extensions, &scene),
            vibration: vibration::Vibration::new(extensions, &scene),
            charge: charge::Charge::new(extensions, &scene),
            air: air::Air::new(extensions, &scene),
        }
    }

    /// What a solver outside this crate has to know of them. Takes every field apart, so that none can
    /// be left out there in silence.
    pub(super) fn outside(&self) -> outside::Mechanisms {
        let Self { freedom, sizes, film, rolling, consolidation, bridges, vibration, charge, air } =
            self;
        let [rolling_friction, rolling_stiffness, rolling_damping] = rolling.numbers();
        let [film, cling, film_reach] = film.numbers();
        let [charge, charge_reach] = charge.numbers();
        let [ageing, ageing_half_life] = consolidation.numbers();
        let [bridge, bridge_rupture, bridge_inverse_length] = bridges.numbers();
        let [air, air_inertia] = air.numbers();
        let [vibration, vibration_pace] = vibration.numbers();
        outside::Mechanisms {
            freedom: *freedom,
            rolling_friction,
            rolling_stiffness,
            rolling_damping,
            film,
            cling,
            film_reach,
            charge,
            charge_reach,
            ageing,
            ageing_half_life,
            bridge,
            bridge_rupture,
            bridge_inverse_length,
            air,
            air_inertia,
            vibration: vibration as f32,
            vibration_pace,
            widest: sizes.widest(),
        }
    }

    /// Largest gap at which pairs interact, diameters.
    pub(super) fn pair_reach(&self) -> f32 {
        self.bridges.rupture
    }

    /// Largest gap at which walls interact, diameters.
    pub(super) fn wall_reach(&self) -> f32 {
        self.charge.reach()
    }

    /// Adds the frame's contribution to the acceleration at a substep.
    pub(super) fn step(&self, acceleration: Vector, substep: u32) -> Vector {
        let [x, y, z, w] = acceleration;
        [x, y, z - (0.0 - self.vibration.step(substep)), w]
    }

    #[allow(clippy::inline_always)] // See `lanes`.
    #[inline(always)]
    pub(super) fn grain<L: Lanes>(&self, u: V3<L>, radius: L) -> V3<L> {
        self.air.grain(u, radius)
    }

    #[allow(clippy::inline_always)] // See `lanes`.
    #[inline(always)]
    pub(super) fn pair<L: Lanes>(&self, pair: &mut Pair<L>) {
        each!(self.pair(pair));
    }

    #[allow(clippy::inline_always)] // See `lanes`.
    #[inline(always)]
    pub(super) fn wall<L: Lanes>(&self, contact: &mut AtWall<L>) {
        each!(self.wall(contact));
    }
}
