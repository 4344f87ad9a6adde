//! `/v1/weighings`: doses of powder.

use super::accepted;
use super::answer;
use super::extract::{Input, Path, Query};
use super::list::{LabelledParams, to_next};
use super::wait::{WaitParams, waited};
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{
    self, Answer, DoseList, DoseListRequest, Labelled, Request, Tick, VialReadyRequest, Weighing,
    WeighingDetail, WeighingRequest, WeighingsFound,
};
use crate::app::{self, App, LabelWanted, Topic, WeighingsAsked, WeighingsWanted, document};
use axum::Json;
use axum::extract::{OriginalUri, State};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{Html, IntoResponse, Response};
use flip_core::domain::bench;
use serde::Deserialize;
use std::fmt::Write;

/// Which page of which weighings.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct WeighingsParams {
    /// Items on the page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
    /// `next` of the previous page.
    after: Option<String>,
    /// Only of this powder, by id.
    powder: Option<String>,
    /// Only of this lot.
    lot: Option<String>,
    /// Only into this vial.
    vial: Option<String>,
    /// Only asked for by this operator.
    operator: Option<String>,
    /// Only of this list of doses.
    list: Option<String>,
    /// Only by this policy, by id.
    policy: Option<String>,
    /// Only with this label of a caller, as `plate:A7`.
    label: Option<String>,
    /// Only on this kind of bench.
    #[param(inline)]
    bench: Option<wire::BenchKind>,
    /// Only with this state.
    #[param(inline)]
    state: Option<wire::WeighingState>,
    /// Only with this outcome.
    #[param(inline)]
    outcome: Option<wire::Outcome>,
    /// Only under or over their tolerance.
    #[serde(default)]
    #[param(default = false)]
    outside: bool,
    /// Requested on this day (UTC) or later, `2026-11-24`, or from this time on,
    /// `2026-11-24T08:00:00Z`.
    since: Option<String>,
    /// Requested on this day (UTC) or earlier, or before this time.
    until: Option<String>,
    /// Words, each of which stands in the id, powder, policy, lot, vial, operator, list, position
    /// or error, or in the name given to it; up to 200 characters.
    q: Option<String>,
    /// Their order; default the newest request first.
    #[serde(default)]
    #[param(inline)]
    sort: wire::WeighingSort,
    /// Whether archived ones, and those of archived lists, are listed.
    #[serde(default)]
    #[param(inline)]
    archived: wire::ArchivedItems,
    /// Only with this tag, or on a list of doses with it.
    tag: Option<String>,
}

/// List weighings: all, or those that match, and how many they are.
///
/// The newest first unless asked otherwise. All filters hold together; the total counts what
/// matches on all pages.
#[utoipa::path(get, path = "/v1/weighings", tag = "weighings", params(WeighingsParams),
    responses((status = 200, description = "A page of weighings", body = WeighingsFound)))]
pub async fn list_weighings(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<WeighingsParams>,
) -> Result<Response, Problem> {
    let WeighingsParams { limit, after, since, until, archived, tag, .. } = params;
    let WeighingsParams { powder, lot, vial, operator, list, policy, q: text, .. } = params;
    let wanted = WeighingsWanted {
        powder,
        lot,
        vial,
        operator,
        list,
        policy,
        text,
        bench: params.bench.means(),
        label: LabelWanted::among(params.label.as_deref())?,
        state: params.state.means(),
        outcome: params.outcome.means(),
        outside: params.outside,
        sort: params.sort.means(),
        ..WeighingsWanted::default()
    };
    let asked = WeighingsAsked { wanted, since, until };
    let page = LabelledParams { limit, after, archived, tag };
    let app::WeighingsFound { page, total } = app.weighings(asked, page.into()).await?;
    let app::Page { items, next } = app.all_labelled(page).await?;
    let link = to_next(&uri, next.as_deref());
    Ok((link, Json(WeighingsFound { items: items.wire(), next, total })).into_response())
}

/// Weigh a dose.
///
/// Stores the intent, then doses. The same key with the same body returns the first weighing and
/// never pours twice.
#[utoipa::path(post, path = "/v1/weighings", tag = "weighings", request_body = WeighingRequest,
    params(("Idempotency-Key" = String, Header, description = "New for every weighing, 1 to 255 visible ASCII characters")),
    responses(
        (status = 202, description = "Planned, or the weighing the key started before", body = Weighing, headers(
            ("Location" = String, description = "URL of the weighing"),
            ("Idempotency-Replayed" = String, description = "`true` if the key was used before"))),
        (status = 409, description = "64 weighings are waiting already, the bench is latched or reserved, or a calibration or policy is missing", body = Problem,
            content_type = "application/problem+json"),
        (status = 422, description = "The key was used for another request", body = Problem,
            content_type = "application/problem+json")))]
pub async fn start_weighing(
    _: Operator,
    State(app): State<App>,
    headers: HeaderMap,
    Input(request): Input<WeighingRequest>,
) -> Result<Response, Problem> {
    // A missing or non-text key is refused like an empty one.
    let key = headers.get("idempotency-key").and_then(|key| key.to_str().ok()).unwrap_or_default();
    Ok(planned(app.start_weighing(request, key).await?))
}

