//! What the simulated spoon gets wrong: weighings, replayed by the calibrated simulator.
//!
//! ```text
//! ask.rs         what is asked of the simulator      causes.rs     the catalogue
//! readings.rs    what a balance shows of it          summaries.rs  what spoonfuls say, in a dozen numbers
//! field.rs       the replays of one powder           screen.rs     is anything wrong
//! evidence.rs    how well each cause explains it     verdict.rs    what may be claimed
//! held_out.rs    worth on spoonfuls left out         version.rs    an extended simulator
//! words.rs       the sentences of its document, which is report/spoon.rs
//! ```
//!
//! Angle and spoon are judged together: a cause that moves the heap's angle is given the friction
//! that moves it back, and what friction cannot undo counts against it.
//!
//! Difference: replays make the recorded steps whatever falls, a weighing chose its steps by what
//! fell. As a likelihood that is the same; as a null it is not quite (`tests/`: what it costs).

mod ask;
mod causes;
mod evidence;
mod field;
mod held_out;
mod readings;
mod screen;
mod summaries;
mod verdict;
mod version;
mod words;

#[cfg(test)]
mod tests;

pub use crate::report::spoon as report;
pub use crate::report::spoon::SpoonReport;
pub use ask::{Calibrated, Change, Simulator, SpoonHeap, SpoonReplay};
pub use causes::SpoonCause;
pub use version::extended;

use crate::judge::claim::{Proposal, verdict};
use crate::report::Verdict;
use crate::report::printed::is_told;
use crate::thresholds::SIGNIFICANCE;
use field::{Campaign, Field};
use flip_core::domain::FieldError;
use flip_core::domain::seed::{derive, index_of};
use flip_core::domain::shake::Spoonful;
use flip_core::stats::summary::sd;
use report::{PowderReport, SpoonExtension, Unjudged};
use screen::Screened;
use serde::{Deserialize, Serialize};
use verdict::Judged;

/// How to judge.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Seed of replays and their readings.
    pub seed: u64,
    /// Most replayed spoonfuls for each powder: about 5 s of CPU each with twenty steps.
    pub replays: u32,
    /// Replays of all spoonfuls as calibrated, 19 to 999: p cannot be below one in as many.
    pub campaigns: u32,
    /// Replays of all spoonfuls for each cause, amplitude and set.
    pub repeats: u32,
    /// Sets with which causes are tried: those whose spoons are nearest to the weighings.
    pub sets: u32,
    /// The causes to judge.
    pub causes: Vec<SpoonCause>,
    /// SD of ln mass between spoonfuls that are filled alike: no simulator has a person's hand.
    pub spoonful_sd: f64,
    /// The same between days.
    pub day_sd: f64,
    /// Channels judged in the same investigation, this one included: p is multiplied by them
    /// (Bonferroni), since the others are judged later.
    pub channels: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            seed: 1,
            replays: 600,
            campaigns: 39,
            repeats: 1,
            sets: 2,
            causes: SpoonCause::ALL.to_vec(),
            spoonful_sd: 0.1,
            day_sd: 0.1,
            channels: 1,
        }
    }
}

/// What a powder's causes are asked with.
struct Plan<'a> {
    of: &'a Calibrated,
    settings: &'a Settings,
    simulator: &'a dyn Simulator,
}

/// Fewest spoonfuls of a powder: a mean of one has no scatter between spoonfuls.
const SPOONFULS_MIN: usize = 2;
/// Fewest replays that can be significant, for each channel.
const CAMPAIGNS_MIN: u32 = 19;

impl Settings {
    /// The usual settings of an investigation with so many channels: each of them costs replays,
    /// since p cannot be below one in as many.
    pub fn among(channels: u32) -> Self {
        let usual = Self::default();
        let campaigns = (20 * channels).saturating_sub(1).max(usual.campaigns);
        Self { channels, campaigns, ..usual }
    }

