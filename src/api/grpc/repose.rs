//! `flip.v1.ReposeMeasurements`.

use super::convert::{all, labels, page};
use super::proto::*;
use super::{Service, read, write};
use crate::api::problem::Problem;
use crate::app::{FrameUpload, ReposeRequest};
use flip_core::domain::FieldError;
use flip_core::domain::pile::Outline;
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
            labels: written_on,
        } = write(request)?;
        let request = ReposeRequest {
            powder,
            run,
            procedure: written("procedure_json", procedure_json)?,
            rig: written("rig_json", rig_json)?,
            limits: written("limits_json", limits_json)?,
            reservation,
            labels: labels(written_on),
        };
        Ok(Response::new(self.app.start_repose(request).await?.into()))
    }

    async fn list_repose_measurements(
        &self,
        request: Request<ListReposeMeasurementsRequest>,
    ) -> Result<Response<ListReposeMeasurementsResponse>, Status> {
        let found = self.app.reposes(page(read(request)?.page)).await?;
        let found = self.app.all_labelled(found).await?;
        Ok(Response::new(ListReposeMeasurementsResponse {
            items: all(found.items),
            next: found.next,
        }))
    }

    async fn get_repose_measurement(
        &self,
        request: Request<GetReposeMeasurementRequest>,
    ) -> Result<Response<ReposeMeasurement>, Status> {
        let found = self.app.repose(&read(request)?.id).await?;
        Ok(Response::new(self.app.labelled(found).await?.into()))
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

impl From<Outline> for PileOutline {
    fn from(it: Outline) -> Self {
        let Outline { size: [width, height], tip, apex, base, rim, cone, flank, points } = it;
        let pixel = |[x, y]: [f64; 2]| Some(Pixel { x, y });
        let pixels = |all: Vec<[f64; 2]>| all.into_iter().filter_map(pixel).collect();
        let [base_left, base_right] = base.map(pixel);
        let [cone_left, cone_point, cone_right] = cone.map(pixel);
        let [flank_low, flank_high] = flank.map(pixels);
        let points = points.into_iter().map(|p| p.map(f64::from)).collect();
        Self {
            width,
            height,
            tip: pixel(tip),
            apex: pixel(apex),
            base_left,
            base_right,
            rim: pixels(rim),
            cone_left,
            cone_point,
            cone_right,
            flank_low,
            flank_high,
            points: pixels(points),
        }
    }
}
