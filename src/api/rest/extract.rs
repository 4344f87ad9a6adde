//! Axum extractors whose errors name the field.

use crate::api::problem::Problem;
use crate::api::wire;
use crate::app::table_text;
use axum::body::Bytes;
use axum::extract::rejection::QueryRejection;
use axum::extract::{FromRequest, FromRequestParts, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, StatusCode, header};
use flip_core::domain::FieldError;
use serde::de::DeserializeOwned;
use std::error::Error;

/// Maximum size of a request body, bytes.
pub const BODY_BYTES_MAX: usize = 1024 * 1024;
/// Maximum size of a body that holds images or tables, bytes.
pub const LARGE_BYTES_MAX: usize = 16 * 1024 * 1024;

/// Maximum size of the body, or of the gRPC message, sent to this path.
pub fn bytes_max(path: &str) -> usize {
    let services = [
        "/flip.v1.ReposeMeasurements/",
        "/flip.v1.Investigations/",
        "/flip.v1.Simulators/",
        "/flip.v1.Shakes/",
        "/flip.v1.Policies/",
    ];
    let tables =
        ["/v1/measurements/import", "/v1/shakes/import", "/v1/investigations", "/v1/policies"];
    let of_things = ["/frames", "/predictions"];
    let is_large = services.iter().any(|service| path.starts_with(service))
        || tables.contains(&path)
        || path.starts_with("/v1/") && of_things.iter().any(|end| path.ends_with(end));
    if is_large { LARGE_BYTES_MAX } else { BODY_BYTES_MAX }
}

/// What a JSON body asks for.
pub struct Input<T: wire::Request>(pub T::Means);

impl<T: DeserializeOwned + wire::Request, S: Send + Sync> FromRequest<S> for Input<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &S) -> Result<Self, Problem> {
        let body = body(request, state, &["application/json"], BODY_BYTES_MAX).await?;
        Ok(Self(parse::<T>(&body)?.means()))
    }
}

/// What a JSON body that holds images or tables asks for.
pub struct Large<T: wire::Request>(pub T::Means);

impl<T: DeserializeOwned + wire::Request, S: Send + Sync> FromRequest<S> for Large<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &S) -> Result<Self, Problem> {
        let body = body(request, state, &["application/json"], LARGE_BYTES_MAX).await?;
        Ok(Self(parse::<T>(&body)?.means()))
    }
}

/// A CSV body, called `text/csv` or, by clients made from the document, a file.
#[derive(Debug)]
pub struct Csv(pub String);

impl<S: Send + Sync> FromRequest<S> for Csv {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &S) -> Result<Self, Problem> {
        let kinds = ["text/csv", "application/octet-stream"];
        let bytes = body(request, state, &kinds, LARGE_BYTES_MAX).await?;
        Ok(Self(table_text(&bytes)?))
    }
}

/// A file as the body.
#[derive(Debug)]
pub struct Octets(pub Bytes);

impl<S: Send + Sync> FromRequest<S> for Octets {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &S) -> Result<Self, Problem> {
        Ok(Self(body(request, state, &["application/octet-stream"], LARGE_BYTES_MAX).await?))
    }
}

/// A body of one of these content types, within the size limit.
async fn body<S: Send + Sync>(
    request: Request,
    state: &S,
    kinds: &[&str],
    bytes_max: usize,
) -> Result<Bytes, Problem> {
    if !kinds.iter().any(|kind| is_of_kind(request.headers(), kind)) {
        return Err(Problem::unsupported_media_type(&kinds.join(" or ")));
    }
    Bytes::from_request(request, state).await.map_err(|rejection| match rejection.status() {
        StatusCode::PAYLOAD_TOO_LARGE => Problem::too_large(bytes_max),
        _ => Problem::malformed("the body ended before it was complete"),
    })
}

fn is_of_kind(headers: &HeaderMap, expected: &str) -> bool {
    let text =
        headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    text.split(';').next().is_some_and(|kind| kind.trim().eq_ignore_ascii_case(expected))
}

