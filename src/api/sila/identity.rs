//! On whose behalf a call is made: access tokens of the AuthenticationService, FLIP's own tokens,
//! or the token by whose name callers without any act.
//!
//! | caller | may |
//! |---|---|
//! | with the metadata AccessToken, or `authorization: Bearer` | what the FLIP token behind it permits |
//! | with none, where `--sila-role` names a token | what that token permits |
//! | with none, on a loopback address | read |
//! | with none, elsewhere | ask who the server is, and log in |
//!
//! Execution info, intermediate responses and results need none anywhere: the standard's clients
//! send none with them. Who knows the UUID of an execution was told it.

use super::error::{framework, invalid_token};
use super::feature::SERVICE;
use super::proto::sila2::org::silastandard::core::authorizationservice::v1::MetadataAccessToken;
use super::proto::sila2::org::silastandard::core::lockcontroller::v1::MetadataLockIdentifier;
use super::standard::framework_error::ErrorType;
use crate::api::auth::{self, Caller};
use crate::api::edge::carried_out;
use crate::api::front::Connection;
use crate::api::listen::is_loopback_name;
use crate::app::{App, Holder, acting};
use axum::extract::{Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, Version, header};
use axum::middleware::Next;
use axum::response::Response;
use base64::Engine;
use base64::alphabet;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use prost::Message;
use rand::TryRng;
use rand::rngs::SysRng;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tonic::Status;

/// Header of the access token, without its prefix and suffix.
const ACCESS_TOKEN: &str = "org.silastandard-core-authorizationservice-v1-metadata-accesstoken";
/// Header of the lock's identifier.
const LOCK_IDENTIFIER: &str = "org.silastandard-core-lockcontroller-v1-metadata-lockidentifier";
/// What every header with metadata of the standard begins with.
const METADATA: &str = "sila-";
/// Clients write base64 with and without padding.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &alphabet::STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);
/// How long an access token lasts after the last call with it.
pub const LIFE: Duration = Duration::from_secs(60 * 60);
/// Most access tokens at a time; the one that was used least recently makes room.
const SESSIONS_MAX: usize = 256;

/// Access tokens, and the FLIP tokens behind them. In memory: after a restart a client logs in
/// again.
#[derive(Default)]
pub struct Sessions(Mutex<HashMap<String, Session>>);

struct Session {
    secret: String,
    used: Instant,
}

impl Sessions {
    /// A new access token for this FLIP token.
    ///
    /// # Errors
    /// The system has no random numbers.
    pub fn begin(&self, secret: &str) -> Result<String, Status> {
        let mut random = [0u8; 32];
        let filled = SysRng.try_fill_bytes(&mut random);
        filled.map_err(|error| Status::internal(error.to_string()))?;
        let token = hex::encode(random);
        let mut all = self.all();
        if all.len() >= SESSIONS_MAX {
            let oldest = all.iter().min_by_key(|(_, it)| it.used).map(|(token, _)| token.clone());
            oldest.map(|token| all.remove(&token));
        }
        let session = Session { secret: secret.to_owned(), used: Instant::now() };
        all.insert(token.clone(), session);
        Ok(token)
    }

    /// Ends an access token. `false`: there is no such.
    pub fn end(&self, token: &str) -> bool {
        self.all().remove(token).is_some()
    }

    /// The FLIP token behind an access token, which lasts anew from now on.
    fn secret(&self, token: &str) -> Option<String> {
        let mut all = self.all();
        all.retain(|_, it| it.used.elapsed() < LIFE);
        let session = all.get_mut(token)?;
        session.used = Instant::now();
        Some(session.secret.clone())
    }

    fn all(&self) -> MutexGuard<'_, HashMap<String, Session>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// State of the layer.
#[derive(Clone)]
pub struct Gate {
    /// The application, which holds the tokens.
    pub app: App,
    /// Access tokens.
    pub sessions: Arc<Sessions>,
    /// Whether only this machine reaches the server.
    pub loopback: bool,
    /// Name of the token by which callers without one act.
    pub role: Option<String>,
}

/// Identifies the caller and stores a [`Caller`] in the request.
pub async fn identify(State(gate): State<Gate>, request: Request, next: Next) -> Response {
    let here = auth::authority(&request).to_owned();
    let (head, body) = request.into_parts();
    let caller = gate.caller(&head, &here).await;
    let mut request = Request::from_parts(head, body);
    match caller {
        Ok(caller) => {
            if let Some(connection) = request.extensions().get::<Arc<Connection>>()
                && !caller.is_anonymous()
            {
                connection.shown_token();
            }
            let who = caller.who();
            request.extensions_mut().insert(caller);
            acting(who, carried_out(request, next)).await
        }
        Err(status) => status.into_http(),
    }
}

impl Gate {
    async fn caller(&self, head: &Parts, here: &str) -> Result<Caller, Status> {
        // gRPC needs HTTP/2; a page in a browser could send the other.
        if head.version != Version::HTTP_2 {
            return Err(Status::invalid_argument("SiLA 2 is gRPC over HTTP/2"));
        }
        let headers = &head.headers;
        let of_service = names_service(head.uri.path());
        if of_service && headers.keys().any(|name| name.as_str().starts_with(METADATA)) {
            let advice = "calls of the SiLAService take no metadata";
            return Err(framework(ErrorType::NoMetadataAllowed, advice));
        }
        if let Some(token) = metadata::<MetadataAccessToken>(headers, ACCESS_TOKEN)? {
            let token = token.access_token.unwrap_or_default().value;
            return self.holder(&token).await;
        }
        if let Some(value) = headers.get(header::AUTHORIZATION) {
            return auth::bearer_of(&self.app, value)
                .await
                .map_err(|problem| invalid_token(problem.detail));
        }
        // A page elsewhere may have pointed its own name at this machine.
        let near = self.loopback && is_loopback_name(here);
        let role = self.role.as_deref().filter(|_| near || !self.loopback);
        let holder = role.and_then(|name| self.app.holder_named(name));
        Ok(holder.map_or(Caller::Anonymous { may_read: near }, Caller::Holder))
    }

