//! The documentation under `/docs/`: the files of `web/docs-dist` (`make docs`), embedded at build
//! time.

use super::page::serve;
use super::problem::Problem;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use rust_embed::{EmbeddedFile, RustEmbed};

#[derive(RustEmbed)]
#[folder = "web/docs-dist"]
#[allow_missing = true]
struct Files;

/// The response for a documentation path; `None` for any other path.
pub fn answer(path: &str) -> Option<Response> {
    match path {
        "docs" => Some(moved("/docs/")),
        "docs/api" => Some(moved("/docs/reference/rest.html")),
        path => path.strip_prefix("docs/").map(|file| file_of(file, Files::get)),
    }
}

fn file_of(path: &str, find: impl Fn(&str) -> Option<EmbeddedFile>) -> Response {
    let path = if path.is_empty() { "index.html" } else { path };
    match find(path) {
        Some(file) => serve(file, "no-cache"),
        None if find("index.html").is_none() => (
            StatusCode::NOT_FOUND,
            "The documentation is not built: run make docs, then build again.\n",
        )
            .into_response(),
        None => Problem::not_found("the documentation has no such page; /docs/ lists all")
            .into_response(),
    }
}

fn moved(to: &'static str) -> Response {
    (StatusCode::PERMANENT_REDIRECT, [(header::LOCATION, HeaderValue::from_static(to))])
        .into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(RustEmbed)]
    #[folder = "proto"]
    struct Any;

    fn built(name: &str) -> Option<EmbeddedFile> {
        matches!(name, "index.html" | "tutorials/first-dose.html")
            .then(|| Any::get("build.rs").unwrap())
    }

    #[test]
    fn pages_are_found_below_docs_and_nothing_else_is_taken() {
        for path in ["", "index.html", "tutorials/first-dose.html"] {
            assert_eq!(file_of(path, built).status(), StatusCode::OK, "{path}");
        }
        assert_eq!(file_of("tutorials/none.html", built).status(), StatusCode::NOT_FOUND);
        assert_eq!(answer("docs").unwrap().headers()[header::LOCATION], "/docs/");
        assert_eq!(
            answer("docs/api").unwrap().headers()[header::LOCATION],
            "/docs/reference/rest.html"
        );
        assert!(answer("documents").is_none() && answer("weighings/docs/").is_none());
    }

    #[test]
    fn where_it_is_not_built_it_says_how() {
        let response = file_of("", |_| None);
        assert_eq!(response.status(), StatusCode::NOT_FOUND);
        assert!(
            response.headers()[header::CONTENT_TYPE].to_str().unwrap().starts_with("text/plain")
        );
    }
}
