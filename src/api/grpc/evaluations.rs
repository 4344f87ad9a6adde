//! `flip.v1.Evaluations`.

use super::convert::{all, conditions, given, labels, named, page};
use super::proto::*;
use super::{Service, read, write};
use crate::app::EvaluationRequest;
use flip_core::domain::spoon;
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl evaluations_server::Evaluations for Service {
    async fn start_evaluation(
        &self,
        request: Request<StartEvaluationRequest>,
    ) -> Result<Response<StartJobResponse>, Status> {
        let asked = write(request)?;
        let request = EvaluationRequest {
            policy: asked.policy,
            controllers: given(asked.controllers),
            powders: given(asked.powders),
            targets_mg: given(asked.targets_mg),
            repeats: asked.repeats,
            readability_mg: asked.readability_mg,
            max_shakes: asked.max_shakes,
            particles: asked.particles,
            extensions: asked.extensions.into_iter().collect(),
            as_calibrated: asked.as_calibrated,
            substep_us: asked.substep_us,
            spoon: spoon(asked.spoon),
            device: named::<Device, _>("device", asked.device)?.unwrap_or_default(),
            seed: asked.seed,
            simulator: asked.simulator,
            conditions: conditions(asked.conditions),
            labels: labels(asked.labels),
        };
        Ok(Response::new(self.app.start_evaluation(request).await?.into()))
    }

    async fn list_evaluations(
        &self,
        request: Request<ListEvaluationsRequest>,
    ) -> Result<Response<ListEvaluationsResponse>, Status> {
        let found = self.app.evaluations(page(read(request)?.page)).await?;
        let found = self.app.all_labelled(found).await?;
        Ok(Response::new(ListEvaluationsResponse { items: all(found.items), next: found.next }))
    }

    async fn get_evaluation(
        &self,
        request: Request<GetEvaluationRequest>,
    ) -> Result<Response<Evaluation>, Status> {
        let found = self.app.evaluation(&read(request)?.id).await?;
        Ok(Response::new(self.app.labelled(found).await?.into()))
    }
}

/// A spoon as measured.
pub(super) fn spoon(measured: Option<Spoon>) -> Option<spoon::Spoon> {
    measured.map(|Spoon { capacity_mg, length_mm, width_mm, depth_mm }| spoon::Spoon {
        capacity_mg,
        length_mm,
        width_mm,
        depth_mm,
        ..spoon::Spoon::default()
    })
}
