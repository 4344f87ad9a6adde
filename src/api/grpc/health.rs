//! The gRPC health service, which reports what `/readyz` reports over HTTP.

use crate::app::App;
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;

/// Names that the health service knows; the empty name stands for the whole service.
const SERVICES: [&str; 15] = [
    "",
    "flip.v1.Powders",
    "flip.v1.Calibrations",
    "flip.v1.Trainings",
    "flip.v1.Policies",
    "flip.v1.Evaluations",
    "flip.v1.Investigations",
    "flip.v1.Simulators",
    "flip.v1.Shakes",
    "flip.v1.Weighings",
    "flip.v1.Films",
    "flip.v1.Bench",
    "flip.v1.ReposeMeasurements",
    "flip.v1.Jobs",
    "flip.v1.Tokens",
];

/// Those that need the bench; the others keep serving while it is latched. The empty name stands
/// for the whole service, whose purpose is weighing.
const NEED_THE_BENCH: [&str; 4] =
    ["", "flip.v1.Weighings", "flip.v1.Bench", "flip.v1.ReposeMeasurements"];
/// How often readiness is checked.
const LOOK: Duration = Duration::from_secs(1);

/// Keeps reporting what `/readyz` would; once `closing` is cancelled, reports that nothing serves.
pub(super) async fn report(app: App, reporter: HealthReporter, closing: CancellationToken) {
    // The data folder was opened a moment ago and found sound.
    for name in SERVICES {
        reporter.set_service_status(name, ServingStatus::Serving).await;
    }
    while !closing.is_cancelled() {
        let found = app.readiness().await;
        let store_is_ready = found.checks.store_is_ready();
        for name in SERVICES {
            let serves = if NEED_THE_BENCH.contains(&name) { found.ready } else { store_is_ready };
            let status = if serves { ServingStatus::Serving } else { ServingStatus::NotServing };
            reporter.set_service_status(name, status).await;
        }
        closing.run_until_cancelled(tokio::time::sleep(LOOK)).await;
    }
    for name in SERVICES {
        reporter.set_service_status(name, ServingStatus::NotServing).await;
    }
}
