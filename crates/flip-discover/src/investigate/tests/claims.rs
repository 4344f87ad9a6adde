//! What reports claim, over many small campaigns: nothing hidden, outliers, small effects, effects
//! that powders do not share.

use super::*;
use crate::report::sizes::sized;
use crate::report::{Finding, Verdict};
use flip_core::domain::seed::derive;

/// The effect hidden in a campaign.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Hidden {
    Nothing,
    /// Some runs went wrong by 6 to 12 deg.
    Outliers,
    /// About the SD of a repeat over the range of the humidity, all powders alike.
    Small,
    /// Several times that, growing with a powder's place in the list.
    Graded,
    /// One powder goes one way, the others the other.
    Mixed,
    /// Operators differ, on one powder alone.
    Operator,
}

const KINDS: [Hidden; 6] = [
    Hidden::Nothing,
    Hidden::Outliers,
    Hidden::Small,
    Hidden::Graded,
    Hidden::Mixed,
    Hidden::Operator,
];
const NAMES: [&str; 2] = ["talc", "lactose_m200"];
/// Campaigns of each kind.
const SEEDS: u64 = 2;

impl Hidden {
    /// Contribution to the angle of a powder, deg; `share` of the humidity's range from its middle,
    /// `by` the operator.
    fn effect(self, powder: usize, share: f64, by: usize) -> f64 {
        match (self, powder) {
            (Self::Nothing | Self::Outliers, _) => 0.0,
            (Self::Small, _) => 1.5 * share,
            (Self::Graded, _) => 5.0 * (powder as f64 + 1.0) * share,
            (Self::Mixed, 0) => -10.0 * share,
            (Self::Mixed, _) => 10.0 * share,
            (Self::Operator, 0) => 4.0 * by as f64,
            (Self::Operator, _) => 0.0,
        }
    }
}

/// One or two powders, two runs of each on eight to ten days.
fn campaign(hidden: Hidden, seed: u64) -> Campaign {
    let mut rng = Pcg64::seed_from_u64(derive(hidden as u64, &[seed]));
    let (powders, days) =
        (rng.random_range(1..=2u32) as usize, rng.random_range(8..=10u32) as usize);
    let normal = |rng: &mut Pcg64| normal::quantile(rng.random::<f64>().clamp(1e-12, 1.0 - 1e-12));
    let (mut runs, mut humidity, mut operator) = (Vec::new(), Vec::new(), Vec::new());
    for session in 0..days {
        let (day, of_day) = (0.2 * normal(&mut rng), rng.random_range(25.0..75.0));
        for k in 0..2 * powders {
            let h: f64 = of_day + rng.random_range(-2.0..2.0);
            let by = rng.random_range(0..2u32) as usize;
            let is_wrong = hidden == Hidden::Outliers && rng.random_bool(0.05);
            let slip =
                if is_wrong { rng.random_range(6.0..12.0) * [1.0, -1.0][k % 2] } else { 0.0 };
            let effect = hidden.effect(k / 2, (h - 50.0) / 50.0, by);
            let angle = 28.0 + 3.0 * (k / 2) as f64 + day + 1.2 * normal(&mut rng) + effect + slip;
            runs.push(Run {
                row: runs.len() as u32 + 2,
                powder: k / 2,
                session,
                value: Some(angle),
            });
            humidity.push(Some(h));
            operator.push(Some(by));
        }
    }
    // Humidity moves powders up, as is known of it; a temperature may go either way.
    let name = if hidden == Hidden::Mixed { "temperature_c" } else { "relative_humidity_pct" };
    let numbers = Covariate { name: name.to_owned(), values: Values::Numbers(humidity) };
    let names = ["Ada", "Ben"].map(str::to_owned).to_vec();
    let levels =
        Covariate { name: "operator".to_owned(), values: Values::Levels { names, of: operator } };
    let powders = NAMES[..powders].iter().map(|name| (*name).to_owned()).collect();
    Campaign { powders, runs, covariates: vec![numbers, levels], ..Campaign::default() }
        .checked()
        .unwrap()
}

/// The part of a report before its advice on what to do next.
fn headline(report: &Report) -> &str {
    report.sentence.split(" What would").next().unwrap_or_default()
}

fn is_claimed(finding: &Finding) -> bool {
    is_told(finding.ci95, &finding.unit)
}

/// Findings of angles: scatter of repeats is reported alongside, and decides nothing.
fn of_angles(report: &Report) -> impl Iterator<Item = &Finding> {
    report.findings.iter().filter(|it| it.unit == "deg")
}

/// Checks that every named powder has its own effect next to its name, taken from one of the
/// findings; returns how many are named.
fn named(report: &Report, case: &str) -> usize {
    let effects = || {
        of_angles(report).flat_map(|finding| finding.by_powder.iter().map(move |it| (finding, it)))
    };
    let names = NAMES.into_iter().filter(|name| headline(report).contains(&name.replace('_', " ")));
    let check = |name: &str| {
        let own = effects().filter(|(_, it)| it.powder == name);
        let own = own.map(|(finding, it)| {
            format!("{} {}", name.replace('_', " "), sized(it.effect, it.ci95, &finding.unit))
        });
        let own: Vec<String> = own.collect();
        assert!(
            own.iter().any(|own| headline(report).contains(own)),
            "{case}: none of {own:?} in `{}`",
            report.sentence
        );
    };
    names.map(check).count()
}

#[test]
fn a_headline_of_nothing_is_no_cause_and_a_named_powder_has_its_own_effect() {
    let all = KINDS.into_iter().flat_map(|hidden| (0..SEEDS).map(move |seed| (hidden, seed)));
    let (mut causes, mut powders) = (0, 0);
    let mut verdicts = Vec::new();
    for (hidden, seed) in all {
        let (case, report) = (format!("{hidden:?} {seed}"), investigated(&campaign(hidden, seed)));
        let is_accepted = report.gain.as_ref().is_some_and(|gain| gain.accepted);
        match report.verdict {
            Verdict::Cause => {
                causes += 1;
                assert!(
                    is_accepted && of_angles(&report).count() > 0,
                    "{case}: {}",
                    report.sentence
                );
                assert!(of_angles(&report).all(is_claimed), "{case}: {}", report.sentence);
                assert!(
                    !report.sentence.contains("not enough to accept"),
                    "{case}: {}",
                    report.sentence
                );
            }
            Verdict::Hint => {
                assert!(
                    report.sentence.starts_with("A hint") && !report.is_worth_a_version(),
                    "{}",
                    report.sentence
                );
                let is_whole = of_angles(&report).count() > 0 && of_angles(&report).all(is_claimed);
                assert!(!(is_accepted && is_whole), "{case}: {}", report.sentence);
            }
            Verdict::NoDiscrepancy => {
                assert!(of_angles(&report).count() == 0 && report.gain.is_none(), "{case}")
            }
            Verdict::Ambiguous | Verdict::Unexplained => {}
        }
        powders += named(&report, &case);
        let document = serde_json::to_string(&report).unwrap();
        assert_eq!(serde_json::from_str::<Report>(&document).unwrap(), report, "{case}");
        verdicts.push((case, report.verdict));
    }
    println!("{verdicts:?}, {powders} powders named");
    // Otherwise neither rule was tested.
    assert!(causes > 0 && powders > 0, "{verdicts:?}");
}
