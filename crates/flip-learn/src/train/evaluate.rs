//! Accuracy of controllers: powders x targets x repeats, with the same doses for each controller.

use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::{derive, index_of};
use flip_core::stats::summary::{bootstrap_mean_interval, mean, sd};
use flip_policy::{Controller, ON_TARGET_MG};
use serde::{Deserialize, Serialize};

/// A controller and its name in tables.
#[derive(Debug, Clone, PartialEq)]
pub struct Contender {
    /// Name.
    pub name: String,
    /// The controller.
    pub controller: Controller,
}

/// A powder to weigh and its simulated twins; repeats cycle through them.
#[derive(Debug, Clone, PartialEq)]
pub struct Subject {
    /// Powder id.
    pub powder: String,
    /// Its parameter sets, at least one.
    pub sets: Vec<ParameterSet>,
}

/// Plan of an evaluation.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Controllers to compare.
    pub contenders: Vec<Contender>,
    /// Powders to weigh.
    pub subjects: Vec<Subject>,
    /// Targets, mg.
    pub targets_mg: Vec<f64>,
    /// Doses per contender, powder and target.
    pub repeats: u32,
    /// Seed of every dose, together with powder, target and repeat, so that all contenders get the
    /// same spoons.
    pub seed: u64,
}

/// Result of one weighing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Dose {
    /// True mass in the vial, mg.
    pub dispensed_mg: f64,
    /// Last reading, mg.
    pub reading_mg: f64,
    /// Number of steps with a shake.
    pub shakes: u32,
    /// Bench time, s.
    pub seconds: f64,
}

/// One dose of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// Contender.
    pub controller: String,
    /// Powder id.
    pub powder: String,
    /// Target, mg.
    pub target_mg: f64,
    /// Repeat, from 0.
    pub repeat: u32,
    /// Id of the parameter set.
    pub parameter_set: String,
    /// Its result.
    #[serde(flatten)]
    pub dose: Dose,
}

/// Results of one controller for one powder and target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Contender.
    pub controller: String,
    /// Powder id.
    pub powder: String,
    /// Target, mg.
    pub target_mg: f64,
    /// Number of doses.
    pub n: u32,
    /// Mean absolute error of the true mass, mg.
    pub mae_mg: f64,
    /// Standard deviation of the absolute error over the doses (n - 1), mg; 0 for one dose.
    pub sd_mg: f64,
    /// Mean signed error, mg; positive is too much.
    pub bias_mg: f64,
    /// Share of doses more than 1 mg above the target.
    pub over_share: f64,
    /// Share of doses below 0.5 mg: practically nothing was dispensed.
    pub zero_share: f64,
    /// Mean number of shakes.
    pub shakes_mean: f64,
    /// Mean bench time of a dose, s.
    pub seconds_mean: f64,
}

/// Results of one controller over all its doses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Contender.
    pub controller: String,
    /// Mean absolute error, mg.
    pub mae_mg: f64,
    /// 95 % interval of the mean absolute error: percentiles of 2000 bootstrap samples over the
    /// doses, mg.
    pub ci95: [f64; 2],
    /// Standard deviation of the absolute error over all doses, mg.
    pub sd_trials_mg: f64,
    /// Mean over powders and targets of the standard deviation within each, mg. It differs from the
    /// one above; published tables often print this one without saying so.
    pub sd_within_cells_mg: f64,
    /// Mean signed error, mg; positive is too much.
    pub bias_mg: f64,
    /// Share of doses more than 1 mg above the target.
    pub over_share: f64,
    /// Share of doses below 0.5 mg: practically nothing was dispensed.
    pub zero_share: f64,
    /// Mean number of shakes.
    pub shakes_mean: f64,
    /// Mean bench time of a dose, s.
    pub seconds_mean: f64,
}

/// The results of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Results by controller, powder and target, in the plan's order.
    pub rows: Vec<Row>,
    /// Results by controller.
    pub summary: Vec<Summary>,
    /// Every dose.
    pub trials: Vec<Trial>,
}

/// A weighing of an evaluation.
#[derive(Debug, Clone, Copy)]
pub struct Weighing<'a> {
    /// Who weighs.
    pub contender: &'a Contender,
    /// The powder.
    pub subject: &'a Subject,
    /// Its parameter set.
    pub set: &'a ParameterSet,
    /// Target, mg.
    pub target_mg: f64,
    /// Repeat, from 0.
    pub repeat: u32,
    /// Seed.
    pub seed: u64,
}

