//! Effects hidden in data, and the requirement that the command find them: only the file goes in,
//! and the result is compared with the truth.
//!
//! ```text
//! truth       laboratories with a hidden cause, or none; shares nothing with the detector       trace_truth   the same of balance readings
//! grains      heaps of another kind of simulator: springs and dashpots, rotation, rolling resistance
//! heaps       campaigns of such heaps
//! solver      defects in a copy of the solver's settings, under the job that the command runs
//! own_doses   doses of FLIP's own benches, in which nothing can be wrong
//! judge       the command, and what its answer is worth
//! rates       M1 to M15 over many cases; report.rs prints them                                  trace_rates   M13
//! spoon_truth mechanisms hidden in the emulated laboratory's spoon                              spoon_rates   the table of them
//! campaigns   whole campaigns with simulated heaps and held-out gain, in the report alone
//! ```
//!
//! `cargo test --test discovery` hides a few, `make test-long` a few dozen, each with bounds on the
//! rates. `make discovery-report` hides hundreds and prints the table; it can be stopped and resumed.

mod heaps;
// The report uses more of it.
#[allow(dead_code)]
mod judge;
mod own_doses;
mod rates;
mod solver;
// The report uses more of it.
#[allow(dead_code)]
mod spoon_truth;
mod trace_rates;
mod trace_truth;
mod traces;
mod truth;

use flip_bench::emulate::hidden::{Hidden, Mechanism};
use flip_discover::report::Verdict;
use flip_discover::spoon::{Settings, SpoonCause};
use judge::Laboratory;
use rates::{
    LARGE_DEG, SIMULATIONS, Scored, scored, table, wanted, wanted_heaps, wanted_without_days,
};
use solver::Defect;
use spoon_truth::{Bench, Truth};
use truth::Family;

/// Nulls judged by the saboteur without days, at most; the real detector judges as many.
const RESTLESS: u64 = 8;

/// The score of a detector if only the verdict and the claim matter.
fn claimed(of: &Scored, found: bool, claim: Option<&str>) -> Scored {
    let is_right = claim == Some(of.family.as_str());
    Scored {
        is_found: found,
        claims: usize::from(claim.is_some()),
        false_claims: usize::from(claim.is_some() && !is_right),
        is_confident_and_right: is_right,
        ..of.clone()
    }
}

/// The requirements on a detector for the cases of the tests: few false alarms, most causes
/// claimed, hardly any wrongly.
///
/// Bounds are such that a detector with the suite's target rates fails once in some hundred times
/// (binomial): of 14 nulls at 5 % four or more are found with a chance of 0.004; of 12 causes at 85
/// % six or fewer are claimed with a chance of 0.005; of 12 at 5 % three or more wrongly with 0.02.
fn verdict(nulls: &[Scored], effects: &[Scored]) -> Result<(), String> {
    let alarms = nulls.iter().filter(|it| it.is_found).count();
    let right = effects.iter().filter(|it| it.is_confident_and_right).count();
    let wrong = effects.iter().filter(|it| it.false_claims > 0).count();
    match () {
        () if alarms > 3 => Err(format!("{alarms} false alarms of {}", nulls.len())),
        () if right < effects.len() / 2 => Err(format!("{right} of {} claimed", effects.len())),
        () if wrong > 2 => Err(format!("{wrong} of {} wrongly", effects.len())),
        () => Ok(()),
    }
}

/// One of each kind; `make test-long` hides many.
#[test]
fn a_hidden_cause_is_found_and_named_and_nothing_where_nothing_is() {
    let folder = tempfile::tempdir().unwrap();
    let kinds = [Family::NullPlain, Family::Humidity, Family::Operator];
    for of in scored(folder.path(), &wanted(&kinds, LARGE_DEG, 0..1), SIMULATIONS) {
        assert_eq!(of.is_found, !of.is_null, "{of:?}");
        assert_eq!(of.is_confident_and_right, !of.is_null, "{of:?}");
    }
}