    /// The holder of an access token, or of a FLIP token in its place.
    async fn holder(&self, token: &str) -> Result<Caller, Status> {
        let secret = self.sessions.secret(token).unwrap_or_else(|| token.to_owned());
        let holder = authenticated(&self.app, &secret).await;
        holder
            .map(Caller::Holder)
            .ok_or_else(|| invalid_token("it is unknown, has expired or was revoked: log in again"))
    }
}

/// The holder of a FLIP token.
pub async fn authenticated(app: &App, secret: &str) -> Option<Holder> {
    match app.authenticate(secret) {
        Some(holder) => Some(holder),
        None => app.authenticate_late(secret).await,
    }
}

/// The identifier of the lock that a call was sent with.
///
/// # Errors
/// It cannot be read.
pub fn lock_identifier(headers: &HeaderMap) -> Result<Option<String>, Status> {
    let sent = metadata::<MetadataLockIdentifier>(headers, LOCK_IDENTIFIER)?;
    Ok(sent.map(|it| it.lock_identifier.unwrap_or_default().value))
}

fn metadata<T: Message + Default>(headers: &HeaderMap, name: &str) -> Result<Option<T>, Status> {
    let Some(value) = headers.get(format!("{METADATA}{name}-bin")) else { return Ok(None) };
    let decoded = BASE64.decode(value.as_bytes()).ok().and_then(|it| T::decode(&*it).ok());
    let advice = format!("the metadata {name} cannot be read");
    decoded.map(Some).ok_or_else(|| framework(ErrorType::InvalidMetadata, advice))
}

/// Whether a path is that of a call of the SiLAService.
fn names_service(path: &str) -> bool {
    let service = SERVICE.replace('/', ".").to_ascii_lowercase();
    path.strip_prefix("/sila2.").is_some_and(|rest| {
        rest.get(..service.len()).is_some_and(|it| it.eq_ignore_ascii_case(&service))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::sila::value::text;

    #[test]
    fn metadata_is_read_with_and_without_padding() {
        let sent = MetadataAccessToken { access_token: text("flip_1_2") };
        let bytes = sent.encode_to_vec();
        for engine in [
            base64::engine::general_purpose::STANDARD,
            base64::engine::general_purpose::STANDARD_NO_PAD,
        ] {
            let mut headers = HeaderMap::new();
            let name = axum::http::HeaderName::try_from(format!("sila-{ACCESS_TOKEN}-bin"));
            headers.insert(name.unwrap(), engine.encode(&bytes).parse().unwrap());
            assert_eq!(metadata(&headers, ACCESS_TOKEN).unwrap(), Some(sent.clone()));
        }
        let mut headers = HeaderMap::new();
        let name = axum::http::HeaderName::try_from(format!("sila-{LOCK_IDENTIFIER}-bin"));
        headers.insert(name.unwrap(), "%%".parse().unwrap());
        assert!(lock_identifier(&headers).is_err());
    }

    #[test]
    fn an_access_token_ends_when_it_is_ended_and_makes_room_when_there_are_too_many() {
        let sessions = Sessions::default();
        let first = sessions.begin("flip_1_2").unwrap();
        assert_eq!(sessions.secret(&first).as_deref(), Some("flip_1_2"));
        assert!(sessions.end(&first) && !sessions.end(&first));
        assert_eq!(sessions.secret(&first), None);
        let oldest = sessions.begin("flip_1_2").unwrap();
        for _ in 0..SESSIONS_MAX {
            sessions.begin("flip_3_4").unwrap();
        }
        assert_eq!((sessions.secret(&oldest), sessions.all().len()), (None, SESSIONS_MAX));
    }

    #[test]
    fn only_calls_of_the_service_itself_take_no_metadata() {
        let path = "/sila2.org.silastandard.core.silaservice.v1.SiLAService/Get_ServerName";
        assert!(names_service(path));
        assert!(!names_service("/sila2.flip.weighing.powderweighing.v1.PowderWeighing/DosePowder"));
        assert!(!names_service("/"));
    }
}
