//! Who calls, and what they may do: one layer for REST and gRPC.
//!
//! | caller                                   | reads | writes | tokens |
//! |------------------------------------------|-------|--------|--------|
//! | nobody, service on a loopback address    | yes   | no     | no     |
//! | nobody, any other address                | no    | no     | no     |
//! | viewer                                   | yes   | no     | no     |
//! | operator                                 | yes   | yes    | no     |
//! | admin                                    | yes   | yes    | yes    |
//!
//! A handler names its role with an extractor ([`Viewer`], [`Operator`], [`Admin`]) or, in gRPC, with [`require`].

use super::listen::is_loopback_name;
use super::problem::Problem;
use crate::app::App;
use crate::app::Role;
use axum::extract::FromRequestParts;
use axum::extract::Request;
use axum::extract::State;
use axum::http::request::Parts;
use axum::http::{Extensions, HeaderMap, HeaderValue, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

/// Who sent a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Caller {
    /// No token.
    Anonymous {
        /// The service listens on a loopback address and was addressed by a loopback name.
        may_read: bool,
    },
    /// The holder of a token.
    Holder(Role),
}

impl Caller {
    /// Nothing, if the caller may do what needs `role`.
    ///
    /// # Errors
    /// 401 without a token, 403 with one of too low a role.
    pub fn require(self, role: Role) -> Result<(), Problem> {
        match self {
            Self::Anonymous { may_read: true } if role == Role::Viewer => Ok(()),
            Self::Anonymous { .. } => Err(Problem::unauthorized(format!(
                "send Authorization: Bearer with a token of role {role} (flip token create --role {role})",
                role = name(role)
            ))),
            Self::Holder(held) if held >= role => Ok(()),
            Self::Holder(held) => {
                Err(Problem::forbidden(format!("this needs the role {}; the token has {}", name(role), name(held))))
            }
        }
    }
}

fn name(role: Role) -> &'static str {
    match role {
        Role::Viewer => "viewer",
        Role::Operator => "operator",
        Role::Admin => "admin",
    }
}

/// What the layer needs to know.
#[derive(Clone)]
pub struct Gate {
    /// Knows the tokens.
    pub app: App,
    /// Whether anonymous callers may read.
    pub loopback: bool,
}

/// Finds out who calls and leaves a [`Caller`] in the request. A token that is not known is refused whatever it asks for.
pub async fn identify(State(gate): State<Gate>, mut request: Request, next: Next) -> Response {
    let caller = match request.headers().get(header::AUTHORIZATION).cloned() {
        Some(value) => holder(&gate.app, &value).await,
        None => Ok(Caller::Anonymous { may_read: gate.loopback && is_loopback_name(authority(&request)) }),
    };
    match caller {
        Ok(caller) => {
            request.extensions_mut().insert(caller);
            next.run(request).await
        }
        Err(problem) => problem.into_response(),
    }
}

async fn holder(app: &App, authorization: &HeaderValue) -> Result<Caller, Problem> {
    let secret = authorization.to_str().ok().and_then(bearer);
    let secret = secret.ok_or_else(|| Problem::unauthorized("write the header as Authorization: Bearer flip_..."))?;
    let role = app.authenticate(secret).await?;
    Ok(Caller::Holder(role.ok_or_else(|| Problem::unauthorized("the token is not known"))?))
}

fn bearer(header: &str) -> Option<&str> {
    let (scheme, secret) = header.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| secret.trim())
}

/// Host (HTTP/1) or authority (HTTP/2) of a request; empty if it has neither.
fn authority(request: &Request) -> &str {
    let host = || request.headers().get(header::HOST).and_then(|h| h.to_str().ok());
    request.uri().authority().map(|a| a.as_str()).or_else(host).unwrap_or_default()
}

/// Refuses unsafe requests that a page of another origin made a browser send (CSRF).
pub async fn same_origin(request: Request, next: Next) -> Response {
    let safe = matches!(*request.method(), Method::GET | Method::HEAD | Method::OPTIONS);
    if safe || is_same_origin(request.headers(), authority(&request)) {
        return next.run(request).await;
    }
    Problem::forbidden("requests from pages of another origin are refused").into_response()
}

/// Programs send neither header; browsers send both, and pages cannot forge them.
fn is_same_origin(headers: &HeaderMap, authority: &str) -> bool {
    let text = |name: &str| headers.get(name).map(|value| value.to_str().unwrap_or("unreadable"));
    let site_ok = matches!(text("sec-fetch-site"), None | Some("same-origin" | "none"));
    let origin_ok = text("origin").is_none_or(|o| o.split_once("://").is_some_and(|(_, host)| host == authority));
    site_ok && origin_ok
}

/// Nothing, if the caller found by [`identify`] may do what needs `role`.
///
/// # Errors
/// As [`Caller::require`]; a request that never passed [`identify`] is anonymous and may nothing.
pub fn require(extensions: &Extensions, role: Role) -> Result<(), Problem> {
    let caller = extensions.get::<Caller>().copied();
    caller.unwrap_or(Caller::Anonymous { may_read: false }).require(role)
}

macro_rules! extractors {
    ($($(#[$doc:meta])* $name:ident),*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Copy)]
        pub struct $name;

        impl<S: Sync> FromRequestParts<S> for $name {
            type Rejection = Problem;
            async fn from_request_parts(parts: &mut Parts, _state: &S) -> Result<Self, Problem> {
                require(&parts.extensions, Role::$name).map(|()| Self)
            }
        }
    )*};
}

extractors! {
    /// The caller may read.
    Viewer,
    /// The caller may start, stop and add things.
    Operator,
    /// The caller may make tokens.
    Admin
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_of_other_origins_are_told_apart_from_ours_and_from_programs() {
        let headers = |pairs: &[(&'static str, &'static str)]| -> HeaderMap {
            pairs.iter().map(|&(n, v)| (n.parse().unwrap(), HeaderValue::from_static(v))).collect()
        };
        let ours = "127.0.0.1:8080";
        assert!(is_same_origin(&headers(&[]), ours));
        assert!(is_same_origin(
            &headers(&[("origin", "http://127.0.0.1:8080"), ("sec-fetch-site", "same-origin")]),
            ours
        ));
        for foreign in [
            headers(&[("origin", "http://evil.example")]),
            headers(&[("origin", "null")]),
            headers(&[("origin", "http://127.0.0.1:9999")]),
            headers(&[("sec-fetch-site", "cross-site")]),
            headers(&[("sec-fetch-site", "same-site")]),
        ] {
            assert!(!is_same_origin(&foreign, ours), "{foreign:?}");
        }
    }

    #[test]
    fn a_role_reaches_as_far_as_its_rank() {
        let status = |caller: Caller, role| caller.require(role).map_err(|p| p.status).err();
        let stranger = Caller::Anonymous { may_read: false };
        let local = Caller::Anonymous { may_read: true };
        assert_eq!(status(stranger, Role::Viewer), Some(401));
        assert_eq!(status(local, Role::Viewer), None);
        assert_eq!(status(local, Role::Operator), Some(401));
        assert_eq!(status(Caller::Holder(Role::Viewer), Role::Operator), Some(403));
        assert_eq!(status(Caller::Holder(Role::Admin), Role::Operator), None);
        assert_eq!(status(Caller::Holder(Role::Operator), Role::Admin), Some(403));
    }

    #[test]
    fn only_the_bearer_scheme_is_read() {
        assert_eq!(bearer("bearer  flip_x"), Some("flip_x"));
        assert_eq!(bearer("Basic abc"), None);
        assert_eq!(bearer("flip_x"), None);
    }
}