#[test]
#[ignore = "takes minutes of two cores; `make test-long` runs it"]
fn hidden_causes_are_found_and_named_and_saboteurs_fail() {
    let folder = tempfile::tempdir().unwrap();
    let of = |families: &[Family], seeds| {
        scored(folder.path(), &wanted(families, LARGE_DEG, seeds), SIMULATIONS)
    };
    let nulls = of(&Family::NULLS, 0..2);
    let families = [
        Family::Humidity,
        Family::RestTime,
        Family::Operator,
        Family::Vibration,
        Family::MethodBias,
        Family::ContainerAge,
    ];
    let effects = of(&families, 0..2);
    println!("{}", table(&nulls.iter().chain(&effects).cloned().collect::<Vec<_>>()));
    verdict(&nulls, &effects).unwrap();
    // The same bounds on fake detectors.
    let always = |found: bool, claim: Option<&str>, of: &[Scored]| -> Vec<Scored> {
        of.iter().map(|it| claimed(it, found, claim)).collect()
    };
    verdict(&always(false, None, &nulls), &always(false, None, &effects)).unwrap_err();
    let humid = Some("humidity");
    verdict(&always(true, humid, &nulls), &always(true, humid, &effects)).unwrap_err();
    // The command itself without its days, on nulls whose days differ: with no more of these than
    // of the others, it exceeds the same bound.
    let restless = of(&[Family::NullRestless], 0..RESTLESS);
    // Judged two at a time until the bound is exceeded: more could not bring it back.
    let blind = (1..=RESTLESS / 2)
        .map(|pairs| {
            let wanted = wanted_without_days(&[Family::NullRestless], 0..2 * pairs);
            scored(folder.path(), &wanted, SIMULATIONS)
        })
        .find(|blind| verdict(blind, &effects).is_err())
        .expect("the saboteur without days raises more false alarms than the bound allows");
    println!("{}", table(&restless.iter().chain(&blind).cloned().collect::<Vec<_>>()));
    verdict(&restless, &effects).unwrap();
    let failed = verdict(&blind, &effects).unwrap_err();
    assert!(failed.contains("false alarms"), "{failed}");
}

/// Defects of the solver are attributed to the solver, and a sound one gets none.
#[test]
#[ignore = "takes minutes of two cores; `make test-long` runs it"]
fn a_solver_whose_heaps_creep_is_named_and_a_sound_one_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let all = solver::criticised(folder.path(), &solver::wanted(&Defect::ALL, 0..2));
    println!("{}", solver::table(&all));
    for it in all {
        let right = match it.planted {
            Defect::Nothing => it.depends_on.is_empty() && !it.creep_is_told,
            Defect::Engine => it.is_creep_named(),
            Defect::LongSubstep => !it.depends_on.is_empty(),
        };
        assert!(right, "{it:?}");
    }
}

/// A campaign whose covariates moved together gets an experiment instead of a name, and the name
/// after it. `UPDATE=1` writes the campaign after it.
#[test]
#[ignore = "takes minutes of two cores; `make test-long` runs it"]
fn what_moved_together_is_named_after_the_experiment_that_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let laboratory = Laboratory::new(folder.path());
    let [.., (name, family, seed)] = SHOWN;
    let case = truth::case(family, SHOWN_DEG, seed);
    let answer = laboratory.discover(&case.csv, SIMULATIONS);
    assert_eq!(answer.verdict, "ambiguous", "{answer:?}");
    let right = case.mechanism.unwrap();
    assert!(
        answer.ambiguous_between.iter().any(|it| it == right),
        "{:?}, hidden is {right}",
        answer.ambiguous_between
    );
    let column = case.covariate.as_deref().unwrap();
    assert!(
        !answer.experiment.is_empty()
            && answer.experiment.iter().all(|run| run.contains_key(column)),
        "{answer:?}"
    );
    let after = case.after_experiment(&answer.experiment);
    is_file(&format!("{name}_after"), &after.csv);
    let then = laboratory.discover(&after.csv, SIMULATIONS);
    assert!(then.is_confident_and_right(&case), "{then:?}, hidden is {right}");
}