    /// Fewest replays for each powder: of two spoonfuls with one set.
    pub fn replays_min(&self) -> u32 {
        (self.campaigns_of(1) * SPOONFULS_MIN) as u32
    }

    fn checked(&self) -> Result<(), FieldError> {
        let whole = |name, value: u32, lower, upper| {
            let message = format!("must be from {lower} to {upper}, got {value}");
            let is_in = (lower..=upper).contains(&value);
            if is_in { Ok(()) } else { Err(FieldError::new(name, message)) }
        };
        whole("campaigns", self.campaigns, CAMPAIGNS_MIN, 999)?;
        whole("repeats", self.repeats, 1, 20)?;
        whole("sets", self.sets, 1, 10)?;
        whole("channels", self.channels, 1, 10)?;
        flip_core::domain::bounded("spoonful_sd", self.spoonful_sd, 0.0, 1.0, "")?;
        flip_core::domain::bounded("day_sd", self.day_sd, 0.0, 1.0, "")?;
        let least = self.replays_min();
        let message = || {
            format!("must be at least {least} for {SPOONFULS_MIN} spoonfuls, got {}", self.replays)
        };
        let is_enough = self.replays >= least;
        if is_enough { Ok(()) } else { Err(FieldError::new("replays", message())) }
    }

    /// Replays of each spoonful with this many sets.
    fn campaigns_of(&self, sets: usize) -> usize {
        let nodes = self.causes.len() * causes::AMPLITUDES;
        self.campaigns as usize + nodes * self.repeats as usize * sets.min(self.sets as usize)
    }

    /// Most spoonfuls of a powder with this many sets.
    fn spoonfuls(&self, sets: usize) -> usize {
        (self.replays as usize / self.campaigns_of(sets)).max(SPOONFULS_MIN)
    }
}

