//! `flip.v1.Films`.

use super::convert::{all, labels, page};
use super::policies::CHUNK_BYTES;
use super::proto::*;
use super::{Service, read, write};
use crate::app;
use futures::StreamExt;
use futures::stream::{self, BoxStream};
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl films_server::Films for Service {
    async fn start_film(
        &self,
        request: Request<StartFilmRequest>,
    ) -> Result<Response<StartJobResponse>, Status> {
        let asked = write(request)?;
        let request = app::FilmRequest {
            weighing: asked.weighing,
            spoonful: asked.spoonful,
            set: asked.set,
            seed: asked.seed,
            training: asked.training,
            episode: asked.episode,
            labels: labels(asked.labels),
        };
        Ok(Response::new(self.app.start_film(request).await?.into()))
    }

    async fn list_films(
        &self,
        request: Request<ListFilmsRequest>,
    ) -> Result<Response<ListFilmsResponse>, Status> {
        let ListFilmsRequest { page: asked, weighing, set, training } = read(request)?;
        let of = app::FilmsAsked {
            weighing: weighing.as_deref(),
            set: set.as_deref(),
            training: training.as_deref(),
        };
        let found = self.app.films(of, page(asked)).await?;
        Ok(Response::new(ListFilmsResponse { items: all(found.items), next: found.next }))
    }

    async fn get_film(&self, request: Request<GetFilmRequest>) -> Result<Response<Film>, Status> {
        Ok(Response::new(self.app.film(&read(request)?.id).await?.into()))
    }

    type DownloadFilmStream = BoxStream<'static, Result<DownloadFilmResponse, Status>>;

    async fn download_film(
        &self,
        request: Request<DownloadFilmRequest>,
    ) -> Result<Response<Self::DownloadFilmStream>, Status> {
        let (_, bytes) = self.app.film_file(&read(request)?.id).await?;
        let chunks: Vec<_> = bytes.chunks(CHUNK_BYTES).map(<[u8]>::to_vec).collect();
        Ok(Response::new(
            stream::iter(chunks).map(|chunk| Ok(DownloadFilmResponse { chunk })).boxed(),
        ))
    }
}

impl From<app::Film> for Film {
    fn from(it: app::Film) -> Self {
        let app::Film { job, weighing, spoonful, bench, set, seed, result, .. } = it;
        let app::Film { training, episode, target_mg, .. } = it;
        let bench = bench.map(|bench| bench.name().to_owned());
        let result = result.map(Into::into);
        Self {
            job: Some(job.into()),
            weighing,
            spoonful,
            bench,
            result,
            set,
            seed,
            training,
            episode,
            target_mg,
        }
    }
}

impl From<app::FilmResult> for FilmResult {
    fn from(it: app::FilmResult) -> Self {
        let app::FilmResult { sha256, size_bytes, head, heap } = it;
        Self { sha256, size_bytes, head: head.map(Into::into), heap: heap.map(Into::into) }
    }
}

impl From<app::HeapHead> for HeapHead {
    fn from(it: app::HeapHead) -> Self {
        let app::HeapHead { simulator, grains, frames, falls, grain_mm, every_s, .. } = it;
        let app::HeapHead { duration_s, base_radius_mm, on_base, tip_deg, cone_deg, .. } = it;
        let app::HeapHead { height_mm, cone_height_mm, rings, .. } = it;
        Self {
            simulator,
            grains,
            frames,
            falls,
            grain_mm,
            every_s,
            duration_s,
            base_radius_mm,
            on_base,
            tip_deg,
            cone_deg,
            height_mm,
            cone_height_mm,
            rings: all(rings),
        }
    }
}

impl From<app::HeapRing> for HeapRing {
    fn from(it: app::HeapRing) -> Self {
        let app::HeapRing { sector, radius_mm, height_mm } = it;
        Self { sector, radius_mm, height_mm }
    }
}

impl From<app::FilmHead> for FilmHead {
    fn from(it: app::FilmHead) -> Self {
        let [bowl_length_mm, bowl_width_mm, bowl_depth_mm] = it.bowl_mm;
        Self {
            simulator: it.simulator,
            grains: it.grains,
            frames: it.frames,
            falls: it.falls,
            grain_mm: it.grain_mm,
            grain_mg: it.grain_mg,
            bowl_length_mm,
            bowl_width_mm,
            bowl_depth_mm,
            vial_radius_mm: it.vial_radius_mm,
            vial_offset_mm: it.vial_offset_mm,
            drop_height_mm: it.drop_height_mm,
            every_s: it.every_s,
            duration_s: it.duration_s,
            filled_mg: it.filled_mg,
            vial_mg: it.vial_mg,
            spilled_mg: it.spilled_mg,
            steps: all(it.steps),
        }
    }
}

impl From<app::StepSeen> for FilmStep {
    fn from(it: app::StepSeen) -> Self {
        let app::StepSeen { begins_s, pitch_deg, shake_mm, strokes, fell_mg, spoon_mg, vial_mg } =
            it;
        Self { begins_s, pitch_deg, shake_mm, strokes, fell_mg, spoon_mg, vial_mg }
    }
}
