//! Every list as a table: `?format=csv` or `?format=arrow`, or an `Accept` header that asks for one.
//!
//! A list is asked for page by page, as a caller would ask, and each page is sent as it comes: what a
//! table needs of memory does not grow with it. The columns are those of the list's schema: fields
//! inside others are named `asked.lot`, what has parts of its own is JSON.

mod arrow;
mod columns;
pub mod export;

use crate::api::problem::Problem;
use arrow::ArrowFile;
use axum::body::{Body, to_bytes};
use axum::extract::{MatchedPath, Request};
use axum::http::{HeaderMap, HeaderValue, Method, Uri, header, request};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use columns::{Column, columns};
use flip_core::domain::FieldError;
use futures::stream;
use serde_json::Value;
use std::sync::LazyLock;

const CSV: &str = "text/csv";
const ARROW: &str = "application/vnd.apache.arrow.file";
/// Items asked for at once: the most that any list gives.
const ROWS: &str = "200";
/// Largest page, bytes.
const PAGE_BYTES_MAX: usize = 256 * 1024 * 1024;

static DOCUMENT: LazyLock<Value> =
    LazyLock::new(|| serde_json::to_value(super::openapi()).unwrap_or_default());

/// What lists can be besides JSON.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Comma-separated text with a header.
    Csv,
    /// An Arrow IPC file.
    Arrow,
}

impl Format {
    fn content_type(self) -> &'static str {
        match self {
            Self::Csv => "text/csv; charset=utf-8",
            Self::Arrow => ARROW,
        }
    }

    fn extension(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Arrow => "arrow",
        }
    }
}

/// Whether a path of an OpenAPI document answers with a list, which can be a table.
pub fn is_list(document: &Value, path: &str) -> bool {
    columns(document, path).is_some()
}

/// Answers with a table where one is asked for; everything else passes.
pub async fn as_table(request: Request, next: Next) -> Response {
    let columns = request.extensions().get::<MatchedPath>().and_then(|path| {
        (request.method() == Method::GET).then(|| columns(&DOCUMENT, path.as_str()))?
    });
    let Some(columns) = columns else { return next.run(request).await };
    let (mut parts, body) = request.into_parts();
    let pairs = query(&parts.uri);
    let format = match asked(&pairs, &parts.headers) {
        Ok(format) => format,
        Err(problem) => return problem.into_response(),
    };
    let pairs: Vec<_> = pairs.into_iter().filter(|(key, _)| key != "format").collect();
    let Some(format) = format else {
        set_query(&mut parts.uri, &pairs);
        return next.run(Request::from_parts(parts, body)).await;
    };
    // A page that is asked for is that page; else all pages are meant.
    let one_page = pairs.iter().any(|(key, _)| key == "limit" || key == "after");
    match Table::begin(Pages { next, parts, pairs, one_page }, columns, format).await {
        Ok(response) | Err(response) => response,
    }
}

fn query(uri: &Uri) -> Vec<(String, String)> {
    form_urlencoded::parse(uri.query().unwrap_or_default().as_bytes()).into_owned().collect()
}

fn set_query(uri: &mut Uri, pairs: &[(String, String)]) {
    let text = form_urlencoded::Serializer::new(String::new()).extend_pairs(pairs).finish();
    let path = uri.path();
    let target = if text.is_empty() { path.to_owned() } else { format!("{path}?{text}") };
    // Encoded pairs after a path that was valid before.
    if let Ok(target) = target.parse() {
        *uri = target;
    }
}

/// What `format` asks for, else what `Accept` prefers; `None` for JSON.
fn asked(pairs: &[(String, String)], headers: &HeaderMap) -> Result<Option<Format>, Problem> {
    match pairs.iter().find(|(key, _)| key == "format").map(|(_, value)| value.as_str()) {
        Some("json") => Ok(None),
        Some("csv") => Ok(Some(Format::Csv)),
        Some("arrow") => Ok(Some(Format::Arrow)),
        Some(other) => {
            let advice = format!("must be json, csv or arrow, got `{other}`");
            Err(FieldError::new("format", advice).into())
        }
        None => {
            let accept = headers.get(header::ACCEPT).and_then(|it| it.to_str().ok());
            let first = accept.and_then(|it| it.split([',', ';']).next()).map(str::trim);
            Ok(match first {
                Some(CSV) => Some(Format::Csv),
                Some(ARROW) => Some(Format::Arrow),
                _ => None,
            })
        }
    }
}

/// The pages of a list.
struct Pages {
    next: Next,
    parts: request::Parts,
    pairs: Vec<(String, String)>,
    one_page: bool,
}

/// A page: its items, and where the next one begins.
type Page = (Vec<Value>, Option<String>);

