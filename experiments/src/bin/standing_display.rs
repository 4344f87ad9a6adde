//! The cost of a balance whose display stands still, and the cost of guarding against it for doses
//! on sound ones: `cargo experiment standing_display [doses] [seed] [first powder]`.
//!
//! The shipped rules dose 5, 10, 15 and 20 mg from spoons that follow a formula, and a tenth as
//! many from simulated ones, in thirty steps with a tolerance of 1 mg, each dose twice: on a sound
//! display, and on one that stands still from a step of the sound dose, drawn at random, to the
//! end. Three rules are tried: the display is believed; the mass a spoon should have dispensed
//! counts (`Limits::stands_still`, for displays that stand for minutes when all is well); and a sign of life is waited for (`Halt::Unproven`), which a sound display
//! gives. The output depends on the code and the seed alone.

use flip_bench::emulate::arm::{Flow, FormulaSpoon, GrainsSpoon, Spoon};
use flip_bench::weigh::forecast::{Fall, Forecast};
use flip_bench::weigh::guard::{Halt, Limits, Situation, guard};
use flip_core::domain::bench::{Action, PitchLimits, Reading};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_policy::{Controller, Ending, Episode, Observation, Paced, Rules};
use flip_sim::dispense;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

const RULES: Rules = Rules { steps_max: 30, ending: Ending::OnTarget, pitch: PitchLimits::WIDE };
const TARGETS_MG: [f64; 4] = [5.0, 10.0, 15.0, 20.0];
const TOLERANCE_MG: f64 = 1.0;
/// Name, chance that a display stands still, whether signs of life are waited for.
const TRIED: [(&str, f64, bool); 3] = [
    ("believed", 0.0, false),
    ("what should have fallen", 0.003, false),
    ("a sign of life", 0.0, true),
];
const POWDERS: [&str; 4] =
    ["salt", "a quarter to four times as much", "comes late", "simulated grains"];

const GRAINS: usize = 3;

/// A filled spoon with one of the powders.
fn filled(powder: usize, seed: u64) -> Box<dyn Spoon> {
    let mut rng = Pcg64Mcg::seed_from_u64(derive(seed, &[1]));
    let salt = Flow::default();
    let flow = match powder {
        0 => salt,
        1 => Flow {
            level_mg: salt.level_mg * f64::exp2(rng.random_range(-2.0..2.0)),
            onset_deg: rng.random_range(0.0..15.0),
            variation: rng.random_range(0.3..0.9),
            ..salt
        },
        2 => Flow {
            onset_deg: rng.random_range(20.0..45.0),
            onset_width_deg: 1.0,
            variation: 0.8,
            ..salt
        },
        _ => {
            let set = ParameterSet::from_unit(std::array::from_fn(|_| rng.random()));
            let settings =
                dispense::Settings { pitch: RULES.pitch, ..dispense::Settings::default() };
            let mut spoon = GrainsSpoon::new(&set, &settings, seed);
            spoon.refill();
            return Box::new(spoon);
        }
    };
    let mut spoon = FormulaSpoon::new(flow, seed);
    spoon.refill();
    Box::new(spoon)
}

/// The result of a dose.
struct Dosed {
    /// Mass in the vial, mg.
    vial_mg: f64,
    steps: u32,
    /// The step that first moved the display.
    moved: u32,
    /// Number of signs of life waited for.
    waits: u32,
}

/// A dose on a display that stands still from a step on; signs of life are waited for if it `asks`
/// for them.
fn dose(
    mut spoon: Box<dyn Spoon>,
    target_mg: f64,
    limits: &Limits,
    asks: bool,
    stands_from: Option<u32>,
) -> Dosed {
    let readability_mg = limits.readability_mg;
    let controller = Controller::Paced(Paced::CHOSEN);
    let mut dosing = controller.begin(&RULES, readability_mg);
    let (mut vial_mg, mut shown_mg, mut before_mg, mut last) = (0.0, 0.0, 0.0, Action::default());
    let mut falls: Vec<Fall> = Vec::new();
    let (mut moved, mut waits, mut unproven) = (u32::MAX, 0, 0);
    for steps in 0.. {
        let lives = stands_from.is_none_or(|from| steps < from);
        if lives {
            shown_mg = f64::round(vial_mg / readability_mg) * readability_mg;
        }
        if shown_mg > 0.0 {
            moved = moved.min(steps);
        }
        let shaken = last.executed_shake_mm() > 0.0;
        let pitch_deg = spoon.pitch_deg();
        if shaken {
            falls.push(Fall {
                pitch_deg,
                shake_mm: last.shake_mm,
                strokes: 1,
                mass_mg: shown_mg - before_mg,
            });
            unproven = if shown_mg == before_mg { unproven + 1 } else { 0 };
        }
        let seen = Observation { reading_mg: shown_mg, target_mg, pitch_deg };
        let stable = |mass_mg: f64| Reading { mass_mg, stable: true };
        let situation = Situation {
            target_mg,
            tolerance_upper_mg: TOLERANCE_MG,
            steps,
            seconds: 0.0,
            moved_s: 0.0,
            read_s: 0.0,
            pitch_deg,
            before: stable(before_mg),
            now: stable(shown_mg),
            shaken,
            falls: &falls,
            unproven: asks.then_some(unproven),
            is_felt: true,
        };
        let proposed = dosing.propose(&seen);
        let mut allowed = guard(limits, &situation, proposed);
        let dosed = Dosed { vial_mg, steps, moved, waits };
        if RULES.after(steps, &seen, readability_mg) == Episode::Terminated {
            return dosed;
        }
        if lives && matches!(allowed, Err(Halt::Unproven)) {
            (unproven, waits) = (0, waits + 1);
            allowed = guard(limits, &Situation { unproven: Some(0), ..situation }, proposed);
        }
        let action = match allowed {
            Ok(allowed) => allowed.action,
            Err(Halt::NotANumber | Halt::NotAnAction | Halt::Stale) => {
                unreachable!("nothing is wrong with it")
            }
            Err(_) => return dosed,
        };
        vial_mg += spoon.step(action).mass_mg;
        (before_mg, last) = (shown_mg, action);
    }
    unreachable!("a dose ends when its steps are spent")
}