/// 202 for a weighing, and whether its key was used before.
pub(super) fn planned((weighing, replayed): (crate::app::Weighing, bool)) -> Response {
    let mut response = accepted(format!("/v1/weighings/{}", weighing.id), weighing);
    if replayed {
        response.headers_mut().insert("idempotency-replayed", HeaderValue::from_static("true"));
    }
    response
}

/// Weigh a list of doses: all of them, or none.
///
/// Every row is checked before anything is stored; then they are weighed in order, each with the
/// rights and checks of a weighing. A restart goes on with what waits. The same key with the same
/// body returns the first list and never pours twice.
#[utoipa::path(post, path = "/v1/weighings/list", tag = "weighings", request_body = DoseListRequest,
    params(("Idempotency-Key" = Option<String>, Header, description = "New for every list, 1 to 200 visible ASCII characters; not needed to check one")),
    responses(
        (status = 200, description = "The list as it was understood, only checked", body = DoseList),
        (status = 202, description = "Planned, or the list the key started before", body = DoseList, headers(
            ("Location" = String, description = "URL of its weighings"),
            ("Idempotency-Replayed" = String, description = "`true` if the key was used before"))),
        (status = 409, description = "More than 64 weighings would wait, the name is taken, or the bench is latched or reserved", body = Problem,
            content_type = "application/problem+json"),
        (status = 422, description = "The key was used for another request", body = Problem,
            content_type = "application/problem+json")))]
pub async fn start_dose_list(
    _: Operator,
    State(app): State<App>,
    headers: HeaderMap,
    Input(request): Input<DoseListRequest>,
) -> Result<Response, Problem> {
    if request.check {
        return Ok(answer(app.check_dose_list(request).await?).into_response());
    }
    let key = headers.get("idempotency-key").and_then(|key| key.to_str().ok()).unwrap_or_default();
    let (list, replayed) = app.start_dose_list(request, key).await?;
    let name: String = form_urlencoded::byte_serialize(list.name.as_bytes()).collect();
    let mut response = accepted(format!("/v1/weighings?list={name}"), list);
    if replayed {
        response.headers_mut().insert("idempotency-replayed", HeaderValue::from_static("true"));
    }
    Ok(response)
}

/// Which list of doses.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ListParams {
    /// Its name.
    list: String,
}

/// The certificate of a list of doses that have all ended: a self-contained page to print.
///
/// One page of A4 or more, with each dose, its uncertainty, and places to sign.
#[utoipa::path(get, path = "/v1/weighings/certificate.html", tag = "weighings", params(ListParams),
    responses((status = 200, description = "The page", body = String, content_type = "text/html"),
        (status = 409, description = "A dose of it has not ended", body = Problem, content_type = "application/problem+json")))]
pub async fn get_list_certificate(
    _: Viewer,
    State(app): State<App>,
    Query(params): Query<ListParams>,
) -> Result<Response, Problem> {
    let page = app.list_certificate(&params.list).await?;
    Ok(([(header::CONTENT_SECURITY_POLICY, document::POLICY)], Html(page)).into_response())
}

/// One weighing, with its ticks so far.
///
/// With `wait` the answer comes once it has ended, or after so many seconds as it then is.
#[utoipa::path(get, path = "/v1/weighings/{id}", tag = "weighings",
    params(("id" = String, Path, description = "Weighing id"), WaitParams),
    responses((status = 200, description = "The weighing", body = Labelled<WeighingDetail>)))]
pub async fn get_weighing(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
    Query(params): Query<WaitParams>,
) -> Result<Response, Problem> {
    let patience = params.checked()?;
    let found = app.weighing(&id).await?;
    let ended = found.weighing.outcome.is_some();
    let now = app.labelled(found).await?;
    Ok(waited(now, patience.filter(|_| !ended), async move |patience| {
        app.wait_for(Topic::Weighing(id.clone()), patience).await?;
        app.labelled(app.weighing(&id).await?).await
    }))
}

/// The ticks of a weighing: the actions of the bench and the balance readings.
///
/// In order, with the time on the bench in seconds, the pitch and stroke of each action, and each
/// reading in mg.
#[utoipa::path(get, path = "/v1/weighings/{id}/trace", tag = "weighings",
    params(("id" = String, Path, description = "Weighing id")),
    responses((status = 200, description = "The ticks in order", body = Vec<Tick>),
        (status = 410, description = "Their file is missing or damaged", body = Problem, content_type = "application/problem+json")))]
pub async fn get_trace(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<Vec<Tick>>, Problem> {
    Ok(answer(app.trace(&id).await?))
}

/// Download the ticks of a weighing as CSV.
///
/// One row a tick; the columns are those of docs/reference/csv.md.
#[utoipa::path(get, path = "/v1/weighings/{id}/trace.csv", tag = "weighings",
    params(("id" = String, Path, description = "Weighing id")),
    responses((status = 200, description = "One line per tick", body = String, content_type = "text/csv"),
        (status = 410, description = "Their file is missing or damaged", body = Problem, content_type = "application/problem+json")))]
