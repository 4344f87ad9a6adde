//! `/v1/parameters` and `/v1/parameter-sets`: the parameters of a simulated powder, and the sets
//! found by calibrations.

use super::answer;
use super::extract::{Path, Query};
use super::list::respond;
use crate::api::auth::Viewer;
use crate::api::problem::Problem;
use crate::api::wire::{Answer, CalibratedSet, Page, Parameter};
use crate::app::App;
use crate::app::PageQuery;
use axum::Json;
use axum::extract::{OriginalUri, State};
use axum::response::Response;
use flip_core::domain::parameters::PARAMETERS;
use serde::Deserialize;

/// The nine parameters of a simulated powder, with their published bounds.
///
/// With unit, meaning and the default of each.
#[utoipa::path(get, path = "/v1/parameters", tag = "parameters",
    responses((status = 200, description = "The nine parameters, in canonical order", body = Page<Parameter>)))]
pub async fn list_parameters(_: Viewer) -> Json<Page<Parameter>> {
    Json(Page { items: PARAMETERS.to_vec().wire(), next: None })
}

/// Selection of parameter sets.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct SetParams {
    /// Items on the page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
    /// `next` of the previous page.
    after: Option<String>,
    /// Only sets of this powder.
    powder: Option<String>,
}

/// List calibrated parameter sets, newest first.
///
/// With the powder, the calibration that found each, and the simulated angle.
#[utoipa::path(get, path = "/v1/parameter-sets", tag = "parameters", params(SetParams),
    responses((status = 200, description = "A page of parameter sets", body = Page<CalibratedSet>)))]
pub async fn list_parameter_sets(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<SetParams>,
) -> Result<Response, Problem> {
    let page = PageQuery { limit: params.limit, after: params.after, ..PageQuery::default() };
    Ok(respond(&uri, app.parameter_sets(params.powder.as_deref(), page).await?))
}

/// One calibrated parameter set.
///
/// The nine parameters, and the angle that its heaps have in the simulator, degrees.
#[utoipa::path(get, path = "/v1/parameter-sets/{id}", tag = "parameters",
    params(("id" = String, Path, description = "Parameter set id, `ps-…`")),
    responses((status = 200, description = "The parameter set", body = CalibratedSet)))]
pub async fn get_parameter_set(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<CalibratedSet>, Problem> {
    Ok(answer(app.parameter_set(&id).await?))
}