impl Plan {
    /// Its weighings, by contender, powder, target and repeat.
    pub fn weighings(&self) -> Vec<Weighing<'_>> {
        let mut weighings = Vec::new();
        for contender in &self.contenders {
            for subject in &self.subjects {
                for &target_mg in &self.targets_mg {
                    for repeat in 0..self.repeats {
                        let set = &subject.sets[repeat as usize % subject.sets.len()];
                        // Seeded by the dose's content, not by its place in the plan: extending the
                        // plan changes none of the existing doses.
                        let seed = derive(
                            self.seed,
                            &[index_of(&subject.powder), target_mg.to_bits(), repeat.into()],
                        );
                        let of = Weighing { contender, subject, set, target_mg, repeat, seed };
                        weighings.push(of);
                    }
                }
            }
        }
        weighings
    }
}

/// Weighs every dose of the plan.
///
/// `weigh` receives all weighings at once and returns their doses in the same order; it should be
/// the loop used for real weighings.
///
/// # Errors
/// Any error of `weigh`.
///
/// # Panics
/// `weigh` returns more or fewer doses than there are weighings.
pub fn evaluate<E>(
    plan: &Plan,
    weigh: impl FnOnce(&[Weighing<'_>]) -> Result<Vec<Dose>, E>,
) -> Result<Evaluation, E> {
    let weighings = plan.weighings();
    let doses = weigh(&weighings)?;
    assert_eq!(doses.len(), weighings.len(), "every weighing has one dose");
    let trial = |(of, dose): (&Weighing<'_>, Dose)| Trial {
        controller: of.contender.name.clone(),
        powder: of.subject.powder.clone(),
        target_mg: of.target_mg,
        repeat: of.repeat,
        parameter_set: of.set.id(),
        dose,
    };
    Ok(summarise(plan, weighings.iter().zip(doses).map(trial).collect()))
}

fn summarise(plan: &Plan, trials: Vec<Trial>) -> Evaluation {
    let cell = (plan.repeats as usize).max(1);
    let rows: Vec<Row> = trials.chunks(cell).map(row).collect();
    let per_contender = (cell * plan.subjects.len() * plan.targets_mg.len()).max(1);
    let cells = (per_contender / cell).max(1);
    let summary = trials
        .chunks(per_contender)
        .zip(rows.chunks(cells))
        .map(|(trials, rows)| {
            let errors: Vec<f64> = trials.iter().map(|t| error_mg(t).abs()).collect();
            // The doses of one controller form a row over everything.
            let all = row(trials);
            Summary {
                controller: all.controller,
                mae_mg: all.mae_mg,
                ci95: bootstrap_mean_interval(&errors, 0.95, RESAMPLES, plan.seed)
                    .unwrap_or([0.0; 2]),
                sd_trials_mg: all.sd_mg,
                sd_within_cells_mg: mean(&rows.iter().map(|row| row.sd_mg).collect::<Vec<_>>())
                    .unwrap_or(0.0),
                bias_mg: all.bias_mg,
                over_share: all.over_share,
                zero_share: all.zero_share,
                shakes_mean: all.shakes_mean,
                seconds_mean: all.seconds_mean,
            }
        })
        .collect();
    Evaluation { rows, summary, trials }
}

/// Below this, practically nothing was dispensed, mg.
const NOTHING_MG: f64 = 0.5;

/// Number of bootstrap samples for an interval.
const RESAMPLES: usize = 2000;

fn row(trials: &[Trial]) -> Row {
    let signed: Vec<f64> = trials.iter().map(error_mg).collect();
    let errors: Vec<f64> = signed.iter().map(|e| e.abs()).collect();
    let mean_of =
        |of: fn(&Trial) -> f64| mean(&trials.iter().map(of).collect::<Vec<_>>()).unwrap_or(0.0);
    let share = |test: &dyn Fn(&Trial) -> bool| {
        trials.iter().filter(|t| test(t)).count() as f64 / trials.len() as f64
    };
    Row {
        controller: trials[0].controller.clone(),
        powder: trials[0].powder.clone(),
        target_mg: trials[0].target_mg,
        n: trials.len() as u32,
        mae_mg: mean(&errors).unwrap_or(0.0),
        sd_mg: sd(&errors).unwrap_or(0.0),
        bias_mg: mean(&signed).unwrap_or(0.0),
        over_share: share(&|t| error_mg(t) > ON_TARGET_MG),
        zero_share: share(&|t| t.dose.dispensed_mg < NOTHING_MG),
        shakes_mean: mean_of(|t| f64::from(t.dose.shakes)),
        seconds_mean: mean_of(|t| t.dose.seconds),
    }
}

fn error_mg(trial: &Trial) -> f64 {
    trial.dose.dispensed_mg - trial.target_mg
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_policy::ScheduledStep;

    fn plan() -> Plan {
        let contender = |name: &str| Contender {
            name: name.into(),
            controller: Controller::Fixed(ScheduledStep::FIXED),
        };
        let sets =
            vec![ParameterSet::default(), ParameterSet::default().with("friction", 0.7).unwrap()];
        let subject = |powder: &str| Subject { powder: powder.into(), sets: sets.clone() };
        Plan {
            contenders: vec![contender("a"), contender("b")],
            subjects: vec![subject("sand"), subject("salt")],
            targets_mg: vec![15.0, 20.0],
            repeats: 4,
            seed: 3,
        }
    }

    /// Errors of -1, 0, 1 and 2 mg by repeat; friction distinguishes the two sets.
    fn weigh(set: &ParameterSet, target_mg: f64, counter: f64) -> Dose {
        let dispensed_mg = target_mg + counter + if set.friction() > 0.6 { 1.0 } else { -1.0 };
        Dose { dispensed_mg, reading_mg: dispensed_mg.round(), shakes: 5, seconds: 9.0 }
    }

    #[test]
    fn rows_and_summaries_have_the_numbers_one_gets_by_hand() {
        let evaluation = weighed(&plan(), |set, target, _| weigh(set, target, 0.5));
        assert_eq!(
            (evaluation.rows.len(), evaluation.summary.len(), evaluation.trials.len()),
            (8, 2, 32)
        );
        // Errors alternate between -0.5 and 1.5 mg.
        let row = &evaluation.rows[5];
        assert_eq!(
            (row.controller.as_str(), row.powder.as_str(), row.target_mg, row.n),
            ("b", "sand", 20.0, 4)
        );
        assert_eq!(
            (row.mae_mg, row.bias_mg, row.over_share, row.zero_share, row.shakes_mean),
            (1.0, 0.5, 0.5, 0.0, 5.0)
        );
        assert!((row.sd_mg - (1.0f64 / 3.0).sqrt()).abs() < 1e-12);
        let summary = &evaluation.summary[0];
        let all = (
            summary.bias_mg,
            summary.over_share,
            summary.zero_share,
            summary.shakes_mean,
            summary.seconds_mean,
        );
        assert_eq!(all, (0.5, 0.5, 0.0, 5.0, 9.0));
        assert_eq!(row.seconds_mean, 9.0);
        assert!((summary.sd_within_cells_mg - (1.0f64 / 3.0).sqrt()).abs() < 1e-12);
        assert!((summary.sd_trials_mg - (16.0 * 0.25 / 15.0f64).sqrt()).abs() < 1e-12);
        // 16 errors of SD 0.5: the mean's standard error is 0.125, 95 % are about +-0.24.
        assert!(
            (0.6..=0.9).contains(&summary.ci95[0]) && (1.1..=1.4).contains(&summary.ci95[1]),
            "{:?}",
            summary.ci95
        );
    }

    /// The evaluation of `plan` with this dose of a set, a target and a seed.
    fn weighed(plan: &Plan, dose: impl Fn(&ParameterSet, f64, u64) -> Dose) -> Evaluation {
        let one = |of: &Weighing<'_>| dose(of.set, of.target_mg, of.seed);
        evaluate(plan, |all| Ok::<_, ()>(all.iter().map(one).collect())).unwrap()
    }

    #[test]
    fn contenders_meet_the_same_spoons() {
        let by_seed = |set: &_, target, seed| weigh(set, target, (seed % 1000) as f64 / 1000.0);
        let trials = weighed(&plan(), by_seed).trials;
        assert!(trials[..16].iter().zip(&trials[16..]).all(|(a, b)| a.dose == b.dose));
    }

    #[test]
    fn a_dose_meets_the_same_spoon_wherever_its_powder_and_target_stand_in_the_lists() {
        let by_seed = |set: &_, target, seed| weigh(set, target, (seed >> 11) as f64);
        let trials = |plan: Plan| weighed(&plan, by_seed).trials;
        let all = trials(plan());
        let salt = plan().subjects.remove(1);
        let few = trials(Plan { subjects: vec![salt], targets_mg: vec![20.0], ..plan() });
        assert_eq!(few.len(), 8);
        assert!(few.iter().all(|trial| all.contains(trial)));
        let masses: std::collections::BTreeSet<u64> =
            all.iter().map(|trial| trial.dose.dispensed_mg.to_bits()).collect();
        assert_eq!(masses.len(), 16, "each dose has a spoon of its own, met by both contenders");
    }

    #[test]
    fn an_error_of_the_bench_ends_the_evaluation() {
        let silent = "the balance is silent";
        assert_eq!(evaluate(&plan(), |_| Err(silent)), Err(silent));
    }
}