pub async fn download_trace(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    let ticks = app.trace(&id).await?;
    let headers = [
        (header::CONTENT_TYPE, "text/csv; charset=utf-8".to_owned()),
        (header::CONTENT_DISPOSITION, format!("attachment; filename=\"weighing-{id}.csv\"")),
    ];
    Ok((headers, trace_csv(&ticks)).into_response())
}

/// Numbers as in JSON, so that both forms of a trace have the same digits.
pub(in crate::api) fn trace_csv(ticks: &[bench::Tick]) -> String {
    let mut text = String::from(
        "step,t_s,pitch_deg,incline_change_deg,shake_mm,mass_mg,stable,strokes,spoonful\n",
    );
    for bench::Tick { step, t_s, pitch_deg, action, reading, spoonful } in ticks {
        let _infallible = writeln!(
            text,
            "{step},{t_s},{pitch_deg},{},{},{},{},{},{spoonful}",
            action.incline_change_deg,
            action.shake_mm,
            reading.mass_mg,
            reading.stable,
            action.strokes
        );
    }
    text
}

/// The certificate of a weighing that has ended: a self-contained page to print.
///
/// What was asked, weighed and by what, the uncertainty (k = 2), and whether the bench was
/// simulated, emulated or real.
#[utoipa::path(get, path = "/v1/weighings/{id}/certificate.html", tag = "weighings",
    params(("id" = String, Path, description = "Weighing id")),
    responses((status = 200, description = "The page", body = String, content_type = "text/html"),
        (status = 409, description = "It has not ended, or it probed a powder", body = Problem, content_type = "application/problem+json")))]
pub async fn get_certificate(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    let page = app.certificate(&id, None).await?;
    Ok(([(header::CONTENT_SECURITY_POLICY, document::POLICY)], Html(page)).into_response())
}

/// A weighing that has ended, in the Allotrope Simple Model of balances.
///
/// After the manifest balance, REC/2025/03: the masses, the readings over time as a data cube, the
/// devices, powder, lot and vial; FLIP's own outcome as custom information.
#[utoipa::path(get, path = "/v1/weighings/{id}/asm.json", tag = "weighings",
    params(("id" = String, Path, description = "Weighing id")),
    responses((status = 200, description = "The document", body = serde_json::Value),
        (status = 409, description = "It has not ended, or it probed a powder", body = Problem, content_type = "application/problem+json")))]
pub async fn get_asm(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<serde_json::Value>, Problem> {
    Ok(Json(app.asm(&id).await?))
}

/// Confirm that the vial of a weighing is in, and empty.
///
/// Where the bench cannot exchange vials, the weighing whose turn it is waits for this in the state
/// `awaiting_vial`. The balance is checked too: a vial that was dosed into before, or that weighs
/// more than an empty one, is refused before anything moves. The confirmation holds until a stop, a
/// latch or a restart.
#[utoipa::path(post, path = "/v1/weighings/{id}/vial-ready", tag = "weighings", request_body = VialReadyRequest,
    params(("id" = String, Path, description = "Weighing id")),
    responses((status = 200, description = "The weighing, about to start", body = Weighing),
        (status = 409, description = "It is not its turn, another vial was named, it has ended, or the bench was stopped after this request", body = Problem,
            content_type = "application/problem+json")))]
pub async fn vial_ready(
    _: Operator,
    State(app): State<App>,
    Path(id): Path<String>,
    Input(request): Input<VialReadyRequest>,
) -> Result<Json<Weighing>, Problem> {
    Ok(answer(app.vial_ready(&id, request).await?))
}

/// Stop a weighing and level the spoon.
///
/// A waiting weighing is stopped at once. For a running one the arm is stopped at once, before
/// anything is recorded, and the bench is held until a person resumes. One that has ended stays as
/// it is. Not an emergency stop: that one is wired.
#[utoipa::path(post, path = "/v1/weighings/{id}/stop", tag = "weighings",
    params(("id" = String, Path, description = "Weighing id")),
    responses((status = 200, description = "The weighing, which had ended before", body = Weighing),
        (status = 202, description = "The weighing, stopping or stopped", body = Weighing)))]
pub async fn stop_weighing(
    _: Operator,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    let (weighing, stopped) = app.stop_weighing(&id).await?;
    match stopped {
        true => Ok(accepted(format!("/v1/weighings/{}", weighing.id), weighing)),
        false => Ok(answer(weighing).into_response()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_core::domain::bench::{Action, Reading};

    #[test]
    fn the_csv_of_a_trace_holds_the_digits_of_its_json() {
        let action = Action::once(-0.1, 8.0);
        let tick = bench::Tick {
            step: 1,
            t_s: 0.3,
            pitch_deg: 20.5,
            action,
            reading: Reading { mass_mg: 4.0, stable: true },
            spoonful: 2,
        };
        assert_eq!(trace_csv(&[tick]).lines().nth(1), Some("1,0.3,20.5,-0.1,8,4,true,1,2"));
    }
}
