//! `flip.v1.Trainings`.

use super::convert::{all, conditions, given, labels, named, page};
use super::evaluations::spoon;
use super::proto::*;
use super::{Service, read, write};
use crate::app::TrainingRequest;
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl trainings_server::Trainings for Service {
    async fn start_training(
        &self,
        request: Request<StartTrainingRequest>,
    ) -> Result<Response<StartJobResponse>, Status> {
        let asked = write(request)?;
        let request = TrainingRequest {
            order: named::<Order, _>("order", asked.order)?.unwrap_or_default(),
            preset: named::<Preset, _>("preset", asked.preset)?.unwrap_or_default(),
            episodes: asked.episodes,
            surrogate_episodes: asked.surrogate_episodes,
            powders: given(asked.powders),
            from: asked.from,
            device: named::<Device, _>("device", asked.device)?.unwrap_or_default(),
            gradients: named::<Gradients, _>("gradients", asked.gradients)?,
            seed: asked.seed,
            simulator: asked.simulator,
            conditions: conditions(asked.conditions),
            labels: labels(asked.labels),
            as_calibrated: asked.as_calibrated,
            spoon: spoon(asked.spoon),
        };
        Ok(Response::new(self.app.start_training(request).await?.into()))
    }

    async fn list_trainings(
        &self,
        request: Request<ListTrainingsRequest>,
    ) -> Result<Response<ListTrainingsResponse>, Status> {
        let found = self.app.trainings(page(read(request)?.page)).await?;
        let found = self.app.all_labelled(found).await?;
        Ok(Response::new(ListTrainingsResponse { items: all(found.items), next: found.next }))
    }

    async fn get_training(
        &self,
        request: Request<GetTrainingRequest>,
    ) -> Result<Response<Training>, Status> {
        let found = self.app.training(&read(request)?.id).await?;
        Ok(Response::new(self.app.labelled(found).await?.into()))
    }

    async fn list_episodes(
        &self,
        request: Request<ListEpisodesRequest>,
    ) -> Result<Response<ListEpisodesResponse>, Status> {
        let request = read(request)?;
        let found = self.app.training_episodes(&request.training, page(request.page)).await?;
        Ok(Response::new(ListEpisodesResponse { items: all(found.items), next: found.next }))
    }
}
