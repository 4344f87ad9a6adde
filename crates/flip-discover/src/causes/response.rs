//! What the simulator predicts for each cause: the mechanism through which it acts on grains, how
//! far that moves a heap's angle, and which powders it moves most.
//!
//! | cause | mechanism of the simulator | amplitude |
//! |---|---|---|
//! | `humidity`, `deliquescence` | `humidity`: liquid bridges | water, 0 to 1 |
//! | `rest_time`, `humid_ageing`, `container_age` | `consolidation`: contacts that gain strength | bond number |
//! | `charge` | `charge`: attraction to walls | bond number |
//! | `vibration` | `vibration_g`: a base that shakes | g |
//! | `batch` | `size_spread` | SD of the logarithm of the radii |
//! | `temperature` | `cohesion`, one of the nine parameters | its unit |
//! | `funnel_height` | the height of the opening over the apex | grain diameters |
//! | `base_friction` | Coulomb coefficient of the base | 1 |
//!
//! `method_bias`, `operator` and `order` belong to the laboratory, not the grains: they move every
//! powder alike.
//!
//! The table compares angles of simulated heaps with and without each mechanism, with the same
//! seed: shifts on average over 28 random parameter sets that pile at 22 to 50 deg, as lines over
//! the angle. Sets of the same angle differ by 2 to 5 deg among themselves (SD, including some 1.5
//! deg from seeds), which is why powders have deviations of their own. Printed by
//! `cargo experiment simulated_responses fit` from `docs/simulated_responses.jsonl`.

use super::catalogue::Mechanism;
use super::hook::Hook;
use crate::data::campaign::Campaign;
use flip_core::stats::summary::mean;
use std::collections::BTreeMap;

/// Angle at which shifts are given, degrees.
const MIDDLE_DEG: f64 = 36.0;
/// Slopes are per this many degrees.
const SLOPE_DEG: f64 = 10.0;
/// A powder that hardly moves by the line may still move this much.
const SHARE_MIN: f64 = 0.25;

/// A number of the simulator through which causes act, and how far it moves a heap.
#[derive(Debug)]
pub(crate) struct Action {
    /// Name in reports and in the simulator.
    pub(crate) name: &'static str,
    pub(crate) unit: &'static str,
    hook: fn(String) -> Hook,
    /// Amplitude, shift at 36 deg, change of the shift per 10 deg.
    shifts: [[f64; 3]; 3],
}

const HUMIDITY: Action = Action {
    name: "humidity",
    unit: "1",
    hook: Hook::Extension,
    shifts: [[0.1, 2.70, 0.58], [0.3, 9.10, 1.64], [0.8, 16.60, -1.33]],
};
const CONSOLIDATION: Action = Action {
    name: "consolidation",
    unit: "bond number",
    hook: Hook::Extension,
    shifts: [[0.3, 0.79, 0.74], [1.0, 2.83, 0.82], [3.0, 9.96, 0.73]],
};
const CHARGE: Action = Action {
    name: "charge",
    unit: "bond number",
    hook: Hook::Extension,
    shifts: [[1.0, -0.13, -0.85], [3.0, 0.74, -0.83], [10.0, 1.87, -1.54]],
};
const VIBRATION: Action = Action {
    name: "vibration_g",
    unit: "g",
    hook: Hook::Extension,
    shifts: [[0.05, -0.63, -0.06], [0.1, -1.07, -1.72], [0.2, -4.07, -2.92]],
};
const SIZES: Action = Action {
    name: "size_spread",
    unit: "1",
    hook: Hook::Extension,
    shifts: [[0.1, -3.06, 0.10], [0.2, -3.68, -0.75], [0.3, -3.89, -1.58]],
};
const CLEARANCE: Action = Action {
    name: "funnel_clearance",
    unit: "grain diameters",
    hook: Hook::Heap,
    shifts: [[1.0, -0.94, -0.05], [2.0, -2.68, 0.60], [4.0, -9.39, -2.18]],
};
const BASE: Action = Action {
    name: "base_friction",
    unit: "1",
    hook: Hook::Heap,
    shifts: [[-0.1, -0.31, -0.23], [-0.25, -0.40, 0.19], [-0.45, -2.71, -0.05]],
};

impl Action {
    /// Cohesion, one of the nine parameters: it moves powders most evenly, so a departure that no
    /// cause explains is written down as a law on it.
    pub(crate) const COHESION: Self = Self {
        name: "cohesion",
        unit: "1",
        hook: Hook::Parameter,
        shifts: [[0.1, 0.91, 0.67], [0.3, 2.48, 0.51], [0.6, 4.95, 1.33]],
    };
    const ALL: [&Self; 8] = [
        &HUMIDITY,
        &CONSOLIDATION,
        &CHARGE,
        &VIBRATION,
        &SIZES,
        &Self::COHESION,
        &CLEARANCE,
        &BASE,
    ];

