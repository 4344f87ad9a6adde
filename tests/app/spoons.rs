//! An investigation of shakes: a spoon that differs from the simulated one is found, named and made
//! a version, which weighings use; one that does not is left alone.

use super::harness::*;
use flip::app::{
    App, CalibrationMethod, CalibrationRequest, Error, Functions, InvestigationRequest, JobState,
    Report, StoredShakes, Verdict,
};
use flip::jobs::spoons_on_cores;
use flip_sim::replay::{Replay, Replayed};
use std::fmt::Write;

/// A spoon by formula: a powder starts to flow at a pitch that adhesion raises, and gives more above
/// it, unless its grains attract each other.
pub fn replay(of: &Replay) -> Replayed {
    let onset_deg = 20.0 + 6.0 * of.settings.extensions.spoon_adhesion;
    let slope_mg = 0.25 / (1.0 + of.settings.extensions.consolidation);
    let noise = |k: usize| {
        let mixed = (of.seed ^ (k as u64) << 40).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        ((mixed >> 40) as f64 / f64::from(1 << 24) - 0.5) * 0.3
    };
    let fell = |(k, step): (usize, &flip_sim::replay::Step)| {
        let above_deg = (step.pitch_deg - onset_deg).max(0.0);
        slope_mg * above_deg * step.shake_mm / 8.0 * (1.0 + noise(k))
    };
    Replayed {
        filled_mg: 40.0,
        fell_mg: of.steps.iter().enumerate().map(fell).collect(),
        spilled_mg: 0.0,
    }
}

fn replaying() -> Functions {
    Functions { replay: spoons_on_cores(|of| Ok(replay(of))), ..functions() }
}

/// Spoonfuls of sand on six days, of a spoon with so much adhesion, as the 0.1 mg display of a
/// balance shows them.
pub fn shakes(adhesion: f64) -> String {
    let mut csv = String::from(
        "weighing,spoonful,powder,session,readability_mg,pitch_deg,shake_mm,fell_mg\n",
    );
    for day in 1..=6 {
        let steps: Vec<[f64; 2]> = (0..9)
            .map(|k| [16.0 + 4.0 * f64::from(k), if day % 2 == 0 { 8.0 } else { 16.0 }])
            .collect();
        let mut of = Replay {
            set: Default::default(),
            settings: Default::default(),
            steps: steps
                .iter()
                .map(|[pitch_deg, shake_mm]| flip_sim::replay::Step {
                    pitch_deg: *pitch_deg,
                    shake_mm: *shake_mm,
                    strokes: 1,
                    acceleration_m_s2: None,
                })
                .collect(),
            seed: 1000 + day,
        };
        of.settings.extensions.spoon_adhesion = adhesion;
        for ([pitch_deg, shake_mm], fell_mg) in steps.iter().zip(replay(&of).fell_mg) {
            writeln!(csv, "w-{day},1,sand,2026-11-0{day},0.1,{pitch_deg},{shake_mm},{fell_mg:.1}")
                .unwrap();
        }
    }
    csv
}

pub fn request(csv: String) -> InvestigationRequest {
    InvestigationRequest { shakes_csv: Some(csv), seed: Some(3), ..Default::default() }
}

