//! Rates over many mechanisms hidden in the emulated laboratory's spoon, each with its
//! Clopper-Pearson limits.
//!
//! *Found*: the verdict is not `no_discrepancy`. *Named*: the verdict is `cause`, and the cause is
//! the hidden one. *Named by family*: the verdict is `cause`, and its family is the hidden one's; or
//! `ambiguous`, and every candidate is of that family. *Confident and wrong*: another family is named
//! in either way. What lies outside the catalogue has no right name.

use crate::judge::{kept, limits};
use crate::spoon_truth::{ANGLES_DEG, BALANCES, Balance, Bench, Powder, Truth, WHOLE};
use flip_bench::emulate::hidden::Mechanism;
use flip_core::domain::seed::derive;
use flip_discover::report::Verdict;
use flip_discover::spoon::report::PowderReport;
use flip_discover::spoon::{Settings, SpoonCause};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The result for one bench with one balance.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct SpoonScored {
    /// Hidden mechanism, or `nothing`.
    pub hidden: String,
    pub size: f64,
    pub angle_deg: f64,
    /// Angle of the truth's heaps less that.
    pub off_deg: f64,
    pub seed: u64,
    pub readability_mg: f64,
    /// Mean difference of what had fallen, over all steps, from the replays' medians over these.
    pub changed: f64,
    pub p_value: f64,
    pub verdict: Verdict,
    /// Causes, most probable first, with their probabilities; the first four.
    pub causes: Vec<(SpoonCause, f64)>,
    pub families: Vec<(String, f64)>,
    pub unknown: f64,
    pub ambiguous_between: Vec<String>,
    /// Error before and after, mg, and whether the gain was accepted.
    pub gain: Option<(f64, f64, bool)>,
    pub wall_s: f64,
}

/// Mechanism and seed.
pub type Asked = (Option<Mechanism>, u64);

fn name(hidden: Option<Mechanism>) -> &'static str {
    hidden.map_or("nothing", Mechanism::name)
}

/// The cause that a mechanism is in the catalogue.
fn right(mechanism: Mechanism) -> Option<SpoonCause> {
    match mechanism {
        Mechanism::Attraction => Some(SpoonCause::Cohesion),
        Mechanism::Humidity => Some(SpoonCause::Humidity),
        Mechanism::Consolidation => Some(SpoonCause::Consolidation),
        Mechanism::Rolling => Some(SpoonCause::Shape),
        Mechanism::SizeSpread => Some(SpoonCause::SizeSpread),
        Mechanism::SpoonAdhesion => Some(SpoonCause::SpoonAdhesion),
        Mechanism::Charge => Some(SpoonCause::Charge),
        Mechanism::SpoonFriction => Some(SpoonCause::SpoonFriction),
        Mechanism::HoldUp => Some(SpoonCause::SpoonHoldup),
        Mechanism::WeakStrokes => Some(SpoonCause::Actuator),
        Mechanism::UnderFilling => Some(SpoonCause::FillLevel),
        Mechanism::Drift | Mechanism::Packing => None,
    }
}

/// Mechanisms that are easily taken for each other.
const PAIRS: [[Mechanism; 2]; 5] = [
    [Mechanism::SpoonAdhesion, Mechanism::SpoonFriction],
    [Mechanism::SpoonAdhesion, Mechanism::Charge],
    [Mechanism::HoldUp, Mechanism::UnderFilling],
    [Mechanism::Attraction, Mechanism::Consolidation],
    [Mechanism::WeakStrokes, Mechanism::SpoonFriction],
];

impl SpoonScored {
    fn mechanism(&self) -> Option<Mechanism> {
        Mechanism::ALL.into_iter().find(|it| it.name() == self.hidden)
    }

    fn right(&self) -> Option<SpoonCause> {
        self.mechanism().and_then(right)
    }

