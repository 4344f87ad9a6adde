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
use super::hypothesis::Responses;
use crate::data::campaign::Campaign;
use flip_core::stats::summary::mean;

/// Angle at which shifts are given, degrees.
const MIDDLE_DEG: f64 = 36.0;
/// Slopes are per this many degrees.
const SLOPE_DEG: f64 = 10.0;
/// A powder that hardly moves by the line may still move this much.
const SHARE_MIN: f64 = 0.25;

/// Shifts of a mechanism: amplitude, shift at 36 deg, change of the shift per 10 deg.
struct Table {
    /// Name of the parameter in reports.
    name: &'static str,
    unit: &'static str,
    shifts: [[f64; 3]; 3],
}

const HUMIDITY: Table = Table {
    name: "humidity",
    unit: "1",
    shifts: [[0.1, 2.70, 0.58], [0.3, 9.10, 1.64], [0.8, 16.60, -1.33]],
};
const CONSOLIDATION: Table = Table {
    name: "consolidation",
    unit: "bond number",
    shifts: [[0.3, 0.79, 0.74], [1.0, 2.83, 0.82], [3.0, 9.96, 0.73]],
};
const CHARGE: Table = Table {
    name: "charge",
    unit: "bond number",
    shifts: [[1.0, -0.13, -0.85], [3.0, 0.74, -0.83], [10.0, 1.87, -1.54]],
};
const VIBRATION: Table = Table {
    name: "vibration_g",
    unit: "g",
    shifts: [[0.05, -0.63, -0.06], [0.1, -1.07, -1.72], [0.2, -4.07, -2.92]],
};
const SIZES: Table = Table {
    name: "size_spread",
    unit: "1",
    shifts: [[0.1, -3.06, 0.10], [0.2, -3.68, -0.75], [0.3, -3.89, -1.58]],
};
const COHESION: Table = Table {
    name: "cohesion",
    unit: "1",
    shifts: [[0.1, 0.91, 0.67], [0.3, 2.48, 0.51], [0.6, 4.95, 1.33]],
};
const CLEARANCE: Table = Table {
    name: "funnel_clearance",
    unit: "grain diameters",
    shifts: [[1.0, -0.94, -0.05], [2.0, -2.68, 0.60], [4.0, -9.39, -2.18]],
};
const BASE: Table = Table {
    name: "base_friction",
    unit: "1",
    shifts: [[-0.1, -0.31, -0.23], [-0.25, -0.40, 0.19], [-0.45, -2.71, -0.05]],
};

fn table(mechanism: Mechanism) -> Option<&'static Table> {
    match mechanism {
        Mechanism::Humidity | Mechanism::Deliquescence => Some(&HUMIDITY),
        Mechanism::RestTime | Mechanism::HumidAgeing | Mechanism::ContainerAge => {
            Some(&CONSOLIDATION)
        }
        Mechanism::Charge => Some(&CHARGE),
        Mechanism::Vibration => Some(&VIBRATION),
        Mechanism::Batch => Some(&SIZES),
        Mechanism::Temperature => Some(&COHESION),
        Mechanism::FunnelHeight => Some(&CLEARANCE),
        Mechanism::BaseFriction => Some(&BASE),
        Mechanism::MethodBias | Mechanism::Operator | Mechanism::Order => None,
    }
}

/// How much more or less than average each mechanism moves each powder of a campaign, by the
/// powders' angles.
///
/// The largest amplitude is used: the noise of heaps makes the lines of the others less certain.
pub fn responses(campaign: &Campaign) -> Responses {
    let angle = |powder: usize| {
        let of = campaign.runs.iter().filter(|run| run.powder == powder);
        mean(&of.filter_map(|run| run.repose_deg).collect::<Vec<_>>())
    };
    let angles: Vec<Option<f64>> = (0..campaign.powders.len()).map(angle).collect();
    let of = |mechanism: Mechanism| {
        let [_, shift, slope] = table(mechanism)?.shifts[2];
        let share = |angle: Option<f64>| {
            angle.map_or(1.0, |angle| {
                (1.0 + slope / shift * (angle - MIDDLE_DEG) / SLOPE_DEG).max(SHARE_MIN)
            })
        };
        let shares: Vec<f64> = angles.iter().map(|&angle| share(angle)).collect();
        let scale = (shares.iter().map(|share| share * share).sum::<f64>()
            / shares.len().max(1) as f64)
            .sqrt();
        Some((mechanism, shares.iter().map(|share| share / scale).collect()))
    };
    Mechanism::ALL.into_iter().filter_map(of).collect()
}

/// Where the simulator has a mechanism, and the direction in which it moves angles, up (1) or down
/// (-1). Causes of the laboratory affect readings.
pub(crate) fn hook(mechanism: Mechanism) -> (Hook, f64) {
    let Some(Table { name, shifts, .. }) = table(mechanism) else { return (Hook::Reading, 1.0) };
    let name = (*name).to_owned();
    let hook = match mechanism {
        Mechanism::Temperature => Hook::Parameter(name),
        Mechanism::FunnelHeight | Mechanism::BaseFriction => Hook::Heap(name),
        _ => Hook::Extension(name),
    };
    (hook, shifts[2][1].signum())
}

/// The mechanism's amplitude that moves the angle of an average powder by this much, with its name
/// and unit: linear between the simulated ones, extrapolated beyond them. `None` for causes that do
/// not act on the grains.
pub(crate) fn amplitude(
    mechanism: Mechanism,
    effect_deg: f64,
) -> Option<(&'static str, f64, &'static str)> {
    let Table { name, unit, shifts } = table(mechanism)?;
    // The line from zero through the first amplitude that moves the angle as far, or else through
    // the one that moves it farthest.
    let far = shifts.iter().find(|it| it[1].abs() >= effect_deg.abs()).unwrap_or(&shifts[2]);
    Some((name, effect_deg * far[0] / far[1], unit))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Run;

    #[test]
    fn vibration_moves_steep_powders_most_and_charge_flat_ones() {
        let run =
            |powder: usize, angle: f64| Run { row: 0, powder, session: 0, repose_deg: Some(angle) };
        let campaign = Campaign {
            powders: ["sand", "bicarbonate", "lactose"].map(str::to_owned).to_vec(),
            runs: vec![run(0, 28.0), run(1, 42.0), run(1, 44.0)],
            ..Campaign::default()
        };
        let found = responses(&campaign);
        let [sand, bicarbonate, unmeasured] = found[&Mechanism::Vibration][..] else { panic!() };
        assert!(bicarbonate > 2.0 * sand && sand > 0.0 && unmeasured > sand);
        assert!(found[&Mechanism::Charge][0] > found[&Mechanism::Charge][1]);
        let squares: f64 = found[&Mechanism::Humidity].iter().map(|share| share * share).sum();
        assert!((squares / 3.0 - 1.0).abs() < 1e-12 && !found.contains_key(&Mechanism::Operator));
    }

    #[test]
    fn amplitudes_are_those_of_the_table() {
        let (name, value, _) = amplitude(Mechanism::Humidity, 2.70).unwrap();
        assert!(name == "humidity" && (value - 0.1).abs() < 1e-12);
        let (_, value, unit) = amplitude(Mechanism::Vibration, -4.07).unwrap();
        assert!((value - 0.2).abs() < 1e-12 && unit == "g");
        assert!(amplitude(Mechanism::MethodBias, 1.0).is_none());
    }
}