/// Judges the spoonfuls of every powder against its calibrated sets. Deterministic if `simulator`
/// is.
///
/// # Errors
/// A setting out of bounds, or no powder that can be judged.
pub fn judge_spoon(
    spoonfuls: &[Spoonful],
    calibrated: &[Calibrated],
    settings: &Settings,
    simulator: &dyn Simulator,
) -> Result<SpoonReport, FieldError> {
    settings.checked()?;
    let counted = Counted::over(simulator);
    let mut unjudged = Vec::new();
    let mut fields: Vec<(&Calibrated, Field<'_>)> = Vec::new();
    for powder in powders(spoonfuls) {
        match field(&powder, spoonfuls, calibrated, settings) {
            Ok((of, mut field)) => {
                field.replay(of, settings, &counted, seed_of(settings, &powder));
                fields.push((of, field));
            }
            Err(why) => unjudged.push(Unjudged { powder, why }),
        }
    }
    keep_common(&mut fields)?;
    let mut screened = screen::screen(&fields.iter().map(|it| rows(&it.1)).collect::<Vec<_>>());
    for it in &mut screened {
        it.p_corrected = (it.p_corrected * f64::from(settings.channels)).min(1.0);
    }
    let given = |powder: &str| spoonfuls.iter().filter(|it| it.powder == powder).count();
    let mut reports = Vec::new();
    for ((of, field), screened) in fields.iter_mut().zip(&screened) {
        let plan = Plan { of, settings, simulator: &counted };
        reports.push(judged(field, &plan, screened, given(&of.powder)));
    }
    Ok(SpoonReport {
        sentence: words::all(&reports),
        p_value: screened.iter().map(|it| it.p_corrected).fold(1.0, f64::min),
        blind_spots: words::blind_spots(settings, &reports),
        powders: reports,
        unjudged,
        campaigns: fields.first().map_or(0, |(_, field)| field.base.len() as u32),
        replays: counted.replays.get(),
        heaps: counted.heaps.get(),
    })
}

fn seed_of(settings: &Settings, powder: &str) -> u64 {
    derive(settings.seed, &[index_of(powder)])
}

/// Powders in the order of their first spoonful.
fn powders(spoonfuls: &[Spoonful]) -> Vec<String> {
    let mut all: Vec<String> = Vec::new();
    for spoonful in spoonfuls {
        if !all.contains(&spoonful.powder) {
            all.push(spoonful.powder.clone());
        }
    }
    all
}

/// The spoonfuls of a powder, or why they cannot be judged.
fn field<'a, 'b>(
    powder: &str,
    spoonfuls: &'a [Spoonful],
    calibrated: &'b [Calibrated],
    settings: &Settings,
) -> Result<(&'b Calibrated, Field<'a>), String> {
    let of = calibrated.iter().find(|it| it.powder == powder && !it.sets.is_empty());
    let of = of.ok_or_else(|| format!("{powder} is not calibrated: calibrate it first"))?;
    let field = Field::of(powder, spoonfuls, settings.spoonfuls(of.sets.len()));
    let count = field.spoonfuls.len();
    match count < SPOONFULS_MIN {
        true => Err(format!("{count} spoonful of {powder}: {SPOONFULS_MIN} are needed")),
        false => Ok((of, field)),
    }
}

/// Leaves out the draws of which a replay of any powder diverged, so that all have as many.
fn keep_common(fields: &mut [(&Calibrated, Field<'_>)]) -> Result<(), FieldError> {
    let is_whole = |campaign: &Campaign| !campaign.fell.is_empty();
    let count = fields.first().map_or(0, |it| it.1.base.len());
    let whole: Vec<bool> =
        (0..count).map(|b| fields.iter().all(|it| is_whole(&it.1.base[b]))).collect();
    if whole.iter().filter(|it| **it).count() < CAMPAIGNS_MIN as usize {
        let message = "leave nothing to judge: give two spoonfuls of a calibrated powder, whose replays do not diverge";
        return Err(FieldError::new("spoonfuls", message));
    }
    for (_, field) in fields {
        let mut of = whole.iter();
        field.base.retain(|_| of.next().is_some_and(|whole| *whole));
    }
    Ok(())
}

/// Summaries of a powder, measured first.
fn rows(field: &Field<'_>) -> Vec<Vec<f64>> {
    let keep: Vec<usize> = (0..field.spoonfuls.len()).collect();
    let frame = field.frame(&keep);
    let sum =
        |fell: &field::Fell| frame.summed(&fell.iter().map(Vec::as_slice).collect::<Vec<_>>());
    std::iter::once(&field.measured).chain(field.base.iter().map(|it| &it.fell)).map(sum).collect()
}

/// The report of one powder; causes are tried where something is wrong.
fn judged(
    field: &mut Field<'_>,
    plan: &Plan<'_>,
    screened: &Screened,
    given: usize,
) -> PowderReport {
    let mut report = words::unexplained_yet(field, plan, screened, given);
    if screened.p_corrected > SIGNIFICANCE {
        return report;
    }
    let seed = seed_of(plan.settings, &plan.of.powder);
    let used = nearest(&rows(field), &field.base, plan.settings.sets as usize);
    field.extend(plan, &used, derive(seed, &[0xCA]));
    let keep: Vec<usize> = (0..field.spoonfuls.len()).collect();
    let weighed = evidence::weigh(field, &field.nodes, &used, &keep, plan.of.angle);
    let Some(weighed) = weighed else {
        report.verdict = Verdict::Unexplained;
        return report;
    };
    let found = Judged::of(&weighed);
    report.gain = held_out::gain(field, &used, plan.of.angle, seed);
    let accepted = report.gain.as_ref().is_some_and(|gain| gain.accepted);
    let has_effect = found.causes.first().is_some_and(|first| is_told(first.effect_ci95_mg, "mg"));
    report.verdict = verdict(found.proposal, has_effect, accepted);
    report.unknown_probability = found.unknown;
    report.families = found.families();
    if report.verdict == Verdict::Ambiguous {
        report.ambiguous_between =
            found.candidates().iter().map(|cause| cause.name().0.to_owned()).collect();
    }
    // An open cause that predicts spoonfuls left out by itself mends the simulator all the same.
    let mends = || {
        let alone = found.causes.first().map(|first| field.with_only(first.cause));
        let gain = alone.and_then(|field| held_out::gain(&field, &used, plan.of.angle, seed));
        gain.is_some_and(|gain| gain.accepted)
    };
    if report.verdict == Verdict::Cause
        || (report.verdict == Verdict::Ambiguous && has_effect && accepted && mends())
    {
        report.extension = extension(field, &weighed, &found);
    }
    for (k, course) in report.courses.iter_mut().enumerate() {
        course.after_mg = Some(weighed.predicted_mg(k));
    }
    report.causes = found.causes;
    report.sentence = words::sentence(&report, found.proposal == Proposal::Cause);
    report
}

/// The sets whose replays lie nearest to what was measured, in their order.
fn nearest(rows: &[Vec<f64>], base: &[Campaign], most: usize) -> Vec<usize> {
    let scales: Vec<f64> = (0..rows[0].len())
        .map(|k| sd(&rows.iter().map(|row| row[k]).collect::<Vec<_>>()).unwrap_or(0.0))
        .collect();
    let apart = |row: &[f64]| {
        let terms = row.iter().zip(&rows[0]).zip(&scales).filter(|(_, sd)| **sd > 0.0);
        terms.map(|((x, y), sd)| ((x - y) / sd).powi(2)).sum::<f64>()
    };
    let sets = base.iter().map(|it| it.set).max().map_or(0, |last| last + 1);
    let mean = |set: usize| {
        let own = rows[1..].iter().zip(base).filter(|(_, of)| of.set == set);
        let all: Vec<f64> = own.map(|(row, _)| apart(row)).collect();
        Some((set, flip_core::stats::summary::mean(&all)?))
    };
    let mut all: Vec<(usize, f64)> = (0..sets).filter_map(mean).collect();
    all.sort_by(|a, b| a.1.total_cmp(&b.1));
    all.truncate(most);
    let mut used: Vec<usize> = all.into_iter().map(|it| it.0).collect();
    used.sort_unstable();
    used
}

/// The claimed cause as changes of the simulator, at the simulated amplitude next to the fitted
/// one, with the friction found for it.
fn extension(
    field: &Field<'_>,
    weighed: &evidence::Weighed,
    found: &Judged,
) -> Option<SpoonExtension> {
    let first = found.causes.first()?;
    let best = verdict::best(weighed, first.cause)?;
    let own = field.nodes.iter().filter(|it| it.cause == first.cause && it.set == best.set);
    let next = own.min_by(|a, b| {
        let apart = |node: &field::Node| ((node.place + 1) as f64 - best.u).abs();
        apart(a).total_cmp(&apart(b))
    })?;
    let change = next.change.clone();
    let is_of_powder = !change.patch.is_none();
    Some(SpoonExtension { cause: first.cause, change, is_of_powder })
}

/// Counts what is asked of a simulator.
struct Counted<'a> {
    simulator: &'a dyn Simulator,
    replays: std::cell::Cell<u32>,
    heaps: std::cell::Cell<u32>,
}

impl<'a> Counted<'a> {
    fn over(simulator: &'a dyn Simulator) -> Self {
        Self { simulator, replays: std::cell::Cell::default(), heaps: std::cell::Cell::default() }
    }
}

impl Simulator for Counted<'_> {
    fn pour(&self, replays: &[SpoonReplay]) -> Vec<Option<Vec<f64>>> {
        self.replays.set(self.replays.get() + replays.len() as u32);
        self.simulator.pour(replays)
    }

    fn heaps(&self, heaps: &[SpoonHeap]) -> Vec<Option<f64>> {
        self.heaps.set(self.heaps.get() + heaps.len() as u32);
        self.simulator.heaps(heaps)
    }
}
