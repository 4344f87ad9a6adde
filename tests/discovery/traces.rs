//! Causes hidden in balance readings, and the requirement that the command find them.

use crate::judge::Laboratory;
use crate::rates::SIMULATIONS;
use crate::trace_rates::{TraceScored, scored, table, wanted};
use crate::trace_truth::{TraceFamily, trace_case};
use crate::truth::{self, Family};

/// The requirements on a detector for the benches of the tests.
///
/// Bounds are such that a detector with the target rates fails once in some thousand times
/// (binomial): of 6 nulls at 5 % three or more are found with a chance of 0.002; of 12 effects at
/// 90 % eight or fewer are found with a chance of 0.03 and seven or fewer with 0.004; at 85 % six
/// or fewer are named with a chance of 0.005; at 5 % three or more have a wrong name with 0.02.
fn verdict(nulls: &[TraceScored], effects: &[TraceScored]) -> Result<(), String> {
    let count = |of: &[TraceScored], is: &dyn Fn(&TraceScored) -> bool| {
        of.iter().filter(|it| is(it)).count()
    };
    let alarms = count(nulls, &TraceScored::is_found);
    let found = count(effects, &TraceScored::is_found);
    let named = count(effects, &TraceScored::is_named);
    let wrong = count(effects, &TraceScored::is_wrong);
    match () {
        () if alarms > 2 => Err(format!("{alarms} false alarms of {}", nulls.len())),
        () if found < 8 => Err(format!("{found} of {} found", effects.len())),
        () if named < 7 => Err(format!("{named} of {} named", effects.len())),
        () if wrong > 2 => Err(format!("{wrong} of {} wrongly", effects.len())),
        () => Ok(()),
    }
}

/// One of each; `make test-long` hides many.
#[test]
fn a_cause_hidden_in_balance_readings_is_found_and_named_and_nothing_where_nothing_is() {
    let folder = tempfile::tempdir().unwrap();
    let wanted = wanted(&[TraceFamily::NullPlain, TraceFamily::BalanceDrift], 0..1);
    let scored = scored(folder.path(), &wanted, SIMULATIONS);
    assert!(!scored[0].is_found(), "{:?}", scored[0]);
    assert!(scored[1].is_found() && scored[1].is_named(), "{:?}", scored[1]);
}

#[test]
#[ignore = "takes minutes of two cores; `make test-long` runs it"]
fn causes_hidden_in_balance_readings_are_found_and_named_and_saboteurs_fail() {
    let folder = tempfile::tempdir().unwrap();
    let of = |families: &[TraceFamily], seeds| {
        scored(folder.path(), &wanted(families, seeds), SIMULATIONS)
    };
    let nulls = of(&TraceFamily::NULLS, 0..2);
    let mut effects = of(&TraceFamily::SINGLES, 0..1);
    effects.extend(of(&TraceFamily::OTHERS, 0..1));
    println!("{}", table(&nulls.iter().chain(&effects).cloned().collect::<Vec<_>>()));
    verdict(&nulls, &effects).unwrap();
    // The same bounds on fake detectors.
    let says = |of: &[TraceScored], verdict: &str, claimed: &[&str]| -> Vec<TraceScored> {
        let claimed: Vec<String> = claimed.iter().map(|it| (*it).to_owned()).collect();
        of.iter()
            .map(|it| TraceScored {
                verdict: verdict.to_owned(),
                claimed: claimed.clone(),
                ..it.clone()
            })
            .collect()
    };
    let (none, drift) = ("no_discrepancy", ["balance_drift"]);
    verdict(&says(&nulls, none, &[]), &says(&effects, none, &[])).unwrap_err();
    verdict(&says(&nulls, "cause", &drift), &says(&effects, "cause", &drift)).unwrap_err();
    // One that always finds something and gives it one name.
    verdict(&nulls, &says(&effects, "cause", &drift)).unwrap_err();
    verdict(&nulls, &says(&effects, "unexplained", &[])).unwrap_err();
}

/// Angles in which nothing is wrong stay so alongside a bench in which something is.
#[test]
#[ignore = "takes minutes of two cores; `make test-long` runs it"]
fn a_balance_that_drifts_is_told_beside_angles_that_are_right() {
    let folder = tempfile::tempdir().unwrap();
    let laboratory = Laboratory::new(folder.path());
    let traces = trace_case(TraceFamily::BalanceDrift, 3).csv;
    let angles = truth::case(Family::NullPlain, 1.0, 3).csv;
    let answer = laboratory.discover_traces(&traces, Some(&angles), SIMULATIONS);
    assert_eq!(
        (answer.verdict.as_str(), answer.claimed.as_slice()),
        ("cause", &["balance_drift".to_owned()][..]),
        "{answer:?}"
    );
    assert_eq!(answer.channels, ["trace"]);
    // Two channels of 99 simulations each: Holm's smallest p.
    assert!((answer.p_value - 0.02).abs() < 1e-12, "{}", answer.p_value);
    let (effect, [low, high]) = answer.effect.unwrap();
    assert!(low < effect && effect < high && low > 0.0, "{effect} [{low}, {high}]");
    assert!(
        answer.experiment.iter().any(|run| run.get("kind").is_some_and(|kind| kind == "zero")),
        "{answer:?}"
    );
}
