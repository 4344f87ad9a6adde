//! Authentication and authorization: one layer for REST and gRPC.
//!
//! | caller                                   | reads | writes | tokens |
//! |------------------------------------------|-------|--------|--------|
//! | nobody, service on a loopback address    | yes   | no     | no     |
//! | nobody, any other address                | no    | no     | no     |
//! | viewer                                   | yes   | no     | no     |
//! | operator                                 | yes   | yes    | no     |
//! | admin                                    | yes   | yes    | yes    |
//!
//! Anyone may log in, which is what a person without a token does ([`super::rest`], `/v1/login`).
//!
//! A latched bench can be cleared by an admin, or by an operator whose token permits it.
//!
//! A handler states its role with an extractor ([`Viewer`], [`Operator`], [`Admin`], [`Clearer`])
//! or, in gRPC, with [`require`] and [`require_clearer`]. The caller is available to everything the
//! request does ([`acting`]), so that records can name them.

use super::edge::carried_out;
use super::listen::is_loopback_name;
use super::problem::Problem;
use crate::app::{App, Holder, Role, Timestamp, Who, acting};
use axum::extract::FromRequestParts;
use axum::extract::Request;
use axum::extract::State;
use axum::http::request::Parts;
use axum::http::{Extensions, HeaderMap, HeaderValue, Method, Version, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;

/// Who sent a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Caller {
    /// No token.
    Anonymous {
        /// The service listens on a loopback address and was addressed by a loopback name.
        may_read: bool,
    },
    /// The holder of a token.
    Holder(Holder),
}

impl Caller {
    /// The caller as found by [`identify`]; a request that did not pass through it has no
    /// permissions.
    pub fn of(extensions: &Extensions) -> Self {
        extensions.get().cloned().unwrap_or(Self::Anonymous { may_read: false })
    }

    /// Whether no token was shown.
    pub fn is_anonymous(&self) -> bool {
        matches!(self, Self::Anonymous { .. })
    }

    /// Succeeds if the caller has at least `role`.
    ///
    /// # Errors
    /// 401 without a token, 403 if the token's role is too low.
    pub fn require(&self, role: Role) -> Result<(), Problem> {
        match self {
            Self::Anonymous { may_read: true } if role == Role::Viewer => Ok(()),
            Self::Anonymous { .. } => Err(Problem::unauthorized(format!(
                "send Authorization: Bearer with a token of role {role} (flip token create --role {role})",
                role = name(role)
            ))),
            Self::Holder(holder) if holder.role >= role => Ok(()),
            Self::Holder(holder) => {
                let (needed, held) = (name(role), name(holder.role));
                Err(Problem::forbidden(format!(
                    "this needs the role {needed}; the token has {held}"
                )))
            }
        }
    }

    /// Succeeds if the caller may clear a latched bench.
    ///
    /// # Errors
    /// 401 without a token, 403 if the token does not permit it.
    pub fn require_clearer(&self) -> Result<(), Problem> {
        self.require(Role::Operator)?;
        match self {
            Self::Holder(holder) if holder.may_clear => Ok(()),
            _ => Err(Problem::forbidden(
                "clearing a latch is a right of its own, which the token lacks: use an admin's, or one made with \
                 flip token create --role operator --may-clear",
            )),
        }
    }

    /// Who the caller is, as told to the caller.
    pub fn identity(&self) -> Identity {
        match self.clone() {
            Self::Anonymous { .. } => Identity {
                token: None,
                name: None,
                role: Role::Viewer,
                may_clear: false,
                expires_at: None,
                issuer: None,
            },
            Self::Holder(Holder { id, name, role, may_clear, expires_at, issuer }) => {
                Identity { token: Some(id), name: Some(name), role, may_clear, expires_at, issuer }
            }
        }
    }

    /// The caller as named in records.
    pub fn who(&self) -> Who {
        match self {
            Self::Anonymous { .. } => Who::anonymous(),
            Self::Holder(Holder { id, name, role, .. }) => {
                Who { name: name.clone(), token: Some(id.clone()), role: Some(*role) }
            }
        }
    }
}

/// Who a caller is, and what the caller may do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Identity {
    /// Id of the token; `None` without one.
    pub token: Option<String>,
    /// Its holder.
    pub name: Option<String>,
    /// What the caller may do.
    pub role: Role,
    /// Whether the caller may clear a latched bench.
    pub may_clear: bool,
    /// When the token expires; never if `None`.
    pub expires_at: Option<Timestamp>,
    /// Provider that the holder logged in with.
    pub issuer: Option<String>,
}

#[cfg(test)]
impl Caller {
    /// The holder of some token with this role.
    pub fn of_role(role: Role) -> Self {
        let (id, name) = ("1".to_owned(), "test".to_owned());
        Self::Holder(Holder { id, name, role, may_clear: false, expires_at: None, issuer: None })
    }
}

fn name(role: Role) -> &'static str {
    match role {
        Role::Viewer => "viewer",
        Role::Operator => "operator",
        Role::Admin => "admin",
    }
}

/// State of the layer.
#[derive(Clone)]
pub struct Gate {
    /// The application, which holds the tokens.
    pub app: App,
    /// Whether anonymous callers may read.
    pub loopback: bool,
}

