//! `flip.v1.Shakes`.

use super::convert::{all, at, page};
use super::proto::*;
use super::{Service, read, write};
use crate::api::problem::Problem;
use crate::app::{self, ShakesWanted};
use flip_core::domain::FieldError;
use flip_core::domain::bench::BenchKind;
use flip_core::domain::shake;
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl shakes_server::Shakes for Service {
    async fn list_shakes(
        &self,
        request: Request<ListShakesRequest>,
    ) -> Result<Response<ListShakesResponse>, Status> {
        let request = read(request)?;
        let bench = request.bench.as_deref().map(|name| bench_kind("bench", name)).transpose()?;
        let wanted = ShakesWanted { powder: request.powder, lot: request.lot, bench };
        let found = self.app.list_shakes(&wanted, page(request.page)).await?;
        Ok(Response::new(ListShakesResponse { items: all(found.items), next: found.next }))
    }

    async fn import_shakes(
        &self,
        request: Request<ImportShakesRequest>,
    ) -> Result<Response<ImportShakesResponse>, Status> {
        let ImportShakesRequest { shakes_csv, source, create } = write(request)?;
        let made = self.app.import_shakes(&shakes_csv, &source, create).await?;
        Ok(Response::new(ImportShakesResponse {
            powders: made.powders,
            named: made.named.into_iter().map(|it| (it.name, it.id)).collect(),
            spoonfuls: made.spoonfuls as u64,
            shakes: made.shakes as u64,
            already_stored: made.already_stored as u64,
        }))
    }

    async fn forget_shakes(
        &self,
        request: Request<ForgetShakesRequest>,
    ) -> Result<Response<ForgetShakesResponse>, Status> {
        let ForgetShakesRequest { powder, lot } = write(request)?;
        let app::ForgottenShakes { forgotten, spoonfuls } =
            self.app.forget_shakes(&powder, lot.as_deref()).await?;
        Ok(Response::new(ForgetShakesResponse {
            id: forgotten.id,
            powder: forgotten.powder,
            lot: forgotten.lot,
            at: at(forgotten.at),
            spoonfuls: spoonfuls as u64,
        }))
    }
}

/// Which stored shakes a request means.
pub(super) fn stored_shakes(asked: StoredShakes) -> Result<app::StoredShakes, Problem> {
    let StoredShakes { powder, lot, bench } = asked;
    let bench = bench.as_deref().map(|name| bench_kind("shakes.bench", name)).transpose()?;
    Ok(app::StoredShakes { powder, lot, bench })
}

/// The kind of bench of this name.
pub(super) fn bench_kind(field: &str, name: &str) -> Result<BenchKind, Problem> {
    let known = [BenchKind::Simulated, BenchKind::Emulated, BenchKind::Devices];
    let advice = || {
        let message = format!("must be simulated, emulated or devices, got `{name}`");
        Problem::from(FieldError::new(field, message))
    };
    known.into_iter().find(|kind| kind.name() == name).ok_or_else(advice)
}

impl From<app::KeptSpoonful> for KeptSpoonful {
    fn from(kept: app::KeptSpoonful) -> Self {
        Self {
            spoonful: Some(kept.spoonful.into()),
            bench: kept.bench.map(super::convert::bench_kind),
            source: kept.source,
            at: at(kept.at),
        }
    }
}

impl From<shake::Spoonful> for Spoonful {
    fn from(it: shake::Spoonful) -> Self {
        let shake::Spoonful { weighing, spoonful, powder, lot, session, readability_mg, shakes } =
            it;
        let shakes = all(shakes);
        Self { weighing, spoonful, powder, lot, session, readability_mg, shakes }
    }
}

impl From<shake::Shake> for Shake {
    fn from(it: shake::Shake) -> Self {
        Self {
            pitch_deg: it.pitch_deg,
            shake_mm: it.shake_mm,
            strokes: it.strokes,
            acceleration_m_s2: it.acceleration_m_s2,
            spoon_mg: it.spoon_mg,
            fell_mg: it.fell_mg,
            sd_mg: it.sd_mg,
            since_filled_s: it.since_filled_s,
        }
    }
}
