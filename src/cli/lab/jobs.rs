//! Jobs of every kind, and what comes of them.

use super::super::server::Request;
use super::{Lab, Look};
use crate::app::{
    Calibration, CalibrationRequest, Comparison, Error, Evaluation, EvaluationRequest, Film,
    FilmRequest, Investigation, InvestigationRequest, Job, JobTimes, JobsWanted, LabelWanted, Page,
    PageQuery, Posterior, ReposeMeasurement, ReposeRequest, Result, Row, Training, TrainingRequest,
    Worker, predictions_of_csv,
};
use serde::Serialize;

/// A request for a job that is found again if it is asked for again.
fn job(resource: &str, request: &impl Serialize) -> Result<Request> {
    Ok(Request::post(&[resource], request)?.repeatable())
}

impl Lab {
    pub(in super::super) async fn jobs(
        &self,
        wanted: JobsWanted,
        page: PageQuery,
    ) -> Result<Page<Job>> {
        match self {
            Self::Here(app) => app.jobs(wanted, page).await,
            Self::There(server) => {
                let JobsWanted { kind, state, label } = wanted;
                let label = label.map(|LabelWanted { key, value }| format!("{key}:{value}"));
                let list = Request::get(&["jobs"]).with_word("kind", kind);
                let list = list.with_word("state", state).with("label", label);
                server.ask(list.page(&page)).await
            }
        }
    }

    pub(in super::super) async fn job_times(&self) -> Result<Vec<JobTimes>> {
        match self {
            Self::Here(app) => app.job_times().await,
            Self::There(server) => server.get(&["jobs", "times"]).await,
        }
    }

    pub(in super::super) async fn workers(&self) -> Result<Vec<Worker>> {
        match self {
            Self::Here(app) => app.workers().await,
            Self::There(server) => server.get(&["workers"]).await,
        }
    }

    /// A job as it is now.
    pub(in super::super) async fn job(&self, id: &str) -> Result<Job> {
        match self {
            Self::Here(app) => app.job(id).await,
            Self::There(server) => server.get(&["jobs", id]).await,
        }
    }

    /// A job after a while, or once it has ended.
    pub(in super::super) async fn job_later(&self, id: &str, look: Look) -> Result<Job> {
        match self {
            Self::Here(app) => {
                tokio::time::sleep(look.here).await;
                app.job(id).await
            }
            Self::There(server) => server.ask(Request::get(&["jobs", id]).wait(look.there_s)).await,
        }
    }

    pub(in super::super) async fn start_calibration(
        &self,
        request: CalibrationRequest,
    ) -> Result<(Job, bool)> {
        match self {
            Self::Here(app) => app.start_calibration(request).await,
            Self::There(server) => server.start(job("calibrations", &request)?).await,
        }
    }

    pub(in super::super) async fn calibration(&self, id: &str) -> Result<Calibration> {
        match self {
            Self::Here(app) => app.calibration(id).await,
            Self::There(server) => server.get(&["calibrations", id]).await,
        }
    }

    pub(in super::super) async fn posterior(&self, id: &str) -> Result<Posterior> {
        match self {
            Self::Here(app) => app.posterior(id).await,
            Self::There(server) => server.get(&["calibrations", id, "posterior"]).await,
        }
    }

    pub(in super::super) async fn compare_calibrations(
        &self,
        id: &str,
        with: &str,
    ) -> Result<Comparison> {
        match self {
            Self::Here(app) => app.compare_calibrations(id, with).await,
            Self::There(server) => {
                let compare = Request::get(&["calibrations", id, "compare"]);
                server.ask(compare.with("with", Some(with))).await
            }
        }
    }

    pub(in super::super) async fn start_training(
        &self,
        request: TrainingRequest,
    ) -> Result<(Job, bool)> {
        match self {
            Self::Here(app) => app.start_training(request).await,
            Self::There(server) => server.start(job("trainings", &request)?).await,
        }
    }

    pub(in super::super) async fn training(&self, id: &str) -> Result<Training> {
        match self {
            Self::Here(app) => app.training(id).await,
            Self::There(server) => server.get(&["trainings", id]).await,
        }
    }

    pub(in super::super) async fn start_evaluation(
        &self,
        request: EvaluationRequest,
    ) -> Result<(Job, bool)> {
        match self {
            Self::Here(app) => app.start_evaluation(request).await,
            Self::There(server) => server.start(job("evaluations", &request)?).await,
        }
    }

    pub(in super::super) async fn evaluation(&self, id: &str) -> Result<Evaluation> {
        match self {
            Self::Here(app) => app.evaluation(id).await,
            Self::There(server) => server.get(&["evaluations", id]).await,
        }
    }

    pub(in super::super) async fn start_film(&self, request: FilmRequest) -> Result<(Job, bool)> {
        match self {
            Self::Here(app) => app.start_film(request).await,
            Self::There(server) => server.start(job("films", &request)?).await,
        }
    }

    pub(in super::super) async fn film(&self, id: &str) -> Result<Film> {
        match self {
            Self::Here(app) => app.film(id).await,
            Self::There(server) => server.get(&["films", id]).await,
        }
    }

    /// The grains of a film.
    pub(in super::super) async fn film_file(&self, id: &str) -> Result<Vec<u8>> {
        match self {
            Self::Here(app) => Ok(app.film_file(id).await?.1),
            Self::There(server) => {
                Ok(server.answer(Request::get(&["films", id, "grains"])).await?.body)
            }
        }
    }

    pub(in super::super) async fn start_investigation(
        &self,
        request: InvestigationRequest,
    ) -> Result<(Job, bool)> {
        match self {
            Self::Here(app) => app.start_investigation(request).await,
            Self::There(server) => server.start(job("investigations", &request)?).await,
        }
    }

    pub(in super::super) async fn investigation(&self, id: &str) -> Result<Investigation> {
        match self {
            Self::Here(app) => app.investigation(id).await,
            Self::There(server) => server.get(&["investigations", id]).await,
        }
    }

    pub(in super::super) async fn predict(&self, simulator: &str, csv: &str) -> Result<Vec<Row>> {
        match self {
            Self::Here(app) => app.predict(simulator, csv).await,
            Self::There(server) => {
                let body = serde_json::json!({ "measurements_csv": csv });
                let path = ["simulators", simulator, "predictions"];
                let request = Request::post(&path, &body)?.repeatable().long();
                let table = server.answer(request).await?.text()?;
                predictions_of_csv(&table).ok_or_else(|| {
                    Error::Unavailable("the server answers with another table".to_owned())
                })
            }
        }
    }

    /// Queues a measurement by camera. Without the number of its run it is another one each time, so
    /// it is asked for once.
    pub(in super::super) async fn start_repose(
        &self,
        request: ReposeRequest,
    ) -> Result<(Job, bool)> {
        match self {
            Self::Here(app) => app.start_repose(request).await,
            Self::There(server) => {
                let is_numbered = request.run.is_some();
                let request = Request::post(&["repose-measurements"], &request)?;
                server.start(if is_numbered { request.repeatable() } else { request }).await
            }
        }
    }

    pub(in super::super) async fn repose(&self, id: &str) -> Result<ReposeMeasurement> {
        match self {
            Self::Here(app) => app.repose(id).await,
            Self::There(server) => server.get(&["repose-measurements", id]).await,
        }
    }
}
