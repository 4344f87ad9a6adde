//! The investigation job: what a campaign, or the readings of a bench's balance, reveal that the
//! calibrated simulator does not reproduce.
//!
//! Nothing is saved midway: repeating it on the same campaign gives the same report.

use super::Functions;
use super::heaps::Pourer;
use super::host::{Finished, JobError, JobHost, NewVersion, Result, go_on};
use super::replays::judged;
use super::spec::InvestigationSpec;
use flip_core::domain::job::Progress;
use flip_discover::numerics::{CREEP, tell};
use flip_discover::report::{CauseReport, Gain, Report, Unexplained};
use flip_discover::spoon;
use flip_discover::{Extended, Measured, extend, investigate, responses};
use serde::Serialize;
use std::time::Instant;

/// Progress at which the statistical judgement begins and ends in a job that also simulates.
const JUDGED: [f64; 2] = [0.15, 0.75];
/// Progress at which replays of spoonfuls end where other data are judged as well.
const REPLAYED: f64 = 0.6;

pub(super) fn perform(
    host: &dyn JobHost,
    functions: &Functions,
    spec: &InvestigationSpec,
) -> Result<()> {
    let InvestigationSpec { campaign, traces, settings, simulator, .. } = spec;
    let began = Instant::now();
    let mut measured =
        Measured { campaign: campaign.as_ref(), traces: traces.as_ref(), spoon: None };
    let alone = campaign.is_none() && traces.is_none();
    let begin = match &spec.shakes {
        Some(shakes) => {
            let share = [0.0, if alone { 1.0 } else { REPLAYED }];
            measured.spoon = Some(judged(host, functions, shakes, share)?);
            share[1]
        }
        None => 0.0,
    };
    // What is left after the replays is shared by the rest.
    let [judged_from, judged_until] = JUDGED.map(|share| begin + (1.0 - begin) * share);
    let pourer = Pourer::of(host, &functions.simulate, spec);
    let numerics = match &pourer {
        Some(pourer) => pourer.numerics([begin, judged_from])?,
        None => None,
    };
    let [from, until] = if pourer.is_some() { [judged_from, judged_until] } else { [begin, 1.0] };
    let mut unsaved = None;
    let report = investigate(measured, simulator, settings, |progress| {
        let fraction = from + (until - from) * progress.fraction;
        let progress = Progress { fraction, message: progress.message.clone() };
        go_on(host, host.report(&progress), &mut unsaved)
    });
    if let Some(error) = unsaved {
        return Err(error);
    }
    let mut report =
        report.map_err(|error| JobError::Fail(error.to_string()))?.ok_or(JobError::Stopped)?;
    let of_spoon = spoon_version(spec, &report);
    let of_angles = report.is_worth_a_version();
    let accepted = of_angles || of_spoon.is_some();
    if let Some(numerics) = numerics {
        tell(&mut report, numerics);
    }
    let version = accepted.then(|| spec.version());
    report.simulator_version.extended.clone_from(&version);
    let mut extended = match campaign.as_ref().filter(|_| of_angles) {
        Some(of) => extend(of, &responses(of), &report)
            .map_err(|error| JobError::Fail(error.to_string()))?,
        None => None,
    };
    if let (Some(pourer), Some(extended)) = (&pourer, &mut extended) {
        pourer.fit(extended, &mut report, [judged_until, 1.0])?;
    }
    if let Some(of_spoon) = of_spoon {
        // Spoonfuls that were left out have verified it.
        report.simulator_version.verified |= !of_angles;
        extended = Some(extended.map_or(of_spoon.clone(), |angles| angles.and(of_spoon)));
    }
    report.read_from(&spec.files);
    report.simulator_runs += pourer.map_or(0, |pourer| pourer.poured());
    report.wall_s = began.elapsed().as_secs_f64();
    let body = serde_json::to_string(&Body::of(&report, extended))
        .map_err(|error| JobError::Fail(error.to_string()))?;
    let version = version.as_deref().map(|id| NewVersion { id, base: simulator, body: &body });
    host.finish(&Finished::Investigation { report: &report, version })
}

/// What the causes of spoonfuls add to the simulator, if any won.
fn spoon_version(spec: &InvestigationSpec, report: &Report) -> Option<Extended> {
    spoon::extended(report.spoon.as_ref()?, &spec.shakes.as_ref()?.calibrated)
}

/// Description stored with a simulator version.
#[derive(Serialize)]
struct Body<'a> {
    sentence: &'a str,
    /// The causes that were claimed; empty if the law of an unknown cause extends the simulator.
    causes: Vec<&'a CauseReport>,
    unexplained: &'a Option<Unexplained>,
    gain: &'a Option<Gain>,
    verified: bool,
    /// What the version simulates; absent if nothing recorded explains the departure.
    #[serde(flatten)]
    extended: Option<Extended>,
}

impl<'a> Body<'a> {
    fn of(report: &'a Report, extended: Option<Extended>) -> Self {
        let Report { sentence, causes, unexplained, gain, .. } = report;
        let causes =
            causes.iter().filter(|it| it.confidence_level > 1 && it.mechanism != CREEP).collect();
        Self {
            sentence,
            causes,
            unexplained,
            gain,
            verified: report.simulator_version.verified,
            extended,
        }
    }
}
