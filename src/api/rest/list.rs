//! Paginated lists: `?limit=&after=` in, `{items, next}` and a `Link` header out.

use super::answer;
use crate::api::wire::{Answer, ArchivedItems, Request};
use crate::app::{Page, PageQuery, Shown};
use axum::http::{HeaderMap, HeaderValue, Uri, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};

/// Which page of a list.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ListParams {
    /// Items on the page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    pub limit: Option<u32>,
    /// `next` of the previous page.
    pub after: Option<String>,
}

/// Which page of a list of things with labels.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct LabelledParams {
    /// Items on the page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    pub limit: Option<u32>,
    /// `next` of the previous page.
    pub after: Option<String>,
    /// Whether archived ones are listed.
    #[serde(default)]
    #[param(inline)]
    pub archived: ArchivedItems,
    /// Only with this tag.
    pub tag: Option<String>,
}

/// Which page of a series drawn as a curve.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct SeriesParams {
    /// Items on the page, 1 to 5000.
    #[param(minimum = 1, maximum = 5000, default = 50)]
    pub limit: Option<u32>,
    /// `next` of the previous page.
    pub after: Option<String>,
}

impl From<ListParams> for PageQuery {
    fn from(params: ListParams) -> Self {
        Self { limit: params.limit, after: params.after, ..Self::default() }
    }
}

impl From<LabelledParams> for PageQuery {
    fn from(params: LabelledParams) -> Self {
        let LabelledParams { limit, after, archived, tag } = params;
        let tag = tag.filter(|tag| !tag.trim().is_empty());
        Self { limit, after, shown: Shown { archived: archived.means(), tag } }
    }
}

impl From<SeriesParams> for PageQuery {
    fn from(params: SeriesParams) -> Self {
        Self { limit: params.limit, after: params.after, ..Self::default() }
    }
}

/// A page, with `Link: <…>; rel="next"` when another follows.
pub fn respond<T: Answer<Wire: Serialize>>(uri: &Uri, page: Page<T>) -> Response {
    (to_next(uri, page.next.as_deref()), answer(page)).into_response()
}

/// The link to the page with this cursor.
pub fn to_next(uri: &Uri, next: Option<&str>) -> HeaderMap {
    let mut headers = HeaderMap::new();
    let link = next.map(|next| link(uri, next));
    if let Some(link) = link.and_then(|link| HeaderValue::from_str(&link).ok()) {
        headers.insert(header::LINK, link);
    }
    headers
}

fn link(uri: &Uri, next: &str) -> String {
    let pairs = uri.query().unwrap_or_default().split('&');
    let kept: String = pairs
        .filter(|pair| !pair.is_empty() && pair.split('=').next() != Some("after"))
        .map(|pair| format!("{pair}&"))
        .collect();
    format!("<{}?{kept}after={next}>; rel=\"next\"", uri.path())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_link_keeps_the_filter_and_moves_the_cursor() {
        let next = |uri: &'static str| link(&Uri::from_static(uri), "abc");
        assert_eq!(next("/v1/jobs"), "</v1/jobs?after=abc>; rel=\"next\"");
        assert_eq!(
            next("/v1/jobs?limit=2&after=xyz&state=failed"),
            "</v1/jobs?limit=2&state=failed&after=abc>; rel=\"next\""
        );
    }
}