/// Identifies the caller and stores a [`Caller`] in the request. An unknown token is refused on
/// every route.
pub async fn identify(State(gate): State<Gate>, mut request: Request, next: Next) -> Response {
    let caller = match request.headers().get(header::AUTHORIZATION).cloned() {
        Some(value) => bearer_of(&gate.app, &value).await,
        None => Ok(Caller::Anonymous {
            may_read: gate.loopback && is_loopback_name(authority(&request)),
        }),
    };
    match caller {
        Ok(caller) => {
            let who = caller.who();
            request.extensions_mut().insert(caller);
            acting(who, carried_out(request, next)).await
        }
        Err(problem) => problem.into_response(),
    }
}

/// Makes the caller found by [`identify`] available to everything the request does, in the task
/// that handles it, which may differ from the one that identified the caller.
pub async fn on_behalf(request: Request, next: Next) -> Response {
    let who = Caller::of(request.extensions()).who();
    acting(who, carried_out(request, next)).await
}

/// The holder of the token in an `Authorization` header.
///
/// # Errors
/// 401 if it holds none, or none that is valid.
pub async fn bearer_of(app: &App, authorization: &HeaderValue) -> Result<Caller, Problem> {
    let secret = authorization.to_str().ok().and_then(secret);
    let secret = secret.ok_or_else(|| {
        Problem::unauthorized(
            "write the header as Authorization: Bearer flip_..., or send HTTP Basic with the token as password",
        )
    })?;
    let holder = match app.authenticate(&secret) {
        Some(holder) => Some(holder),
        None => app.authenticate_late(&secret).await,
    };
    let holder = holder
        .ok_or_else(|| Problem::unauthorized("the token is unknown, has expired or was revoked"))?;
    Ok(Caller::Holder(holder))
}

/// The token of an `Authorization` header: of Bearer, or the password of Basic (RFC 7617), which is
/// all that some clients can send. The user name is theirs to choose.
fn secret(header: &str) -> Option<String> {
    let (scheme, value) = header.split_once(' ')?;
    let value = value.trim();
    if scheme.eq_ignore_ascii_case("bearer") {
        return Some(value.to_owned());
    }
    let decoded = scheme.eq_ignore_ascii_case("basic").then(|| STANDARD.decode(value).ok())??;
    let pair = String::from_utf8(decoded).ok()?;
    pair.split_once(':').map(|(_, password)| password.to_owned())
}

/// Host (HTTP/1) or authority (HTTP/2) of a request; empty if it has neither.
pub fn authority(request: &Request) -> &str {
    let host = || request.headers().get(header::HOST).and_then(|h| h.to_str().ok());
    request.uri().authority().map(|a| a.as_str()).or_else(host).unwrap_or_default()
}

/// Refuses HTTP/1.1 requests that do not name exactly one host: two parsers may disagree about such
/// a request.
pub async fn one_host(request: Request, next: Next) -> Response {
    let hosts = request.headers().get_all(header::HOST).iter().count();
    if hosts > 1 || hosts == 0 && request.version() == Version::HTTP_11 {
        return Problem::malformed("a request names one host: send one Host header")
            .into_response();
    }
    next.run(request).await
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
    let origin_ok = text("origin")
        .is_none_or(|o| o.split_once("://").is_some_and(|(_, host)| host == authority));
    site_ok && origin_ok
}

/// Succeeds if the caller found by [`identify`] has at least `role`.
///
/// # Errors
/// As [`Caller::require`]; a request that did not pass through [`identify`] is anonymous and has no
/// permissions.
pub fn require(extensions: &Extensions, role: Role) -> Result<(), Problem> {
    Caller::of(extensions).require(role)
}

/// Succeeds if the caller found by [`identify`] may clear a latched bench.
///
/// # Errors
/// As [`Caller::require_clearer`].
pub fn require_clearer(extensions: &Extensions) -> Result<(), Problem> {
    Caller::of(extensions).require_clearer()
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

/// The caller may clear a latched bench.
#[derive(Debug, Clone, Copy)]
pub struct Clearer;

impl<S: Sync> FromRequestParts<S> for Clearer {
    type Rejection = Problem;
    async fn from_request_parts(parts: &mut Parts, _state: &S) -> Result<Self, Problem> {
        require_clearer(&parts.extensions).map(|()| Self)
    }
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
        assert_eq!(status(local.clone(), Role::Viewer), None);
        assert_eq!(status(local, Role::Operator), Some(401));
        assert_eq!(status(held(Role::Viewer, false), Role::Operator), Some(403));
        assert_eq!(status(held(Role::Admin, true), Role::Operator), None);
        assert_eq!(status(held(Role::Operator, true), Role::Admin), Some(403));
    }

    fn held(role: Role, may_clear: bool) -> Caller {
        let (id, name) = ("0".into(), "test".into());
        Caller::Holder(Holder { id, name, role, may_clear, expires_at: None, issuer: None })
    }

    #[test]
    fn clearing_is_a_right_of_its_own_not_of_every_operators_token() {
        let status = |caller: Caller| caller.require_clearer().map_err(|p| p.status).err();
        assert_eq!(status(Caller::Anonymous { may_read: true }), Some(401));
        assert_eq!(status(held(Role::Viewer, true)), Some(403));
        assert_eq!(status(held(Role::Operator, false)), Some(403));
        assert_eq!(status(held(Role::Operator, true)), None);
        assert_eq!(status(held(Role::Admin, true)), None);
    }

    #[test]
    fn only_the_bearer_scheme_is_read() {
        assert_eq!(secret("bearer  flip_x").as_deref(), Some("flip_x"));
        assert_eq!(secret("Basic dTpmbGlwX3g=").as_deref(), Some("flip_x"), "of user `u`");
        assert_eq!(secret("Basic abc"), None);
        assert_eq!(secret("flip_x"), None);
    }
}