impl Pages {
    /// The page after this one; a refusal as it is.
    async fn get(&self, after: Option<&str>) -> Result<Page, Response> {
        let mut pairs = self.pairs.clone();
        if let Some(after) = after {
            pairs.retain(|(key, _)| key != "after");
            pairs.push(("after".to_owned(), after.to_owned()));
        }
        if !self.one_page && is_paged(&self.parts) {
            pairs.push(("limit".to_owned(), ROWS.to_owned()));
        }
        let mut parts = self.parts.clone();
        set_query(&mut parts.uri, &pairs);
        let response = self.next.clone().run(Request::from_parts(parts, Body::empty())).await;
        if !response.status().is_success() {
            return Err(response);
        }
        let broken = |_| Problem::internal().into_response();
        let bytes = to_bytes(response.into_body(), PAGE_BYTES_MAX).await.map_err(broken)?;
        let broken = |_| Problem::internal().into_response();
        Ok(match serde_json::from_slice(&bytes).map_err(broken)? {
            Value::Array(items) => (items, None),
            mut page => {
                let next = page["next"].as_str().map(str::to_owned);
                let items = page["items"].as_array_mut().map(std::mem::take).unwrap_or_default();
                (items, next.filter(|_| !self.one_page))
            }
        })
    }
}

/// Whether a list has pages.
fn is_paged(parts: &request::Parts) -> bool {
    let path = parts.extensions.get::<MatchedPath>().map(MatchedPath::as_str).unwrap_or_default();
    let parameters = DOCUMENT["paths"][path]["get"]["parameters"].as_array();
    parameters.is_some_and(|all| all.iter().any(|it| it["name"] == "limit"))
}

/// A table that is being sent.
struct Table {
    pages: Pages,
    columns: Vec<Column>,
    writer: Writer,
    /// The page to send, or where it begins.
    ahead: Ahead,
}

enum Ahead {
    Page(Page),
    After(String),
    End,
    Over,
}

enum Writer {
    Csv { header: bool },
    Arrow(Option<Box<ArrowFile>>),
}

impl Table {
    /// The response. The first page is awaited, so that a refusal is one.
    async fn begin(
        pages: Pages,
        columns: Vec<Column>,
        format: Format,
    ) -> Result<Response, Response> {
        let first = pages.get(None).await?;
        let writer = Writer::begin(format, &columns).map_err(|error| {
            tracing::error!(%error, "a list has no Arrow schema");
            Problem::internal().into_response()
        })?;
        let path = pages.parts.uri.path().trim_end_matches('/').to_owned();
        let name = path.rsplit('/').next().unwrap_or("list").trim_end_matches(".json");
        let name = format!("attachment; filename=\"{name}.{}\"", format.extension());
        let table = Self { pages, columns, writer, ahead: Ahead::Page(first) };
        let mut response =
            Body::from_stream(stream::try_unfold(table, Self::piece)).into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(format.content_type()));
        if let Ok(name) = HeaderValue::from_str(&name) {
            headers.insert(header::CONTENT_DISPOSITION, name);
        }
        Ok(response)
    }

    /// The next piece of the table.
    async fn piece(mut self) -> Result<Option<(Vec<u8>, Self)>, axum::BoxError> {
        let (rows, next) = match std::mem::replace(&mut self.ahead, Ahead::Over) {
            Ahead::Page(page) => page,
            Ahead::After(after) => self.pages.get(Some(&after)).await.map_err(|refused| {
                format!("a table broke off: a page was answered with {}", refused.status())
            })?,
            Ahead::End => {
                let end = self.writer.end()?;
                return Ok(Some((end, self)));
            }
            Ahead::Over => return Ok(None),
        };
        self.ahead = next.map_or(Ahead::End, Ahead::After);
        let bytes = self.writer.rows(&self.columns, &rows)?;
        Ok(Some((bytes, self)))
    }
}

impl Writer {
    fn begin(format: Format, columns: &[Column]) -> Result<Self, axum::BoxError> {
        Ok(match format {
            Format::Csv => Self::Csv { header: true },
            Format::Arrow => Self::Arrow(Some(Box::new(ArrowFile::new(columns)?))),
        })
    }

    fn rows(&mut self, columns: &[Column], rows: &[Value]) -> Result<Vec<u8>, axum::BoxError> {
        match self {
            Self::Csv { header } => {
                let mut csv = csv::Writer::from_writer(Vec::new());
                if std::mem::take(header) {
                    csv.write_record(columns.iter().map(|column| &column.name))?;
                }
                for row in rows {
                    csv.write_record(columns.iter().map(|column| cell(column.of(row))))?;
                }
                Ok(csv.into_inner().map_err(|error| error.into_error())?)
            }
            Self::Arrow(Some(file)) => Ok(file.append(columns, rows)?),
            Self::Arrow(None) => Ok(Vec::new()),
        }
    }

    fn end(&mut self) -> Result<Vec<u8>, axum::BoxError> {
        match self {
            Self::Csv { .. } => Ok(Vec::new()),
            Self::Arrow(file) => {
                Ok(file.take().map(|file| file.finish()).transpose()?.unwrap_or_default())
            }
        }
    }
}

/// A cell of a CSV file; numbers with the digits of the JSON.
fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}
