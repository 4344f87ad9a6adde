//! The web page: the files of `web/dist`, embedded at build time.
//!
//! The page is for browsers, which accept HTML. A program gets an error for an unknown path;
//! otherwise it would believe it had found an endpoint.
//!
//! The build of the page leaves a Brotli copy beside each file that gains by it (`app.js.br`). A caller
//! that reads Brotli gets the copy; every other answer is compressed as it is sent, or not at all.

use super::problem::Problem;
use super::{docs, grpc};
use axum::body::Body;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use rust_embed::{EmbeddedFile, RustEmbed};
use std::borrow::Cow;

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
    docs::answer(path).unwrap_or_else(|| answer(path, Takes::of(&headers), Files::get))
}

/// What the caller reads.
#[derive(Clone, Copy, Default)]
struct Takes {
    /// It explicitly accepts HTML; `*/*` alone is what programs send.
    html: bool,
    brotli: bool,
}

impl Takes {
    fn of(headers: &HeaderMap) -> Self {
        Self {
            html: lists(headers, &header::ACCEPT, &["text/html", "application/xhtml+xml"]),
            brotli: lists(headers, &header::ACCEPT_ENCODING, &["br"]),
        }
    }
}

/// Whether a header that lists what is accepted has one of these, not with the weight 0, which refuses.
fn lists(headers: &HeaderMap, name: &header::HeaderName, wanted: &[&str]) -> bool {
    let values = headers.get_all(name).iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).any(|one| {
        let mut parts = one.split(';').map(str::trim);
        let kind = parts.next().unwrap_or_default();
        let weight = parts.find_map(|part| part.strip_prefix("q=")?.parse::<f32>().ok());
        weight != Some(0.0) && wanted.iter().any(|wanted| kind.eq_ignore_ascii_case(wanted))
    })
}

fn answer(path: &str, takes: Takes, find: impl Fn(&str) -> Option<EmbeddedFile>) -> Response {
    let is_page = path.is_empty() || path == "index.html";
    let packed =
        |path: &str| takes.brotli.then(|| find(&format!("{path}.br"))).flatten().map(|f| f.data);
    if let Some(file) = find(path).filter(|_| !is_page) {
        // Vite puts a content hash in every file name below assets/.
        let hashed = path.starts_with("assets/");
        let cache = if hashed { "public, max-age=31536000, immutable" } else { "no-cache" };
        return with_packed(serve(file, cache), packed(path));
    }
    if !is_page && !takes.html {
        return Problem::not_found("no such path; /openapi.json lists all").into_response();
    }
    let looks_like_a_file = path.rsplit('/').next().is_some_and(|name| name.contains('.'));
    if looks_like_a_file && !is_page {
        return Problem::not_found("the page has no such file").into_response();
    }
    match find("index.html") {
        Some(page) => with_packed(serve(page, "no-cache"), packed("index.html")),
        None => (
            StatusCode::OK,
            "FLIP is running. The page is not built: run make web, then build again.\n",
        )
            .into_response(),
    }
}

/// The same file as its Brotli copy, where there is one for this caller.
fn with_packed(mut response: Response, packed: Option<Cow<'static, [u8]>>) -> Response {
    if let Some(bytes) = packed {
        *response.body_mut() = Body::from(bytes);
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static("br"));
        headers.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
    }
    response
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

    /// A page made of `index.html` and one asset with its Brotli copy; the contents do not matter here.
    fn built(name: &str) -> Option<EmbeddedFile> {
        let files = ["index.html", "assets/app-1a2b.js", "assets/app-1a2b.js.br"];
        files.contains(&name).then(|| Any::get("build.rs").unwrap())
    }

    const PROGRAM: Takes = Takes { html: false, brotli: false };
    const BROWSER: Takes = Takes { html: true, brotli: true };

    fn cache(response: &Response) -> &str {
        response.headers().get(header::CACHE_CONTROL).map_or("", |v| v.to_str().unwrap())
    }

    #[test]
    fn hashed_files_are_kept_for_ever_and_the_page_is_asked_for_again() {
        assert!(cache(&answer("assets/app-1a2b.js", PROGRAM, built)).contains("immutable"));
        for path in ["", "index.html", "weighings/01890000"] {
            let response = answer(path, BROWSER, built);
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
            assert_eq!(answer(path, BROWSER, built).status(), StatusCode::NOT_FOUND, "{path}");
        }
    }

    #[test]
    fn a_program_that_asks_for_a_path_that_nobody_knows_is_not_answered_with_the_page() {
        let accept = |kinds: &'static str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::ACCEPT, HeaderValue::from_static(kinds));
            Takes::of(&headers).html
        };
        assert!(
            accept("text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8")
                && accept("Text/HTML;q=0.5")
        );
        assert!(
            !accept("*/*")
                && !accept("application/json, text/plain, */*")
                && !Takes::of(&HeaderMap::new()).html
        );
        for path in ["status", "info", ".well-known/openid-configuration", "weighings/01890000"] {
            let response = answer(path, PROGRAM, built);
            assert_eq!(response.status(), StatusCode::NOT_FOUND, "{path}");
        }
        assert_eq!(answer("", PROGRAM, built).status(), StatusCode::OK);
    }

    #[test]
    fn a_copy_in_brotli_is_for_those_who_read_it() {
        let encoding = |path: &str, accepted: &'static str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::ACCEPT_ENCODING, HeaderValue::from_static(accepted));
            headers.insert(header::ACCEPT, HeaderValue::from_static("text/html"));
            let response = answer(path, Takes::of(&headers), built);
            let kind = response.headers()[header::CONTENT_TYPE].to_str().unwrap();
            assert_eq!(kind, "text/x-rust", "the kind of {path} itself, not of the copy");
            assert!(
                response.headers().contains_key(header::VARY)
                    == response.headers().contains_key(header::CONTENT_ENCODING)
            );
            response.headers().contains_key(header::CONTENT_ENCODING)
        };
        for accepted in ["br", "gzip, deflate, br, zstd", "gzip;q=1.0, BR;q=0.5"] {
            assert!(encoding("assets/app-1a2b.js", accepted), "{accepted}");
        }
        for accepted in ["gzip", "identity", "br;q=0", "gzip, br; q=0.0", "brotli"] {
            assert!(!encoding("assets/app-1a2b.js", accepted), "{accepted}");
        }
        assert!(!encoding("index.html", "br"), "there is no copy of it");
    }

    #[test]
    fn without_a_built_page_the_root_says_how_to_build_it() {
        let response = answer("", PROGRAM, |_| None);
        assert_eq!(response.status(), StatusCode::OK);
        assert!(
            response.headers()[header::CONTENT_TYPE].to_str().unwrap().starts_with("text/plain")
        );
    }
}
