//! A snapshot of the particles, small enough to stream to a viewer many times a second.

use super::constraints::Vector;
use super::grains::Grains;
use super::law::Law;
use std::fmt;
use std::sync::Arc;

/// Positions of all grains in the order of pouring, each coordinate in 65 536 steps of the longest
/// side of their bounding box.
#[derive(Debug, Clone, PartialEq)]
pub struct Snapshot {
    /// Simulated time, s.
    pub time_s: f64,
    /// Lowest corner of the box, mm.
    pub origin_mm: [f32; 3],
    /// Length of one step, mm.
    pub step_mm: f32,
    /// Ids of the grains (numbers in the order of pouring).
    pub ids: Vec<u32>,
    /// Centre, steps from the origin, and radius, steps.
    pub grains: Vec<[u16; 4]>,
}

/// Snapshot interval and receiver; called on the simulation thread, so the receiver must return
/// quickly.
#[derive(Clone)]
pub struct Camera {
    /// Simulated time between two snapshots, s.
    pub every_s: f64,
    /// Receives each snapshot.
    pub see: Arc<dyn Fn(Snapshot) + Send + Sync>,
}

impl fmt::Debug for Camera {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Camera").field("every_s", &self.every_s).finish_non_exhaustive()
    }
}

impl Camera {
    /// Whether a snapshot is due at this step.
    pub(super) fn is_due(&self, step: u32, step_s: f64) -> bool {
        step.is_multiple_of(((self.every_s / step_s).round() as u32).max(1))
    }

    /// Takes a snapshot if one is due at this substep.
    pub(super) fn look(&self, grains: &Grains, law: &Law, substep: u32) {
        if self.is_due(substep, law.substep_s) {
            let time_s = f64::from(substep) * law.substep_s;
            (self.see)(Snapshot::of(grains.ids(), grains.centres(), law.diameter_m, time_s));
        }
    }
}

impl Snapshot {
    /// Creates a snapshot of grains with these ids, centres and radii in grain diameters.
    pub(super) fn of(ids: &[u32], centres: &[Vector], diameter_m: f64, time_s: f64) -> Self {
        let mut all: Vec<_> = ids.iter().copied().zip(centres).collect();
        all.sort_unstable_by_key(|(id, _)| *id);
        let mm = (diameter_m * 1e3) as f32;
        let (mut low, mut high) = ([f32::MAX; 3], [f32::MIN; 3]);
        for (_, x) in &all {
            for k in 0..3 {
                low[k] = low[k].min(x[k]);
                high[k] = high[k].max(x[k]);
            }
        }
        let side = (0..3).fold(0.0, |side: f32, k| side.max(high[k] - low[k])).max(1.0);
        let step = side / f32::from(u16::MAX);
        let steps = |length: f32| (length / step).round() as u16;
        Self {
            time_s,
            origin_mm: if all.is_empty() { [0.0; 3] } else { low.map(|x| x * mm) },
            step_mm: step * mm,
            ids: all.iter().map(|(id, _)| *id).collect(),
            grains: all
                .iter()
                .map(|(_, x)| {
                    [steps(x[0] - low[0]), steps(x[1] - low[1]), steps(x[2] - low[2]), steps(x[3])]
                })
                .collect(),
        }
    }

    /// Centre of the grain at an index, mm.
    pub fn centre_mm(&self, place: usize) -> [f32; 3] {
        std::array::from_fn(|k| self.origin_mm[k] + f32::from(self.grains[place][k]) * self.step_mm)
    }

    /// Radius of the grain at an index, mm.
    pub fn radius_mm(&self, place: usize) -> f32 {
        f32::from(self.grains[place][3]) * self.step_mm
    }

    /// Serialises, little-endian: `FLP1`, count (u32), time (f64), origin (3 f32), step (f32), then
    /// per grain id (u32), centre and radius (4 u16).
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(32 + 12 * self.ids.len());
        bytes.extend(b"FLP1");
        bytes.extend((self.ids.len() as u32).to_le_bytes());
        bytes.extend(self.time_s.to_le_bytes());
        self.origin_mm.iter().chain([&self.step_mm]).for_each(|x| bytes.extend(x.to_le_bytes()));
        for (id, grain) in self.ids.iter().zip(&self.grains) {
            bytes.extend(id.to_le_bytes());
            grain.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::repose::{Settings, pile, repose};
    use flip_core::domain::parameters::ParameterSet;
    use std::sync::Mutex;

    #[test]
    fn snapshots_come_at_their_pace_hold_every_grain_to_a_step_and_change_nothing() {
        let settings = Settings::with_particles(300);
        let set = ParameterSet::default();
        let seen = Arc::new(Mutex::new(Vec::new()));
        let camera = {
            let seen = Arc::clone(&seen);
            Camera {
                every_s: 0.02,
                see: Arc::new(move |snapshot| seen.lock().unwrap().push(snapshot)),
            }
        };
        let filmed = pile(&set, &settings, 3, Some(camera)).unwrap();
        assert_eq!(filmed.repose, repose(&set, &settings, 3).unwrap());
        let seen = seen.lock().unwrap();
        assert!(
            seen.len() > 10
                && seen.windows(2).all(|w| (w[1].time_s - w[0].time_s - 0.02).abs() < 1e-9)
        );
        let last = &filmed.snapshot;
        assert_eq!(last.ids.len(), filmed.repose.particles_on_base as usize);
        assert!(last.ids.windows(2).all(|w| w[0] < w[1]));
        let top = (0..last.ids.len())
            .map(|k| last.centre_mm(k)[2] + last.radius_mm(k))
            .fold(0.0, f32::max);
        let base_mm = settings.base_radius_diameters * set.particle_diameter_mm();
        let tip = (f64::from(top) / base_mm).atan().to_degrees();
        assert!((tip - filmed.repose.tip_deg).abs() < 0.02, "{tip}");
        assert_eq!(last.to_bytes().len(), 32 + 12 * last.ids.len());
        assert_eq!(last.to_bytes()[..4], *b"FLP1");
    }
}
