//! A request to a server, and its answer.

use crate::app::{Error, PageQuery, Result};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::time::Duration;
use ureq::http::Method;

/// How long the next byte of an answer may take.
const PATIENCE: Duration = Duration::from_secs(60);
/// As [`PATIENCE`], for what is computed before the first byte.
const LONG: Duration = Duration::from_secs(3600);

/// A request, to be sent once or, if that changes nothing, again.
#[derive(Debug, Clone)]
pub(in super::super) struct Request {
    pub(super) method: Method,
    /// Below the server's address.
    pub(super) path: String,
    pub(super) content_type: &'static str,
    pub(super) body: Option<Vec<u8>>,
    pub(super) key: Option<String>,
    /// Whether the same request again does nothing new.
    pub(super) repeatable: bool,
    pub(super) patience: Duration,
}

impl Request {
    fn new(method: Method, path: &[&str]) -> Self {
        let path: String = path.iter().map(|part| format!("/{}", in_path(part))).collect();
        Self {
            method,
            path: format!("/v1{path}"),
            content_type: "application/json",
            body: None,
            key: None,
            repeatable: false,
            patience: PATIENCE,
        }
    }

    /// Reads what is at `path` below `/v1`.
    pub(in super::super) fn get(path: &[&str]) -> Self {
        Self::new(Method::GET, path).repeatable()
    }

    /// Reads what is at a path that is not below `/v1`.
    pub(in super::super) fn outside(path: &str) -> Self {
        Self { path: path.to_owned(), ..Self::get(&[]) }
    }

    pub(in super::super) fn delete(path: &[&str]) -> Self {
        Self::new(Method::DELETE, path)
    }

    pub(in super::super) fn post(path: &[&str], body: &impl Serialize) -> Result<Self> {
        Self::new(Method::POST, path).json(body)
    }

    pub(in super::super) fn put(path: &[&str], body: &impl Serialize) -> Result<Self> {
        Ok(Self::new(Method::PUT, path).json(body)?.repeatable())
    }

    /// Sends a file.
    pub(in super::super) fn upload(path: &[&str], content_type: &'static str, file: &[u8]) -> Self {
        let body = Some(file.to_owned());
        Self { content_type, body, ..Self::new(Method::POST, path) }
    }

    fn json(self, body: &impl Serialize) -> Result<Self> {
        let body = serde_json::to_vec(body).map_err(|error| Error::Internal(error.into()))?;
        Ok(Self { body: Some(body), ..self })
    }

    /// With a parameter, if it has a value.
    pub(in super::super) fn with(self, name: &str, value: Option<impl ToString>) -> Self {
        let Some(value) = value else { return self };
        let mark = if self.path.contains('?') { '&' } else { '?' };
        let value = encoded(&value.to_string());
        Self { path: format!("{}{mark}{name}={value}", self.path), ..self }
    }

    /// With a parameter whose value has a name in JSON.
    pub(in super::super) fn with_word(self, name: &str, value: Option<impl Serialize>) -> Self {
        let word = value.and_then(|value| serde_json::to_value(value).ok());
        self.with(name, word.as_ref().and_then(|word| word.as_str()))
    }

    /// A page of a list.
    pub(in super::super) fn page(self, page: &PageQuery) -> Self {
        self.with("limit", page.limit).with("after", page.after.as_ref())
    }

    /// Makes sure that the request, sent again, does nothing twice.
    pub(in super::super) fn key(self, key: &str) -> Self {
        Self { key: Some(key.to_owned()), ..self }.repeatable()
    }

    /// Sent again, it finds what the first one began.
    pub(in super::super) fn repeatable(self) -> Self {
        Self { repeatable: true, ..self }
    }

    /// Answered after this time at the latest, or once its subject has ended.
    pub(in super::super) fn wait(self, seconds: u32) -> Self {
        let patience = PATIENCE + Duration::from_secs(seconds.into());
        Self { patience, ..self.with("wait", Some(seconds)) }
    }

    /// Computed while it waits.
    pub(in super::super) fn long(self) -> Self {
        Self { patience: LONG, ..self }
    }
}

/// The answer to a request that was not refused.
#[derive(Debug)]
pub(in super::super) struct Answer {
    pub(in super::super) status: u16,
    /// Whether its key was used before.
    pub(in super::super) is_replayed: bool,
    pub(in super::super) body: Vec<u8>,
}

impl Answer {
    pub(in super::super) fn json<T: DeserializeOwned>(&self) -> Result<T> {
        serde_json::from_slice(&self.body).map_err(|error| {
            let advice = "is it a FLIP of this version?";
            Error::Unavailable(format!(
                "the server answers with something else ({error}): {advice}"
            ))
        })
    }

    pub(in super::super) fn text(self) -> Result<String> {
        String::from_utf8(self.body).map_err(|error| Error::Internal(error.into()))
    }
}

fn encoded(text: &str) -> String {
    form_urlencoded::byte_serialize(text.as_bytes()).collect()
}

/// A blank is `+` only behind the question mark.
fn in_path(part: &str) -> String {
    encoded(part).replace('+', "%20")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_and_parameters_are_encoded() {
        let request = Request::get(&["powders", "a b/c+d", "card"])
            .with("lot", Some("L 1&2"))
            .with("bench", None::<&str>)
            .with_word("kind", Some(crate::app::JobKind::Film));
        assert_eq!(request.path, "/v1/powders/a%20b%2Fc%2Bd/card?lot=L+1%262&kind=film");
    }

    #[test]
    fn only_what_does_nothing_twice_is_sent_again() {
        assert!(Request::get(&["jobs"]).repeatable && !Request::delete(&["shakes"]).repeatable);
        let post = Request::post(&["weighings"], &1).unwrap();
        assert!(!post.repeatable && post.key("k").repeatable);
    }
}