    /// The number through which a mechanism acts; `None` for causes of the laboratory, which affect
    /// readings.
    pub(crate) fn of(mechanism: Mechanism) -> Option<&'static Self> {
        match mechanism {
            Mechanism::Humidity | Mechanism::Deliquescence => Some(&HUMIDITY),
            Mechanism::RestTime | Mechanism::HumidAgeing | Mechanism::ContainerAge => {
                Some(&CONSOLIDATION)
            }
            Mechanism::Charge => Some(&CHARGE),
            Mechanism::Vibration => Some(&VIBRATION),
            Mechanism::Batch => Some(&SIZES),
            Mechanism::Temperature => Some(&Self::COHESION),
            Mechanism::FunnelHeight => Some(&CLEARANCE),
            Mechanism::BaseFriction => Some(&BASE),
            Mechanism::MethodBias | Mechanism::Operator | Mechanism::Order => None,
        }
    }

    /// Where it is in the simulator.
    pub(crate) fn hook(&self) -> Hook {
        (self.hook)(self.name.to_owned())
    }

    /// Direction in which it moves angles, up (1) or down (-1).
    pub(crate) fn direction(&self) -> f64 {
        self.shifts[2][1].signum()
    }

    /// The amplitude that moves the angle of an average powder by this much: linear between the
    /// simulated ones, extrapolated beyond them.
    pub(crate) fn amplitude(&self, effect_deg: f64) -> f64 {
        // The line from zero through the first amplitude that moves the angle as far, or else
        // through the one that moves it farthest.
        let far = self.shifts.iter().find(|it| it[1].abs() >= effect_deg.abs());
        let [amplitude, shift, _] = far.unwrap_or(&self.shifts[2]);
        effect_deg * amplitude / shift
    }

    /// How far it moves powders of these angles, relative to their root mean square. The largest
    /// amplitude is used: the noise of heaps makes the lines of the others less certain.
    fn shares(&self, angles: &[Option<f64>]) -> Vec<f64> {
        let [_, shift, slope] = self.shifts[2];
        let share = |angle: Option<f64>| {
            angle.map_or(1.0, |angle| {
                (1.0 + slope / shift * (angle - MIDDLE_DEG) / SLOPE_DEG).max(SHARE_MIN)
            })
        };
        let shares: Vec<f64> = angles.iter().map(|&angle| share(angle)).collect();
        let scale = (shares.iter().map(|share| share * share).sum::<f64>()
            / shares.len().max(1) as f64)
            .sqrt();
        shares.iter().map(|share| share / scale).collect()
    }
}

/// The simulator's response of each powder: how far each number of the simulator moves its angle,
/// relative to the average over powders. Empty: all alike.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Responses(BTreeMap<&'static str, Vec<f64>>);

impl Responses {
    /// All powders alike.
    pub fn new() -> Self {
        Self::default()
    }

    /// Of each powder, where known.
    pub(crate) fn of(&self, action: &Action) -> Option<&[f64]> {
        self.0.get(action.name).map(Vec::as_slice)
    }
}

/// How much more or less than average each mechanism moves each powder of a campaign, by the
/// powders' angles.
pub fn responses(campaign: &Campaign) -> Responses {
    let angle = |powder: usize| {
        let of = campaign.runs.iter().filter(|run| run.powder == powder);
        mean(&of.filter_map(|run| run.value).collect::<Vec<_>>())
    };
    let angles: Vec<Option<f64>> = (0..campaign.powders.len()).map(angle).collect();
    Responses(Action::ALL.map(|action| (action.name, action.shares(&angles))).into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Run;

    #[test]
    fn vibration_moves_steep_powders_most_and_charge_flat_ones() {
        let run =
            |powder: usize, angle: f64| Run { row: 0, powder, session: 0, value: Some(angle) };
        let campaign = Campaign {
            powders: ["sand", "bicarbonate", "lactose"].map(str::to_owned).to_vec(),
            runs: vec![run(0, 28.0), run(1, 42.0), run(1, 44.0)],
            ..Campaign::default()
        };
        let found = responses(&campaign);
        let [sand, bicarbonate, unmeasured] = *found.of(&VIBRATION).unwrap() else { panic!() };
        assert!(bicarbonate > 2.0 * sand && sand > 0.0 && unmeasured > sand);
        let charge = found.of(&CHARGE).unwrap();
        assert!(charge[0] > charge[1]);
        let squares: f64 = found.of(&HUMIDITY).unwrap().iter().map(|share| share * share).sum();
        assert!((squares / 3.0 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn amplitudes_are_those_of_the_table() {
        let humidity = Action::of(Mechanism::Humidity).unwrap();
        assert!(humidity.name == "humidity" && (humidity.amplitude(2.70) - 0.1).abs() < 1e-12);
        let vibration = Action::of(Mechanism::Vibration).unwrap();
        assert!((vibration.amplitude(-4.07) - 0.2).abs() < 1e-12 && vibration.unit == "g");
        assert_eq!((humidity.direction(), vibration.direction()), (1.0, -1.0));
        assert!(Action::of(Mechanism::MethodBias).is_none());
    }
}