/// Effects in the grains are found and named as well as those in formulas, and nothing is found
/// where nothing is wrong.
#[test]
#[ignore = "takes minutes of two cores; `make test-long` runs it"]
fn what_another_simulator_does_to_its_grains_is_named() {
    let folder = tempfile::tempdir().unwrap();
    for of in scored(folder.path(), &wanted_heaps(0..1), SIMULATIONS) {
        assert_eq!(of.is_found, !of.is_null, "{of:?}");
        assert!(of.is_null || of.is_confident_and_right, "{of:?}");
    }
}

/// Grains that stick to the spoon of the emulated laboratory are found and named by replays of the
/// spoonfuls, and nothing is found where nothing is hidden.
#[test]
fn what_is_hidden_in_the_emulated_spoon_is_named() {
    let of = spoon_truth::of;
    let bench = Bench::new(spoon_truth::SMALL, None);
    let powder = spoon_truth::Powder { angle_deg: 36.0, sets: vec![of(0.8, 0.0), of(0.55, 0.4)] };
    let settings = Settings {
        causes: vec![SpoonCause::SpoonAdhesion, SpoonCause::Actuator, SpoonCause::SizeSpread],
        ..Settings::default()
    };
    let told = |hidden: Option<Hidden>| {
        // Neither of the sets that judge it.
        let truth = Truth { hidden, set: of(0.68, 0.2), off_deg: 0.0 };
        let weighed = bench.weighed(&bench.poured(&truth, 7), spoon_truth::BALANCES[1], 7);
        let report = bench.judged(&powder, false, &weighed, &settings);
        println!("{} {:?}", report.p_value, report.sentence);
        report
    };
    assert_eq!(told(None).verdict, Verdict::NoDiscrepancy);
    let sticky = told(Some(Hidden { mechanism: Mechanism::SpoonAdhesion, size: 3.0 }));
    assert_eq!(sticky.verdict, Verdict::Cause, "{sticky:?}");
    assert_eq!(sticky.causes[0].cause, SpoonCause::SpoonAdhesion, "{sticky:?}");
}

/// The kept campaigns of other grains are those that the grains make: each begins with the heaps
/// of its first days, poured anew. `UPDATE=1` pours all days and writes them.
#[test]
#[ignore = "takes minutes of two cores; `make test-long` runs it"]
fn kept_heaps_are_what_the_grains_make() {
    std::thread::scope(|scope| {
        for kind in heaps::Kind::ALL {
            scope.spawn(move || {
                if std::env::var_os("UPDATE").is_some() {
                    std::fs::write(heaps::file(kind, 0), heaps::poured(kind, 0, heaps::DAYS))
                        .unwrap();
                }
                let kept = heaps::campaign(kind, 0);
                assert!(
                    kept.starts_with(&heaps::poured(kind, 0, 2)),
                    "{kind:?}: run with UPDATE=1"
                );
            });
        }
    });
}

/// Checks that this campaign is the one shown in the documentation; `UPDATE=1` writes it.
fn is_file(name: &str, csv: &str) {
    let path = campaigns().join(format!("{name}.csv"));
    if std::env::var_os("UPDATE").is_some() {
        std::fs::create_dir_all(campaigns()).unwrap();
        std::fs::write(&path, csv).unwrap();
    }
    assert!(
        std::fs::read_to_string(&path).is_ok_and(|text| text == csv),
        "{}: run with UPDATE=1",
        path.display()
    );
}

fn campaigns() -> std::path::PathBuf {
    std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/campaigns")
}

/// Size of the effects shown in the documentation, degrees.
const SHOWN_DEG: f64 = 1.25;
/// The campaigns shown in the documentation, by file: their hidden effects are known here only.
const SHOWN: [(&str, Family, u64); 3] = [
    ("humidity", Family::Humidity, 3),
    ("nothing", Family::NullPlain, 3),
    ("confounded", Family::Confounded, 3),
];

/// `UPDATE=1` writes them.
#[test]
fn campaigns_of_the_readme_are_what_the_truth_makes() {
    for (name, family, seed) in SHOWN {
        is_file(name, &truth::case(family, SHOWN_DEG, seed).csv);
    }
}