pub(in crate::api) fn parse<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    let mut json = serde_json::Deserializer::from_slice(bytes);
    let value = serde_path_to_error::deserialize(&mut json).map_err(|error| {
        // The position where a body breaks off is unrelated to the field it was in.
        let path = if error.inner().is_eof() { ".".to_owned() } else { error.path().to_string() };
        refuse(&path, &error.into_inner().to_string())
    })?;
    json.end()
        .map_err(|error| Problem::malformed(format!("the body is not a JSON document: {error}")))?;
    Ok(value)
}

/// A problem at `path`; serde reports a missing field at its parent, so its name is taken from the
/// message.
fn refuse(path: &str, message: &str) -> Problem {
    let missing = message.strip_prefix("missing field `").and_then(|rest| rest.split('`').next());
    let field = match (path, missing) {
        (".", None) => {
            return Problem::malformed(format!(
                "the request does not have the expected form: {message}"
            ));
        }
        (".", Some(name)) => name.to_owned(),
        (path, Some(name)) => format!("{path}.{name}"),
        (path, None) => path.to_owned(),
    };
    let message = missing.map_or_else(|| message.to_owned(), |_| "is missing".to_owned());
    Problem::from(FieldError::new(field, message))
}

/// Query parameters.
#[derive(Debug)]
pub struct Query<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for Query<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _state: &S) -> Result<Self, Problem> {
        match axum::extract::Query::<T>::try_from_uri(&parts.uri) {
            Ok(axum::extract::Query(value)) => Ok(Self(value)),
            Err(rejection) => Err(refuse_query(&rejection)),
        }
    }
}

fn refuse_query(rejection: &QueryRejection) -> Problem {
    type Located = serde_path_to_error::Error<serde::de::value::Error>;
    let chain =
        std::iter::successors(Some(rejection as &(dyn Error + 'static)), |&error| error.source());
    match chain.filter_map(|error| error.downcast_ref::<Located>()).next() {
        Some(located) => refuse(&located.path().to_string(), &located.inner().to_string()),
        None => Problem::malformed("the query string cannot be read"),
    }
}

/// Path parameters.
#[derive(Debug, axum::extract::FromRequestParts)]
#[from_request(via(axum::extract::Path), rejection(Problem))]
pub struct Path<T>(pub T);

impl From<axum::extract::rejection::PathRejection> for Problem {
    fn from(_: axum::extract::rejection::PathRejection) -> Self {
        Self::malformed("the path cannot be read: percent-encoding must give UTF-8")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "only the refusals are looked at")]
    struct Request {
        powder: String,
        target: Target,
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "only the refusals are looked at")]
    struct Target {
        value: f64,
        unit: String,
    }

    #[test]
    fn a_refused_body_names_the_field() {
        for (body, field) in [
            (r#"{"powder":"salt","target":{"value":NaN,"unit":"mg"}}"#, "target.value"),
            (r#"{"powder":"salt","target":{"value":1e999,"unit":"mg"}}"#, "target.value"),
            (r#"{"powder":"salt","target":{"value":"15","unit":"mg"}}"#, "target.value"),
            (r#"{"powder":"salt","target":{"unit":"mg"}}"#, "target.value"),
            (r#"{"powder":"salt"}"#, "target"),
            (r#"{"powder":7}"#, "powder"),
            (r#"{"powder":"salt","pour":true}"#, "pour"),
        ] {
            let problem = parse::<Request>(body.as_bytes()).unwrap_err();
            assert_eq!(problem.status, 400, "{body}");
            assert_eq!(
                problem.errors.iter().map(|e| e.field.as_str()).collect::<Vec<_>>(),
                [field],
                "{problem:?}"
            );
        }
    }

    #[test]
    fn a_body_that_is_not_one_json_object_is_malformed() {
        for body in ["", "[", "[]", "{}{}", "\u{0}", "{\"powder\":"] {
            let problem = parse::<Request>(body.as_bytes()).unwrap_err();
            assert_eq!(problem.status, 400, "{body}");
        }
    }
}