    fn family(&self) -> Option<&'static str> {
        self.right().map(|cause| cause.name().1)
    }

    pub fn is_found(&self) -> bool {
        self.verdict != Verdict::NoDiscrepancy
    }

    /// The claimed cause.
    pub fn claimed(&self) -> Option<SpoonCause> {
        let first = self.causes.first().map(|it| it.0);
        first.filter(|_| self.verdict == Verdict::Cause)
    }

    pub fn is_named(&self) -> bool {
        self.claimed().is_some() && self.claimed() == self.right()
    }

    /// The family of all causes that the verdict leaves open.
    pub fn claimed_family(&self) -> Option<&'static str> {
        let of = |name: &str| SpoonCause::ALL.into_iter().find(|it| it.name().0 == name);
        let candidates = self.ambiguous_between.iter().filter_map(|name| of(name));
        let mut open = match self.verdict {
            Verdict::Cause => self.claimed().into_iter().collect(),
            Verdict::Ambiguous => candidates.collect::<Vec<_>>(),
            _ => Vec::new(),
        }
        .into_iter()
        .map(|cause| cause.name().1);
        let first = open.next()?;
        open.all(|family| family == first).then_some(first)
    }

    pub fn is_family_named(&self) -> bool {
        self.claimed_family().is_some() && self.claimed_family() == self.family()
    }

    pub fn is_top(&self) -> bool {
        self.right().is_some() && self.causes.first().map(|it| it.0) == self.right()
    }

    pub fn is_top_family(&self) -> bool {
        self.family().is_some() && self.families.first().map(|it| it.0.as_str()) == self.family()
    }

    pub fn is_wrong(&self) -> bool {
        self.claimed_family().is_some_and(|family| Some(family) != self.family())
    }

    fn is_another_member(&self) -> bool {
        self.claimed().is_some() && !self.is_wrong() && !self.is_named()
    }
}

/// Nulls, then every mechanism with every seed, seed by seed.
pub fn wanted(nulls: std::ops::Range<u64>, effects: std::ops::Range<u64>) -> Vec<Asked> {
    let nulls = nulls.map(|seed| (None, seed));
    nulls.chain(effects.flat_map(|seed| Mechanism::ALL.map(|it| (Some(it), seed)))).collect()
}

/// Those in the file, and the others, each written as soon as it is judged: one line for a balance.
/// Seeds take turns with the first so many powders; causes are replayed so often at each amplitude.
pub fn scored(folder: &Path, wanted: &[Asked], powders: u64, repeats: u32) -> Vec<SpoonScored> {
    let bench = Bench::new(WHOLE, Some(folder.join("spoon_replays.jsonl")));
    let angles = ANGLES_DEG.iter().take(powders.clamp(1, 4) as usize);
    let powders: Vec<Powder> = angles.map(|deg| bench.powder(*deg)).collect();
    let asked: Vec<(String, u64)> =
        wanted.iter().map(|(hidden, seed)| (name(*hidden).to_owned(), *seed)).collect();
    let key = |it: &Vec<SpoonScored>| (it[0].hidden.clone(), it[0].seed);
    let one = |(hidden, seed): &(String, u64)| {
        let mechanism = Mechanism::ALL.into_iter().find(|it| it.name() == hidden);
        score(&bench, &powders[*seed as usize % powders.len()], mechanism, *seed, repeats)
    };
    let file = match repeats {
        1 => "scored_spoon.jsonl".to_owned(),
        _ => format!("scored_spoon_{repeats}.jsonl"),
    };
    kept(&folder.join(file), &asked, key, one).concat()
}

/// Both balances before one bench.
fn score(
    bench: &Bench,
    powder: &Powder,
    mechanism: Option<Mechanism>,
    seed: u64,
    repeats: u32,
) -> Vec<SpoonScored> {
    let own = derive(seed, &[mechanism.map_or(0, |it| 1 + it as u64)]);
    let truth = bench.truth(mechanism, powder.angle_deg, own);
    let poured = bench.poured(&truth, own);
    let one = |balance: Balance| {
        let begun = std::time::Instant::now();
        let weighed = bench.weighed(&poured, balance, own);
        let usual = Settings::default();
        let replays = usual.replays * repeats;
        let settings = Settings { seed: own, repeats, replays, ..usual };
        let report = bench.judged(powder, true, &weighed, &settings);
        let wall_s = begun.elapsed().as_secs_f64();
        SpoonScored { wall_s, seed, ..of(&report, powder, &truth, balance) }
    };
    BALANCES.map(one).to_vec()
}

fn of(report: &PowderReport, powder: &Powder, truth: &Truth, balance: Balance) -> SpoonScored {
    let steps = report.courses.iter().flat_map(|course| &course.steps);
    let (apart, usual) = steps.fold((0.0, 0.0), |(apart, usual), step| {
        (apart + step.weighed_mg - step.simulated_mg, usual + step.simulated_mg)
    });
    SpoonScored {
        hidden: name(truth.hidden.map(|it| it.mechanism)).to_owned(),
        size: truth.hidden.map_or(0.0, |it| it.size),
        angle_deg: powder.angle_deg,
        off_deg: truth.off_deg,
        seed: 0,
        readability_mg: balance.readability_mg,
        changed: apart / usual,
        p_value: report.p_value,
        verdict: report.verdict,
        causes: report.causes.iter().take(4).map(|it| (it.cause, it.probability)).collect(),
        families: report
            .families
            .iter()
            .take(3)
            .map(|it| (it.family.clone(), it.probability))
            .collect(),
        unknown: report.unknown_probability,
        ambiguous_between: report.ambiguous_between.clone(),
        gain: report.gain.as_ref().map(|it| (it.error_before_mg, it.error_after_mg, it.accepted)),
        wall_s: 0.0,
    }
}

