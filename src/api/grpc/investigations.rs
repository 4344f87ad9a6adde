//! `flip.v1.Investigations`.

use super::convert::{all, labels, named, page};
use super::proto::*;
use super::shakes::stored_shakes;
use super::{Service, read, write};
use crate::app::InvestigationRequest;
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl investigations_server::Investigations for Service {
    async fn start_investigation(
        &self,
        request: Request<StartInvestigationRequest>,
    ) -> Result<Response<StartJobResponse>, Status> {
        let StartInvestigationRequest {
            measurements_csv,
            traces_csv,
            dates,
            simulations,
            seed,
            budget_runs,
            shakes_csv,
            shakes,
            budget_replays,
            labels: written,
        } = write(request)?;
        let shakes = shakes.map(stored_shakes).transpose()?;
        let dates = named::<DateOrder, _>("dates", dates.unwrap_or_default())?;
        let request = InvestigationRequest {
            measurements_csv,
            traces_csv,
            shakes_csv,
            shakes,
            budget_replays,
            dates,
            simulations,
            budget_runs,
            seed,
            labels: labels(written),
        };
        Ok(Response::new(self.app.start_investigation(request).await?.into()))
    }

    async fn list_investigations(
        &self,
        request: Request<ListInvestigationsRequest>,
    ) -> Result<Response<ListInvestigationsResponse>, Status> {
        let found = self.app.investigations(page(read(request)?.page)).await?;
        let found = self.app.all_labelled(found).await?;
        Ok(Response::new(ListInvestigationsResponse { items: all(found.items), next: found.next }))
    }

    async fn get_investigation(
        &self,
        request: Request<GetInvestigationRequest>,
    ) -> Result<Response<Investigation>, Status> {
        let found = self.app.investigation(&read(request)?.id).await?;
        Ok(Response::new(self.app.labelled(found).await?.into()))
    }
}
