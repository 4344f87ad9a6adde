//! The web page: the files of `web/dist`, embedded at build time.
//!
//! The page is for browsers, which accept HTML. A program gets an error for an unknown path;
//! otherwise it would believe it had found an endpoint.

use super::problem::Problem;
use super::{docs, grpc};
use axum::body::Body;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use rust_embed::{EmbeddedFile, RustEmbed};

#[derive(RustEmbed)]
#[folder = "web/dist"]
#[allow_missing = true]
struct Files;

/// Answers every path without a route: a file of the page, the page itself for its client-side
/// routes (`/weighings/…`), or a problem.
pub async fn fallback(method: Method, uri: Uri, headers: HeaderMap) -> Response {
    if grpc::is_grpc(&headers) {
        return tonic::Status::unimplemented("no such service; reflection lists all").into_http();
    }
    let path = uri.path().trim_start_matches('/');
    if path.starts_with("v1/") || path == "v1" || !matches!(method, Method::GET | Method::HEAD) {
        return Problem::not_found("no such path; /openapi.json lists all").into_response();
    }
    docs::answer(path).unwrap_or_else(|| answer(path, takes_html(&headers), Files::get))
}

/// Whether the caller explicitly accepts HTML; `*/*` alone is what programs send.
fn takes_html(headers: &HeaderMap) -> bool {
    let accepted = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok());
    let kinds = accepted
        .flat_map(|value| value.split(','))
        .map(|kind| kind.split(';').next().unwrap_or_default().trim());
    kinds.into_iter().any(|kind| {
        kind.eq_ignore_ascii_case("text/html") || kind.eq_ignore_ascii_case("application/xhtml+xml")
    })
}

fn answer(path: &str, takes_html: bool, find: impl Fn(&str) -> Option<EmbeddedFile>) -> Response {
    let is_page = path.is_empty() || path == "index.html";
    if let Some(file) = find(path).filter(|_| !is_page) {
        // Vite puts a content hash in every file name below assets/.
        let hashed = path.starts_with("assets/");
        return serve(
            file,
            if hashed { "public, max-age=31536000, immutable" } else { "no-cache" },
        );
    }
    if !is_page && !takes_html {
        return Problem::not_found("no such path; /openapi.json lists all").into_response();
    }
    let looks_like_a_file = path.rsplit('/').next().is_some_and(|name| name.contains('.'));
    if looks_like_a_file && !is_page {
        return Problem::not_found("the page has no such file").into_response();
    }
    match find("index.html") {
        Some(page) => serve(page, "no-cache"),
        None => (
            StatusCode::OK,
            "FLIP is running. The page is not built: run make web, then build again.\n",
        )
            .into_response(),
    }
}

/// Serves a file with this cache policy.
pub(super) fn serve(file: EmbeddedFile, cache: &'static str) -> Response {
    let kind = HeaderValue::from_str(file.metadata.mimetype())
        .unwrap_or(HeaderValue::from_static("application/octet-stream"));
    let headers =
        [(header::CONTENT_TYPE, kind), (header::CACHE_CONTROL, HeaderValue::from_static(cache))];
    (headers, Body::from(file.data)).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(RustEmbed)]
    #[folder = "proto"]
    struct Any;

    /// A page made of `index.html` and one asset; the contents do not matter here.
    fn built(name: &str) -> Option<EmbeddedFile> {
        matches!(name, "index.html" | "assets/app-1a2b.js").then(|| Any::get("build.rs").unwrap())
    }

    fn cache(response: &Response) -> &str {
        response.headers().get(header::CACHE_CONTROL).map_or("", |v| v.to_str().unwrap())
    }

    #[test]
    fn hashed_files_are_kept_for_ever_and_the_page_is_asked_for_again() {
        assert!(cache(&answer("assets/app-1a2b.js", false, built)).contains("immutable"));
        for path in ["", "index.html", "weighings/01890000"] {
            let response = answer(path, true, built);
            assert_eq!(
                (response.status(), cache(&response)),
                (StatusCode::OK, "no-cache"),
                "{path}"
            );
        }
    }

    #[test]
    fn a_missing_file_is_not_answered_with_the_page() {
        for path in ["assets/old-0000.js", "favicon.png", "../Cargo.toml"] {
            assert_eq!(answer(path, true, built).status(), StatusCode::NOT_FOUND, "{path}");
        }
    }

    #[test]
    fn a_program_that_asks_for_a_path_that_nobody_knows_is_not_answered_with_the_page() {
        let accept = |kinds: &'static str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::ACCEPT, HeaderValue::from_static(kinds));
            takes_html(&headers)
        };
        assert!(
            accept("text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8")
                && accept("Text/HTML;q=0.5")
        );
        assert!(
            !accept("*/*")
                && !accept("application/json, text/plain, */*")
                && !takes_html(&HeaderMap::new())
        );
        for path in ["status", "info", ".well-known/openid-configuration", "weighings/01890000"] {
            let response = answer(path, false, built);
            assert_eq!(response.status(), StatusCode::NOT_FOUND, "{path}");
        }
        assert_eq!(answer("", false, built).status(), StatusCode::OK);
    }

    #[test]
    fn without_a_built_page_the_root_says_how_to_build_it() {
        let response = answer("", false, |_| None);
        assert_eq!(response.status(), StatusCode::OK);
        assert!(
            response.headers()[header::CONTENT_TYPE].to_str().unwrap().starts_with("text/plain")
        );
    }
}
