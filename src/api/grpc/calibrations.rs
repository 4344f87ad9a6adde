//! `flip.v1.Calibrations`.

use super::convert::{all, conditions, given, labels, named, page};
use super::observables::observation;
use super::proto::*;
use super::shakes::stored_shakes;
use super::{Service, read, write};
use crate::app::CalibrationRequest;
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl calibrations_server::Calibrations for Service {
    async fn start_calibration(
        &self,
        request: Request<StartCalibrationRequest>,
    ) -> Result<Response<StartJobResponse>, Status> {
        let request = write(request)?;
        let method = named::<CalibrationMethod, _>("method", request.method)?;
        let StartCalibrationRequest {
            powder,
            repose_deg,
            sd_deg,
            n,
            sets,
            tolerance_deg,
            particles,
            ..
        } = request;
        let StartCalibrationRequest {
            trials_max,
            verify_repeats,
            readings,
            seed,
            verify_particles,
            simulator,
            ..
        } = request;
        let observations = request.observations.into_iter().enumerate();
        let observations: Vec<_> = observations
            .map(|(k, wire)| observation(&format!("observations[{k}]"), wire))
            .collect::<Result<_, _>>()?;
        let request = CalibrationRequest {
            powder,
            repose_deg,
            sd_deg,
            n,
            method,
            sets,
            tolerance_deg,
            particles,
            trials_max,
            verify_repeats,
            readings,
            seed,
            observations: given(observations),
            shakes: request.shakes.map(stored_shakes).transpose()?,
            verify_particles,
            simulator,
            fixed: request.fixed.into_iter().collect(),
            conditions: conditions(request.conditions),
            device: named::<Device, _>("device", request.device)?.unwrap_or_default(),
            labels: labels(request.labels),
        };
        Ok(Response::new(self.app.start_calibration(request).await?.into()))
    }

    async fn list_calibrations(
        &self,
        request: Request<ListCalibrationsRequest>,
    ) -> Result<Response<ListCalibrationsResponse>, Status> {
        let found = self.app.calibrations(page(read(request)?.page)).await?;
        let found = self.app.all_labelled(found).await?;
        Ok(Response::new(ListCalibrationsResponse { items: all(found.items), next: found.next }))
    }

    async fn get_calibration(
        &self,
        request: Request<GetCalibrationRequest>,
    ) -> Result<Response<Calibration>, Status> {
        let found = self.app.calibration(&read(request)?.id).await?;
        Ok(Response::new(self.app.labelled(found).await?.into()))
    }

    async fn get_posterior(
        &self,
        request: Request<GetPosteriorRequest>,
    ) -> Result<Response<Posterior>, Status> {
        Ok(Response::new(self.app.posterior(&read(request)?.calibration).await?.into()))
    }

    async fn compare_calibrations(
        &self,
        request: Request<CompareCalibrationsRequest>,
    ) -> Result<Response<Comparison>, Status> {
        let CompareCalibrationsRequest { calibration, with } = read(request)?;
        Ok(Response::new(self.app.compare_calibrations(&calibration, &with).await?.into()))
    }

    async fn list_trials(
        &self,
        request: Request<ListTrialsRequest>,
    ) -> Result<Response<ListTrialsResponse>, Status> {
        let request = read(request)?;
        let found = self.app.trials(&request.calibration, page(request.page)).await?;
        Ok(Response::new(ListTrialsResponse { items: all(found.items), next: found.next }))
    }
}