async fn judged(app: &App, request: InvestigationRequest) -> Report {
    let (job, _) = app.start_investigation(request).await.unwrap();
    let job = ended(app, &job.id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    app.investigation(&job.id).await.unwrap().report.unwrap()
}

async fn calibrated() -> (tempfile::TempDir, App) {
    let (folder, app) = open(replaying()).await;
    let (job, _) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    assert_eq!(ended(&app, &job.id).await.state, JobState::Succeeded);
    (folder, app)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_spoon_that_sticks_is_found_named_and_becomes_a_version_and_the_simulators_own_is_not() {
    let (_folder, app) = calibrated().await;
    let own = judged(&app, request(shakes(0.0))).await;
    assert_eq!(own.verdict, Verdict::NoDiscrepancy, "{}", own.sentence);
    assert_eq!(own.simulator_version.extended, None);
    let of_sand = &own.spoon.as_ref().unwrap().powders[0];
    assert!(of_sand.causes.is_empty() && own.simulator_runs > 100, "{}", own.simulator_runs);

    let sticks = judged(&app, request(shakes(3.0))).await;
    assert_eq!(sticks.verdict, Verdict::Cause, "{}", sticks.sentence);
    assert_eq!(sticks.causes[0].mechanism, "spoon_adhesion");
    assert!(sticks.sentence.contains("adhesion to the spoon"), "{}", sticks.sentence);
    let gain = sticks.spoon.as_ref().unwrap().powders[0].gain.clone().unwrap();
    assert!(gain.accepted && 3.0 * gain.error_after_mg < gain.error_before_mg, "{gain:?}");
    let version = sticks.simulator_version.extended.clone().unwrap();
    assert!(sticks.simulator_version.verified);
    // The version is of this powder: its spoon sticks, and no angle changes.
    let again = flip::app::WeighingRequest { simulator: Some(version.clone()), ..mg("sand", 12.0) };
    let refused = app.start_weighing(again.clone(), "early").await;
    assert!(
        matches!(refused, Err(Error::Conflict { code: "calibration_missing", .. })),
        "{refused:?}"
    );
    let mut calibration = calibration_of("sand", 1);
    calibration.simulator = Some(version.clone());
    let (job, _) = app.start_calibration(calibration).await.unwrap();
    assert_eq!(ended(&app, &job.id).await.state, JobState::Succeeded);
    let (weighing, _) = app.start_weighing(again, "with").await.unwrap();
    let patch = app.weighing(&weighing.id).await.unwrap().weighing.patch;
    assert!((1.0..=6.0).contains(&patch.amplitudes["spoon_adhesion"]), "{patch:?}");
    let angles = app.predict(&version, "powder,repose_deg\nsand,30\n").await.unwrap_err();
    assert!(angles.to_string().contains("no angle"), "{angles}");
}

#[tokio::test(flavor = "multi_thread")]
async fn shakes_that_cannot_be_judged_are_refused_by_field() {
    let (_folder, app) = open(replaying()).await;
    let said = async |request: InvestigationRequest| match app.start_investigation(request).await {
        Err(Error::Invalid(errors)) => errors[0].to_string(),
        other => panic!("{other:?}"),
    };
    let uncalibrated = said(request(shakes(0.0))).await;
    assert!(uncalibrated.contains("shakes_csv") && uncalibrated.contains("calibrate"));
    let stored =
        InvestigationRequest { shakes: Some(StoredShakes::default()), ..Default::default() };
    assert!(said(stored.clone()).await.contains("hold 0 spoonfuls"));
    let both = InvestigationRequest { shakes_csv: Some(shakes(0.0)), ..stored };
    assert!(said(both).await.contains("leave `shakes` or `shakes_csv` out"));
    let few = InvestigationRequest { budget_replays: Some(10), ..request(shakes(0.0)) };
    assert!(said(few).await.contains("budget_replays"));
    let unknown =
        request("weighing,powder,pitch_deg,shake_mm,fell_mg,sd_mg\nw,dust,30,8,1,0.1\n".into());
    let unknown = said(unknown).await;
    assert!(unknown.contains("row[2].powder"), "{unknown}");
}

#[tokio::test(flavor = "multi_thread")]
async fn replays_are_stopped_and_begun_again() {
    let (_folder, app) = calibrated().await;
    let (job, _) = app.start_investigation(request(shakes(3.0))).await.unwrap();
    app.cancel_job(&job.id).await.unwrap();
    let job = ended(&app, &job.id).await;
    assert_eq!(job.state, JobState::Cancelled, "{:?}", job.error);
    assert_eq!(judged(&app, request(shakes(3.0))).await.verdict, Verdict::Cause);
}

#[tokio::test(flavor = "multi_thread")]
async fn angle_and_spoon_are_met_together_with_gravity_held() {
    let (_folder, app) = open(replaying()).await;
    let joint = |method| CalibrationRequest {
        powder: Some("sand".into()),
        method,
        sets: Some(2),
        shakes: Some(StoredShakes::default()),
        ..Default::default()
    };
    let said = async |request: CalibrationRequest| match app.start_calibration(request).await {
        Err(Error::Invalid(errors)) => errors[0].to_string(),
        other => panic!("{other:?}"),
    };
    let without = said(joint(None)).await;
    assert!(without.contains("shakes") && without.contains("0 spoonfuls"), "{without}");
    app.import_shakes(&shakes(0.0), "a test", false).await.unwrap();
    let sequential = said(joint(Some(CalibrationMethod::Sequential))).await;
    assert!(sequential.contains("emulator"), "{sequential}");
    let of_another = StoredShakes { powder: Some("salt".into()), ..StoredShakes::default() };
    let other = said(CalibrationRequest { shakes: Some(of_another), ..joint(None) }).await;
    assert!(other.contains("of the calibration's powder"), "{other}");

    let (job, _) = app.start_calibration(joint(None)).await.unwrap();
    let job = ended(&app, &job.id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    let calibration = app.calibration(&job.id).await.unwrap();
    let cells = &calibration.observations;
    assert!((1..=3).contains(&cells.len()), "{cells:?}");
    assert!(cells.iter().all(|it| it.observable.kind() == "shake_mass" && it.n >= 3), "{cells:?}");
    assert_eq!(calibration.settings["fixed"]["gravity_scale"], 1.0);
    let observed = calibration.result.unwrap().observed;
    assert_eq!(observed.len(), cells.len(), "each set was looked at");
}
