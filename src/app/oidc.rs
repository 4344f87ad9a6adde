//! Log-ins with the lab's own accounts: OpenID Connect, authorization code with PKCE.
//!
//! 1. [`App::begin_log_in`] names the page of the provider to open, and a secret for whoever asked.
//! 2. The provider sends the browser back to FLIP's page with a code and the state.
//! 3. [`App::finish_log_in`] takes both and the secret, exchanges the code for an ID token, verifies
//!    it, and issues one of FLIP's own tokens, which ends after [`LIFE_S`].
//!
//! Code and state pass through an address, which histories and logs keep. They open nothing without
//! the secret, which never leaves the tab that began, and the state counts once.

mod id_token;
mod provider;

use super::check::Check;
use super::{App, Error, NewToken, Result};
use flip_core::domain::FieldError;
use flip_store::tokens::{Role, TokenEntry};
use provider::Provider;
use rand::TryRng;
use rand::rngs::SysRng;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use subtle::ConstantTimeEq;
use ureq::http::Uri;

/// Lifetime of a token that a log-in issues, s: a long day at the bench.
const LIFE_S: u64 = 12 * 3600;
/// Time that a person may take at the provider.
const PATIENCE: Duration = Duration::from_secs(600);
/// Log-ins under way; when there are more, the oldest is forgotten.
const UNDER_WAY_MAX: usize = 1000;

/// What the person who runs FLIP says about the provider.
#[derive(Clone)]
pub struct OidcSettings {
    /// Issuer, exactly as in the provider's discovery document.
    pub issuer: String,
    /// Id under which FLIP is registered at the provider.
    pub client_id: String,
    /// Secret that goes with it.
    pub client_secret: String,
    /// Address of FLIP's page, as browsers see it and as registered at the provider.
    pub redirect_url: String,
    /// Scopes to ask for.
    pub scopes: String,
    /// Claim of the ID token with a person's groups.
    pub role_claim: String,
    /// Which group has which role.
    pub roles: Vec<(Role, String)>,
}

/// A provider of log-ins, and the log-ins under way. Cheap to clone.
#[derive(Clone)]
pub struct Oidc(Arc<Inner>);

struct Inner {
    provider: Provider,
    under_way: Mutex<HashMap<String, Begun>>,
}

/// A log-in under way, by its state.
struct Begun {
    secret: String,
    nonce: String,
    verifier: String,
    at: Instant,
}

/// The first half of a log-in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BegunLogIn {
    /// Page of the provider to open in a browser.
    pub url: String,
    /// The provider returns it with its code.
    pub state: String,
    /// Needed to finish; to be kept by whoever began.
    pub secret: String,
}

/// The second half of a log-in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogInAnswer {
    /// As returned by the provider.
    pub state: String,
    /// As returned by the provider.
    pub code: String,
    /// As given when it began.
    pub secret: String,
}

impl Oidc {
    /// A provider with these settings; it is not asked for anything yet.
    ///
    /// # Errors
    /// `Invalid`, with every setting that cannot be used.
    pub fn new(settings: OidcSettings) -> Result<Self> {
        let mut check = Check::default();
        if let Some(url) = check.keep(address("oidc_issuer", &settings.issuer))
            && url.query().is_some()
        {
            check.refuse(
                "oidc_issuer",
                "must have no query: copy `issuer` from the discovery document",
            );
        }
        if let Some(url) = check.keep(address("oidc_redirect_url", &settings.redirect_url))
            && (url.path() != "/" || url.query().is_some() || !settings.redirect_url.ends_with('/'))
        {
            let message = "must be the address of FLIP's page, without a path and with a last slash, as in https://flip.example.org/";
            check.refuse("oidc_redirect_url", message);
        }
        check.text("oidc_client_id", &settings.client_id, 500);
        check.text("oidc_client_secret_file", &settings.client_secret, 500);
        check.text("oidc_role_claim", &settings.role_claim, 200);
        if !settings.scopes.split(' ').any(|scope| scope == "openid") {
            check.refuse("oidc_scopes", "must name `openid`, as in \"openid profile email\"");
        }
        if settings.roles.is_empty() {
            check.refuse("oidc_role", "must say which group has which role, as in operator=GROUP");
        }
        check.done()?;
        let under_way = Mutex::default();
        Ok(Self(Arc::new(Inner { provider: Provider::new(settings), under_way })))
    }

    /// Remembers a log-in; returns its state.
    fn remember(&self, begun: Begun) -> Result<String> {
        let state = random()?;
        let mut under_way = self.0.under_way.lock().unwrap_or_else(PoisonError::into_inner);
        under_way.retain(|_, it| it.at.elapsed() < PATIENCE);
        while under_way.len() >= UNDER_WAY_MAX {
            let oldest =
                under_way.iter().min_by_key(|(_, it)| it.at).map(|(state, _)| state.clone());
            oldest.map(|state| under_way.remove(&state));
        }
        under_way.insert(state.clone(), begun);
        Ok(state)
    }