/// Errors of doses, mg.
struct Errors(Vec<f64>);

impl Errors {
    fn share_pct(&self, is: impl Fn(f64) -> bool) -> f64 {
        100.0 * self.0.iter().filter(|error| is(**error)).count() as f64 / self.0.len() as f64
    }

    fn over_pct(&self) -> f64 {
        self.share_pct(|error| error > TOLERANCE_MG)
    }

    fn excess_mg(&self) -> f64 {
        self.0.iter().map(|error| (error - TOLERANCE_MG).max(0.0)).sum::<f64>()
            / self.0.len() as f64
    }
}

fn main() {
    let numbers: Vec<u64> = std::env::args().skip(1).filter_map(|text| text.parse().ok()).collect();
    let (doses, seed) =
        (numbers.first().copied().unwrap_or(600), numbers.get(1).copied().unwrap_or(1));
    println!(
        "{doses} doses a row; over and short by more than {TOLERANCE_MG} mg; excess: mean over doses of what lies beyond the tolerance\n"
    );
    println!(
        "| powder | display mg | rule | sound: over | short | mean absolute error mg | waits a dose | stands after it moved: doses | over | excess mg | before: over | excess mg |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let first = numbers.get(2).copied().unwrap_or(1) as usize;
    for (powder, name) in POWDERS.into_iter().enumerate().skip(first.saturating_sub(1)) {
        // With real grains a dose takes seconds.
        let doses = if powder == GRAINS { doses.div_ceil(10) } else { doses };
        for readability_mg in [1.0, 0.1] {
            for (rule, stands_still, asks) in TRIED {
                let forecast = Some(Forecast::GENERIC);
                let limits = Limits {
                    readability_mg,
                    forecast,
                    stands_still,
                    ..Limits::new(RULES.pitch, RULES.steps_max)
                };
                let both = (0..doses).into_par_iter().map(|k| {
                    let seed = derive(seed, &[powder as u64, k]);
                    let target_mg = TARGETS_MG[k as usize % TARGETS_MG.len()];
                    let sound = dose(filled(powder, seed), target_mg, &limits, asks, None);
                    let from = (derive(seed, &[2]) % u64::from(sound.steps.max(1))) as u32;
                    let standing = dose(filled(powder, seed), target_mg, &limits, asks, Some(from));
                    let has_moved = from > sound.moved;
                    (
                        sound.vial_mg - target_mg,
                        sound.waits,
                        has_moved,
                        standing.vial_mg - target_mg,
                    )
                });
                let all: Vec<(f64, u32, bool, f64)> = both.collect();
                let sound = Errors(all.iter().map(|dose| dose.0).collect());
                let waits = f64::from(all.iter().map(|dose| dose.1).sum::<u32>()) / doses as f64;
                let [late, early] = [true, false].map(|has_moved| {
                    Errors(
                        all.iter().filter(|dose| dose.2 == has_moved).map(|dose| dose.3).collect(),
                    )
                });
                let absolute_mg =
                    sound.0.iter().map(|error| error.abs()).sum::<f64>() / doses as f64;
                println!(
                    "| {name} | {readability_mg} | {rule} | {:.1} % | {:.1} % | {absolute_mg:.2} | {waits:.1} | {} | {:.0} % | {:.1} | {:.0} % | {:.1} |",
                    sound.over_pct(),
                    sound.share_pct(|error| error < -TOLERANCE_MG),
                    late.0.len(),
                    late.over_pct(),
                    late.excess_mg(),
                    early.over_pct(),
                    early.excess_mg()
                );
            }
        }
    }
}
