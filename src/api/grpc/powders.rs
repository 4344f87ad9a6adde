//! `flip.v1.Powders`.

use super::convert::{all, given, missing, named, page};
use super::proto::*;
use super::{Service, read, write};
use crate::api::problem::Problem;
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
        let found = self.app.all_labelled(found).await?;
        Ok(Response::new(ListPowdersResponse { items: all(found.items), next: found.next }))
    }

    async fn get_powder(
        &self,
        request: Request<GetPowderRequest>,
    ) -> Result<Response<PowderDetail>, Status> {
        let found = self.app.powder(&read(request)?.id).await?;
        Ok(Response::new(self.app.labelled(found).await?.into()))
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
        let CreatePowderRequest { id, name, soluble, measurement } = write(request)?;
        let measurement = measurement.map(measured).transpose()?;
        let new = app::NewPowder { id, name, soluble, measurement };
        Ok(Response::new(self.app.create_powder(new).await?.into()))
    }

    async fn add_measurement(
        &self,
        request: Request<AddMeasurementRequest>,
    ) -> Result<Response<Measurement>, Status> {
        let request = write(request)?;
        let powder = request.powder.clone();
        let new = measured(request)?;
        Ok(Response::new(self.app.add_measurement(&powder, new).await?.into()))
    }

    async fn add_observation(
        &self,
        request: Request<AddObservationRequest>,
    ) -> Result<Response<PowderObservation>, Status> {
        let (powder, new) = observed(write(request)?)?;
        Ok(Response::new(self.app.add_observation(&powder, new).await?.into()))
    }

    async fn withdraw_measurement(
        &self,
        request: Request<WithdrawRequest>,
    ) -> Result<Response<Measurement>, Status> {
        let WithdrawRequest { powder, id, reason } = write(request)?;
        let reason = app::WithdrawalRequest { reason };
        Ok(Response::new(self.app.withdraw_measurement(&powder, &id, reason).await?.into()))
    }

    async fn correct_measurement(
        &self,
        request: Request<CorrectMeasurementRequest>,
    ) -> Result<Response<Measurement>, Status> {
        let CorrectMeasurementRequest { id, reason, corrected } = write(request)?;
        let corrected = corrected.ok_or_else(|| missing("corrected"))?;
        let powder = corrected.powder.clone();
        let correction = app::Correction { reason, corrected: measured(corrected)? };
        Ok(Response::new(self.app.correct_measurement(&powder, &id, correction).await?.into()))
    }

    async fn withdraw_observation(
        &self,
        request: Request<WithdrawRequest>,
    ) -> Result<Response<PowderObservation>, Status> {
        let WithdrawRequest { powder, id, reason } = write(request)?;
        let reason = app::WithdrawalRequest { reason };
        Ok(Response::new(self.app.withdraw_observation(&powder, &id, reason).await?.into()))
    }

    async fn correct_observation(
        &self,
        request: Request<CorrectObservationRequest>,
    ) -> Result<Response<PowderObservation>, Status> {
        let CorrectObservationRequest { id, reason, corrected } = write(request)?;
        let (powder, corrected) = observed(corrected.ok_or_else(|| missing("corrected"))?)?;
        let correction = app::Correction { reason, corrected };
        Ok(Response::new(self.app.correct_observation(&powder, &id, correction).await?.into()))
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

fn measured(request: AddMeasurementRequest) -> Result<app::NewMeasurement, Problem> {
    let method = named::<Method, _>("method", request.method)?;
    Ok(app::NewMeasurement {
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
        measured_on: request.measured_on,
    })
}

fn observed(request: AddObservationRequest) -> Result<(String, app::NewObservation), Problem> {
    let AddObservationRequest { powder, observable, mean, sd, n, source, measured_on } = request;
    let observable = observable.and_then(Into::into).ok_or_else(|| missing("observable"))?;
    Ok((powder, app::NewObservation { observable, mean, sd, n, source, measured_on }))
}
