//! `flip.v1.Simulators`.

use super::convert::{all, page};
use super::proto::*;
use super::{Service, read, write};
use crate::app::ChosenSimulator;
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl simulators_server::Simulators for Service {
    async fn list_simulators(
        &self,
        request: Request<ListSimulatorsRequest>,
    ) -> Result<Response<ListSimulatorsResponse>, Status> {
        let found = self.app.simulators(page(read(request)?.page)).await?;
        let found = self.app.all_labelled(found).await?;
        Ok(Response::new(ListSimulatorsResponse { items: all(found.items), next: found.next }))
    }

    async fn get_simulator(
        &self,
        request: Request<GetSimulatorRequest>,
    ) -> Result<Response<SimulatorVersion>, Status> {
        let found = self.app.simulator(&read(request)?.id).await?;
        Ok(Response::new(self.app.labelled(found).await?.into()))
    }

    async fn predict(
        &self,
        request: Request<PredictRequest>,
    ) -> Result<Response<PredictResponse>, Status> {
        let PredictRequest { id, measurements_csv } = write(request)?;
        Ok(Response::new(PredictResponse {
            rows: all(self.app.predict(&id, &measurements_csv).await?),
        }))
    }

    async fn get_current_simulator(
        &self,
        request: Request<GetCurrentSimulatorRequest>,
    ) -> Result<Response<CurrentSimulator>, Status> {
        read(request)?;
        Ok(Response::new(self.app.current_simulator().await?.into()))
    }

    async fn choose_simulator(
        &self,
        request: Request<ChooseSimulatorRequest>,
    ) -> Result<Response<CurrentSimulator>, Status> {
        let ChooseSimulatorRequest { simulator, reason } = write(request)?;
        let chosen = ChosenSimulator { simulator, reason };
        Ok(Response::new(self.app.choose_simulator(&chosen).await?.into()))
    }
}