/// Whether the row counts a bench.
type Is<'a> = &'a dyn Fn(&SpoonScored) -> bool;

fn row(text: &mut String, name: &str, of: &[&SpoonScored], is: Is<'_>, target: &str) {
    let hits = of.iter().filter(|it| is(it)).count();
    if of.is_empty() {
        return;
    }
    let [low, high] = limits(hits, of.len()).map(|limit| 100.0 * limit);
    let share = 100.0 * hits as f64 / of.len() as f64;
    let line =
        format!("{name:<58} {hits:>4} of {:<4} {share:>6.1} %  [{low:.1}, {high:.1}]", of.len());
    let target = if target.is_empty() { String::new() } else { format!("  target {target}") };
    text.push_str(&format!("{line}{target}\n"));
}

/// The table.
pub fn table(all: &[SpoonScored]) -> String {
    let mut text = String::new();
    for Balance { readability_mg, .. } in BALANCES {
        let own: Vec<&SpoonScored> =
            all.iter().filter(|it| it.readability_mg == readability_mg).collect();
        text.push_str(&format!("spoon, balance of {readability_mg} mg\n"));
        rows(&mut text, &own);
    }
    text
}

fn rows(text: &mut String, own: &[&SpoonScored]) {
    let of = |is: Is<'_>| own.iter().copied().filter(|it| is(it)).collect::<Vec<_>>();
    let nulls = of(&|it| it.mechanism().is_none());
    let singles = of(&|it| it.right().is_some());
    let outside = of(&|it| it.mechanism().is_some() && it.right().is_none());
    row(text, "nothing hidden: declared", &nulls, &SpoonScored::is_found, "<= 5 %");
    row(text, "found, one of the catalogue", &singles, &SpoonScored::is_found, ">= 95 %");
    row(text, "most probable cause right", &singles, &SpoonScored::is_top, "");
    row(text, "most probable family right", &singles, &SpoonScored::is_top_family, "");
    row(text, "named: verdict cause, the hidden one", &singles, &SpoonScored::is_named, "");
    row(
        text,
        "named by family, or ambiguous within it",
        &singles,
        &SpoonScored::is_family_named,
        ">= 80 %",
    );
    row(
        text,
        "verdict cause, another of its family",
        &singles,
        &SpoonScored::is_another_member,
        "",
    );
    row(text, "confident and wrong: another family", &singles, &SpoonScored::is_wrong, "<= 5 %");
    for mechanism in Mechanism::ALL {
        let own = of(&|it| it.mechanism() == Some(mechanism));
        let changed: Vec<f64> = own.iter().map(|it| 100.0 * it.changed).collect();
        let mean = changed.iter().sum::<f64>() / changed.len().max(1) as f64;
        let count = |is: Is<'_>| own.iter().filter(|it| is(it)).count();
        if !own.is_empty() {
            text.push_str(&format!(
                "   {:<16} {mean:>+5.0} % of what falls; of {}: found {}, top {}, top family {}, named {}, by family {}, wrong {}\n",
                mechanism.name(), own.len(), count(&SpoonScored::is_found), count(&SpoonScored::is_top),
                count(&SpoonScored::is_top_family), count(&SpoonScored::is_named),
                count(&SpoonScored::is_family_named), count(&SpoonScored::is_wrong)
            ));
        }
    }
    row(text, "outside the catalogue: found", &outside, &SpoonScored::is_found, "");
    row(
        text,
        "outside the catalogue: neither cause nor family claimed",
        &outside,
        &|it| it.claimed_family().is_none(),
        "",
    );
    for [one, other] in PAIRS {
        let both = of(&|it| it.mechanism() == Some(one) || it.mechanism() == Some(other));
        let name = format!("   {} for {}, or the reverse", one.name(), other.name());
        let is_taken = |it: &SpoonScored| {
            let taken = if it.mechanism() == Some(one) { other } else { one };
            it.claimed().is_some() && it.claimed() == right(taken)
        };
        row(text, &name, &both, &is_taken, "");
    }
}
