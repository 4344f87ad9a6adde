//! `flip.v1.Powders`.

use super::convert::{all, given, missing, named, page};
use super::proto::*;
use super::{Service, read, write};
use crate::app;
use flip_core::domain::parameters::PARAMETERS;
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl powders_server::Powders for Service {
    async fn list_powders(
        &self,
        request: Request<ListPowdersRequest>,
    ) -> Result<Response<ListPowdersResponse>, Status> {
        let found = self.app.powders(page(read(request)?.page)).await?;
        Ok(Response::new(ListPowdersResponse { items: all(found.items), next: found.next }))
    }

    async fn get_powder(
        &self,
        request: Request<GetPowderRequest>,
    ) -> Result<Response<PowderDetail>, Status> {
        Ok(Response::new(self.app.powder(&read(request)?.id).await?.into()))
    }

    async fn get_powder_card(
        &self,
        request: Request<GetPowderCardRequest>,
    ) -> Result<Response<PowderCard>, Status> {
        let GetPowderCardRequest { id, lot, bench } = read(request)?;
        let bench =
            bench.as_deref().map(|name| super::shakes::bench_kind("bench", name)).transpose()?;
        Ok(Response::new(self.app.powder_card(&id, lot.as_deref(), bench).await?.into()))
    }

    async fn create_powder(
        &self,
        request: Request<CreatePowderRequest>,
    ) -> Result<Response<Powder>, Status> {
        let CreatePowderRequest { id, name, soluble } = write(request)?;
        let new = app::NewPowder { id, name, soluble };
        Ok(Response::new(self.app.create_powder(new).await?.into()))
    }

    async fn add_measurement(
        &self,
        request: Request<AddMeasurementRequest>,
    ) -> Result<Response<Measurement>, Status> {
        let request = write(request)?;
        let method = named::<Method, _>("method", request.method)?;
        let new = app::NewMeasurement {
            method: method.ok_or_else(|| missing("method"))?,
            repose_deg: request.repose_deg,
            // Clients that predate the three forms omit a zero.
            sd_deg: request.sd_deg.or(request.repose_deg.map(|_| 0.0)),
            n: request.n.or(request.repose_deg.map(|_| 0)),
            repeats_deg: given(request.repeats_deg),
            heights_mm: given(request.heights_mm),
            base_diameters_mm: given(request.base_diameters_mm),
            funnel_height_mm: request.funnel_height_mm,
            source: request.source,
        };
        Ok(Response::new(self.app.add_measurement(&request.powder, new).await?.into()))
    }

    async fn add_observation(
        &self,
        request: Request<AddObservationRequest>,
    ) -> Result<Response<PowderObservation>, Status> {
        let AddObservationRequest { powder, observable, mean, sd, n, source } = write(request)?;
        let observable = observable.and_then(Into::into).ok_or_else(|| missing("observable"))?;
        let new = app::NewObservation { observable, mean, sd, n, source };
        Ok(Response::new(self.app.add_observation(&powder, new).await?.into()))
    }

    async fn list_observations(
        &self,
        request: Request<ListObservationsRequest>,
    ) -> Result<Response<ListObservationsResponse>, Status> {
        let request = read(request)?;
        let found = self.app.observations(&request.powder, page(request.page)).await?;
        Ok(Response::new(ListObservationsResponse { items: all(found.items), next: found.next }))
    }

    async fn list_parameters(
        &self,
        request: Request<ListParametersRequest>,
    ) -> Result<Response<ListParametersResponse>, Status> {
        read(request)?;
        Ok(Response::new(ListParametersResponse { items: all(PARAMETERS.to_vec()) }))
    }

    async fn list_parameter_sets(
        &self,
        request: Request<ListParameterSetsRequest>,
    ) -> Result<Response<ListParameterSetsResponse>, Status> {
        let request = read(request)?;
        let found = self.app.parameter_sets(request.powder.as_deref(), page(request.page)).await?;
        Ok(Response::new(ListParameterSetsResponse { items: all(found.items), next: found.next }))
    }

    async fn get_parameter_set(
        &self,
        request: Request<GetParameterSetRequest>,
    ) -> Result<Response<CalibratedSet>, Status> {
        Ok(Response::new(self.app.parameter_set(&read(request)?.id).await?.into()))
    }
}
