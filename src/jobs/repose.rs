//! Measures an angle of repose by camera: pile after pile, until the requested number has an angle.
//!
//! Every pile is stored with its raw frames, whatever they show. After a crash the interrupted pile
//! is made again and earlier piles are kept: the platform is turned over the funnel first, so
//! powder that had already run out runs again.

use super::Functions;
use super::host::{Finished, JobError, JobHost, Piece, Result, go_on};
use super::runner::HeapExperiment;
use super::spec::ReposeSpec;
use flip_bench::hardware::camera::Upload;
use flip_bench::pile::{self, Repeats};
use flip_bench::rig::{PileStand, Piling, Unpiled};
use flip_core::domain::bench::BenchKind;
use flip_core::domain::job::Progress;
use flip_core::domain::seed::derive;
use flip_sim::repose::Settings;
use flip_store::now;
use flip_store::piles::{FrameFiles, Pile};
use serde::{Deserialize, Serialize};
use std::sync::atomic::Ordering;

/// Number of piles beyond those requested that may have no angle before the measurement gives up.
const SPARE: u32 = 2;

/// Result of a measurement by camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ReposeResult {
    /// Angles by both estimators.
    pub repeats: Repeats,
    /// Whether it is now the powder's newest measurement. Not on an emulated bench, where no real
    /// powder was measured.
    pub registered: bool,
}

pub(super) fn perform(host: &dyn JobHost, functions: &Functions, spec: &ReposeSpec) -> Result<()> {
    let rig = &functions.rig;
    let Some(stand) = rig.stand().filter(|_| rig.kind() == spec.bench) else {
        let cause = "this process has another bench than the one it was asked for: start it with that bench, and ask again";
        return Err(JobError::Fail(cause.to_owned()));
    };
    let wanted = spec.procedure.repeats;
    let mut piles = host.piles()?;
    let measured = loop {
        let measured: Vec<_> = piles.iter().filter_map(|pile| pile.measured).collect();
        if measured.len() as u32 >= wanted {
            break measured;
        }
        if piles.len() as u32 >= wanted + SPARE {
            return Err(JobError::Fail(without_angle(&piles)));
        }
        if let Some(reason) = host.latch()? {
            let cause = format!(
                "the bench is latched: {reason}. Look at it, clear it, and ask for a new measurement"
            );
            return Err(JobError::Fail(cause));
        }
        if host.held().load(Ordering::SeqCst) {
            let cause = "the bench is held after a stop: resume it, and ask for a new measurement";
            return Err(JobError::Fail(cause.to_owned()));
        }
        let number = piles.len() as u32 + 1;
        let taken = made(host, functions, spec, stand, number, measured.len() as u32);
        let exchanges = stand.exchanges();
        let pile = match taken {
            Ok(taken) => Ok(looked_at(host, spec, number, &taken)?),
            Err(error) => Err(error),
        };
        let powder = &spec.powder;
        host.save(Piece::Pile { powder, exchanges: &exchanges, pile: pile.as_ref().ok() })?;
        piles.push(pile?);
    };
    let repeats = pile::repeats(&measured).map_err(|error| JobError::Fail(error.to_string()))?;
    let result = ReposeResult { repeats, registered: spec.bench == BenchKind::Devices };
    let source = format!("camera, measurement {}, {} piles", host.id(), piles.len());
    host.finish(&Finished::Repose { spec, result: &result, source: &source })
}

/// One pile and its frames.
fn made(
    host: &dyn JobHost,
    functions: &Functions,
    spec: &ReposeSpec,
    stand: &PileStand,
    number: u32,
    done: u32,
) -> Result<Vec<Upload>> {
    let seed = derive(u64::from(spec.run), &[u64::from(number)]);
    let settings = Settings::default();
    let experiment: Vec<_> =
        spec.set.iter().map(|set| HeapExperiment { set: *set, settings, seed }).collect();
    let truth = functions.simulate.run_all(&experiment).into_iter().next();
    let truth = truth
        .map(|run| run.outcome)
        .transpose()
        .map_err(|error| JobError::Fail(format!("the simulated powder makes no pile: {error}")))?;
    let piling = Piling {
        job: host.id(),
        number,
        procedure: &spec.procedure,
        cone_deg: truth.map(|heap| heap.tip_deg),
        seed,
    };
    let mut unsaved = None;
    let taken = stand.make(&piling, host.held(), &mut |what| {
        let fraction = f64::from(done) / f64::from(spec.procedure.repeats);
        let progress = Progress { fraction, message: format!("pile {number}: {what}") };
        // The owner of the gate must stay responsive to a stop, whatever holds the database.
        go_on(host, host.report_meanwhile(&progress), &mut unsaved)
    });
    match (unsaved, taken) {
        (Some(error), _) => Err(error),
        (None, Ok(taken)) => Ok(taken),
        (None, Err(Unpiled::Stopped)) => Err(JobError::Stopped),
        (None, Err(Unpiled::Failed(cause))) => {
            Err(JobError::Fail(format!("pile {number}: {cause}")))
        }
    }
}

/// Stores the frames, and measures what they show.
fn looked_at(host: &dyn JobHost, spec: &ReposeSpec, number: u32, taken: &[Upload]) -> Result<Pile> {
    let kept = |frame: &Upload| {
        Ok(FrameFiles {
            depth: host.put(&frame.depth)?,
            colour: host.put(&frame.colour)?,
            description: host.put(&frame.description)?,
        })
    };
    let files = taken.iter().map(kept).collect::<Result<_>>()?;
    let decoded: std::result::Result<Vec<_>, _> = taken.iter().map(Upload::decode).collect();
    let found = match decoded {
        Ok(frames) => {
            pile::look(&frames, &spec.rig, &spec.limits).map_err(|refusal| refusal.to_string())
        }
        Err(error) => Err(error.to_string()),
    };
    let (measured, outline, refusal) = match found {
        Ok((measured, outline)) => (Some(measured), Some(outline), None),
        Err(refusal) => (None, None, Some(refusal)),
    };
    Ok(Pile { number, at: now(), measured, refusal, frames: files, outline })
}

fn without_angle(piles: &[Pile]) -> String {
    let refusals = piles
        .iter()
        .filter_map(|pile| Some(format!("pile {}: {}", pile.number, pile.refusal.as_ref()?)));
    let refusals: Vec<String> = refusals.collect();
    format!("{} of {} piles have no angle: {}", refusals.len(), piles.len(), refusals.join("; "))
}
