//! Measures an angle of repose by camera: pile after pile, until the requested number has an angle.
//!
//! Every pile is stored with its raw frames, whatever they show. After a crash the interrupted pile
//! is made again and earlier piles are kept: the platform is turned over the funnel first, so
//! powder that had already run out runs again.

use super::bench::audit_exchanges;
use super::context::{JobContext, JobError};
use super::spec::ReposeSpec;
use flip_bench::hardware::camera::Upload;
use flip_bench::pile::{self, Repeats};
use flip_bench::rig::{PileStand, Piling, Unpiled};
use flip_core::domain::bench::BenchKind;
use flip_core::domain::job::Progress;
use flip_core::domain::powder::Method;
use flip_core::domain::seed::derive;
use flip_sim::repose as heap;
use flip_store::artifacts::Artifacts;
use flip_store::audit::About;
use flip_store::piles::{FrameFiles, Pile};
use flip_store::said::{Row, RowOf};
use flip_store::{self as store, now};
use serde::{Deserialize, Serialize};
use std::sync::atomic::Ordering;

/// Number of piles beyond those requested that may have no angle before the measurement gives up.
const SPARE: u32 = 2;

/// Result of a measurement by camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ReposeResult {
    /// Angles by both estimators.
    pub repeats: Repeats,
    /// Whether it is now the powder's newest measurement. Not on an emulated bench, where no real
    /// powder was measured.
    pub registered: bool,
}

pub(super) fn perform(context: &JobContext, spec: &ReposeSpec) -> Result<(), JobError> {
    let rig = &context.functions.rig;
    let Some(stand) = rig.stand().filter(|_| rig.kind() == spec.bench) else {
        let cause = "this process has another bench than the one it was asked for: start it with that bench, and ask again";
        return Err(JobError::Fail(cause.to_owned()));
    };
    let wanted = spec.procedure.repeats;
    let mut piles = context.read(context.store.piles(context.id()))?;
    let measured = loop {
        let measured: Vec<_> = piles.iter().filter_map(|pile| pile.measured).collect();
        if measured.len() as u32 >= wanted {
            break measured;
        }
        if piles.len() as u32 >= wanted + SPARE {
            return Err(JobError::Fail(without_angle(&piles)));
        }
        if let Some(latch) = context.read(context.store.latch())? {
            let cause = format!(
                "the bench is latched: {}. Look at it, clear it, and ask for a new measurement",
                latch.reason
            );
            return Err(JobError::Fail(cause));
        }
        if context.held.load(Ordering::SeqCst) {
            let cause = "the bench is held after a stop: resume it, and ask for a new measurement";
            return Err(JobError::Fail(cause.to_owned()));
        }
        let number = piles.len() as u32 + 1;
        let taken = made(context, spec, stand, number, measured.len() as u32);
        let exchanges = stand.exchanges();
        let pile = match taken {
            Ok(taken) => Ok(looked_at(spec, number, &taken, context.store.artifacts())?),
            Err(error) => Err(error),
        };
        context.save(async |tx| {
            audit_exchanges(tx, None, &exchanges, now()).await?;
            let Ok(pile) = &pile else { return Ok(false) };
            let said = serde_json::json!({ "measurement": context.id(), "powder": spec.powder, "pile": pile });
            tx.audit(About { weighing: None, kind: "pile" }, &said, now()).await?;
            tx.insert_pile(context.id(), pile).await?;
            context.tell(tx, "pile", pile).await?;
            Ok(true)
        })?;
        piles.push(pile?);
    };
    let repeats = pile::repeats(&measured).map_err(|error| JobError::Fail(error.to_string()))?;
    let registered = spec.bench == BenchKind::Devices;
    let source = format!("camera, measurement {}, {} piles", context.id(), piles.len());
    context.succeed(&ReposeResult { repeats, registered }, async |tx| {
        if registered {
            let made = tx
                .insert_measurement(&spec.powder, Method::Automated, repeats.tip, &source)
                .await?;
            tx.audit_rows(vec![Row::of(RowOf::Measurement, &made.id, &made)]).await?;
        }
        Ok(())
    })?;
    Ok(())
}

/// One pile and its frames.
fn made(
    context: &JobContext,
    spec: &ReposeSpec,
    stand: &PileStand,
    number: u32,
    done: u32,
) -> Result<Vec<Upload>, JobError> {
    let seed = derive(u64::from(spec.run), &[u64::from(number)]);
    let truth =
        spec.set.map(|set| (context.functions.simulate)(&set, &heap::Settings::default(), seed));
    let truth = truth
        .transpose()
        .map_err(|error| JobError::Fail(format!("the simulated powder makes no pile: {error}")))?;
    let piling = Piling {
        job: context.id(),
        number,
        procedure: &spec.procedure,
        cone_deg: truth.map(|heap| heap.tip_deg),
        seed,
    };
    let mut unsaved = None;
    let taken = stand.make(&piling, &context.held, &mut |what| {
        let fraction = f64::from(done) / f64::from(spec.procedure.repeats);
        let progress = Progress { fraction, message: format!("pile {number}: {what}") };
        // The owner of the gate must stay responsive to a stop, whatever holds the database.
        super::calibrate::unless(context.report_meanwhile(&progress), &mut unsaved, context)
    });
    match (unsaved, taken) {
        (Some(error), _) => Err(error.into()),
        (None, Ok(taken)) => Ok(taken),
        (None, Err(Unpiled::Stopped)) => Err(JobError::Stopped),
        (None, Err(Unpiled::Failed(cause))) => {
            Err(JobError::Fail(format!("pile {number}: {cause}")))
        }
    }
}

/// Stores the frames, and measures what they show.
fn looked_at(
    spec: &ReposeSpec,
    number: u32,
    taken: &[Upload],
    artifacts: &Artifacts,
) -> store::Result<Pile> {
    let kept = |frame: &Upload| {
        Ok(FrameFiles {
            depth: artifacts.put(&frame.depth)?,
            colour: artifacts.put(&frame.colour)?,
            description: artifacts.put(&frame.description)?,
        })
    };
    let files = taken.iter().map(kept).collect::<store::Result<_>>()?;
    let decoded: Result<Vec<_>, _> = taken.iter().map(Upload::decode).collect();
    let found = match decoded {
        Ok(frames) => {
            pile::measure(&frames, &spec.rig, &spec.limits).map_err(|refusal| refusal.to_string())
        }
        Err(error) => Err(error.to_string()),
    };
    let (measured, refusal) = match found {
        Ok(measured) => (Some(measured), None),
        Err(refusal) => (None, Some(refusal)),
    };
    Ok(Pile { number, at: now(), measured, refusal, frames: files })
}

fn without_angle(piles: &[Pile]) -> String {
    let refusals = piles
        .iter()
        .filter_map(|pile| Some(format!("pile {}: {}", pile.number, pile.refusal.as_ref()?)));
    let refusals: Vec<String> = refusals.collect();
    format!("{} of {} piles have no angle: {}", refusals.len(), piles.len(), refusals.join("; "))
}