    /// The log-in with this state, if this is its secret. Either way its state is used up.
    fn take(&self, answer: &LogInAnswer) -> Option<Begun> {
        let mut under_way = self.0.under_way.lock().unwrap_or_else(PoisonError::into_inner);
        let begun = under_way.remove(&answer.state)?;
        let is_same = bool::from(begun.secret.as_bytes().ct_eq(answer.secret.as_bytes()));
        (is_same && begun.at.elapsed() < PATIENCE).then_some(begun)
    }
}

impl App {
    /// Host of the provider that people can log in with; `None` if this service has none.
    pub fn log_in_host(&self) -> Option<&str> {
        self.inner.oidc.as_ref().map(|oidc| oidc.0.provider.host())
    }

    /// Asks the provider what a log-in needs, so that the log tells of a mistake at the start. Does
    /// nothing without a provider.
    pub async fn greet_provider(self) {
        let Some(Oidc(inner)) = &self.inner.oidc else { return };
        match inner.provider.discovery().await {
            Ok(_) => tracing::info!(provider = inner.provider.host(), "people can log in"),
            Err(error) => tracing::warn!(%error, "nobody can log in yet; every log-in tries again"),
        }
    }

    /// Begins a log-in.
    ///
    /// # Errors
    /// `Conflict` without a provider, `Unavailable` if it does not answer.
    pub async fn begin_log_in(&self) -> Result<BegunLogIn> {
        let oidc = self.oidc()?;
        let endpoints = oidc.0.provider.discovery().await?;
        let (secret, nonce, verifier) = (random()?, random()?, random()?);
        let begun =
            Begun { secret: secret.clone(), nonce: nonce.clone(), verifier, at: Instant::now() };
        let challenge = provider::challenge(&begun.verifier);
        let state = oidc.remember(begun)?;
        let url = oidc.0.provider.page(&endpoints, &state, &nonce, &challenge);
        Ok(BegunLogIn { url, state, secret })
    }

    /// Finishes a log-in; returns a token's entry and its secret, as [`App::make_token`] does.
    ///
    /// # Errors
    /// `Refused`: the log-in is unknown, over or somebody else's, the provider's answer cannot be
    /// trusted, or the person has no role here. `Conflict` without a provider, `Unavailable` if it
    /// does not answer.
    pub async fn finish_log_in(&self, answer: &LogInAnswer) -> Result<(TokenEntry, String)> {
        let oidc = self.oidc()?;
        let finished = self.finish_at(oidc, answer).await;
        if let Err(error) = &finished {
            tracing::warn!(%error, provider = oidc.0.provider.host(), "a log-in failed");
        }
        finished
    }

    async fn finish_at(&self, oidc: &Oidc, answer: &LogInAnswer) -> Result<(TokenEntry, String)> {
        let begun = oidc.take(answer).ok_or_else(|| {
            let minutes = PATIENCE.as_secs() / 60;
            Error::Refused(format!(
                "this log-in was not begun in this tab within the last {minutes} minutes, or is finished already: log in again"
            ))
        })?;
        let provider = &oidc.0.provider;
        let person = provider.person(&answer.code, &begun.verifier, &begun.nonce).await?;
        let settings = provider.settings();
        let held = settings.roles.iter().filter(|(_, group)| person.groups.contains(group));
        let role = held.map(|(role, _)| *role).max().ok_or_else(|| {
            Error::Refused(format!(
                "{} is logged in at {}, but none of the groups there has a role here: ask whoever runs this service (--oidc-role)",
                person.name,
                provider.host()
            ))
        })?;
        let new =
            NewToken { name: person.name, role, may_clear: false, expires_in_s: Some(LIFE_S) };
        self.issue_token(&new, Some((&settings.issuer, &person.subject))).await
    }

    fn oidc(&self) -> Result<&Oidc> {
        self.inner.oidc.as_ref().ok_or_else(|| {
            Error::conflict(
                "log_in_not_set_up",
                "this service knows no provider of log-ins (flip serve --oidc-issuer): use a token",
            )
        })
    }
}

/// An absolute address that can be trusted on its way: encrypted, or on this machine.
fn address(field: &str, text: &str) -> std::result::Result<Uri, FieldError> {
    let refuse = |why: &str| FieldError::new(field, format!("{why}, got `{text}`"));
    let url: Uri =
        text.parse().map_err(|_| refuse("must be an address such as https://id.example.org"))?;
    let host = url.host().unwrap_or_default();
    let is_here = matches!(host, "localhost" | "127.0.0.1" | "[::1]");
    let is_safe = match url.scheme_str() {
        Some("https") => !host.is_empty(),
        Some("http") => is_here,
        _ => false,
    };
    let has_user = url.authority().is_some_and(|it| it.as_str().contains('@'));
    if !is_safe || has_user || text.contains('#') {
        return Err(refuse(
            "must begin with https:// (http:// on this machine only) and name no user and no fragment",
        ));
    }
    Ok(url)
}

/// 256 random bits, as text that an address can hold.
fn random() -> Result<String> {
    let mut bytes = [0u8; 32];
    SysRng.try_fill_bytes(&mut bytes).map_err(|error| Error::Internal(error.into()))?;
    Ok(hex::encode(bytes))
}

#[cfg(test)]
mod tests;
