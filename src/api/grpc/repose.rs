//! `flip.v1.ReposeMeasurements`.

use super::convert::{all, page};
use super::proto::*;
use super::{Service, read, write};
use crate::api::problem::Problem;
use crate::app::{FrameUpload, ReposeRequest};
use flip_core::domain::FieldError;
use serde::de::DeserializeOwned;
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl repose_measurements_server::ReposeMeasurements for Service {
    async fn start_repose_measurement(
        &self,
        request: Request<StartReposeMeasurementRequest>,
    ) -> Result<Response<StartJobResponse>, Status> {
        let StartReposeMeasurementRequest {
            powder,
            run,
            procedure_json,
            rig_json,
            limits_json,
            reservation,
        } = write(request)?;
        let request = ReposeRequest {
            powder,
            run,
            procedure: written("procedure_json", procedure_json)?,
            rig: written("rig_json", rig_json)?,
            limits: written("limits_json", limits_json)?,
            reservation,
        };
        Ok(Response::new(self.app.start_repose(request).await?.into()))
    }

    async fn list_repose_measurements(
        &self,
        request: Request<ListReposeMeasurementsRequest>,
    ) -> Result<Response<ListReposeMeasurementsResponse>, Status> {
        let found = self.app.reposes(page(read(request)?.page)).await?;
        Ok(Response::new(ListReposeMeasurementsResponse {
            items: all(found.items),
            next: found.next,
        }))
    }

    async fn get_repose_measurement(
        &self,
        request: Request<GetReposeMeasurementRequest>,
    ) -> Result<Response<ReposeMeasurement>, Status> {
        Ok(Response::new(self.app.repose(&read(request)?.id).await?.into()))
    }

    async fn add_frame(
        &self,
        request: Request<AddFrameRequest>,
    ) -> Result<Response<AwaitedFrames>, Status> {
        let AddFrameRequest { id, depth, colour, description_json } = write(request)?;
        let frame = FrameUpload { depth, colour, description: description_json.into() };
        Ok(Response::new(self.app.add_frame(&id, frame).await?.into()))
    }

    async fn download_frame(
        &self,
        request: Request<DownloadFrameRequest>,
    ) -> Result<Response<DownloadFrameResponse>, Status> {
        let DownloadFrameRequest { id, pile, frame, part } = read(request)?;
        let bytes = self.app.raw_frame(&id, pile, frame, &part).await?;
        Ok(Response::new(DownloadFrameResponse { bytes }))
    }

    async fn compare_methods(
        &self,
        request: Request<CompareMethodsRequest>,
    ) -> Result<Response<CompareMethodsResponse>, Status> {
        let CompareMethodsRequest {} = read(request)?;
        Ok(Response::new(CompareMethodsResponse { items: all(self.app.compare_methods().await?) }))
    }
}

/// Parses a field that holds JSON; the default if it is not set.
fn written<T: DeserializeOwned + Default>(field: &str, text: Option<String>) -> Result<T, Problem> {
    let read = |text: String| {
        serde_json::from_str(&text).map_err(|error| {
            FieldError::new(field, format!("must be the JSON that REST takes here: {error}")).into()
        })
    };
    text.map_or_else(|| Ok(T::default()), read)
}
