//! What FLIP asks a provider: what it offers, a person's ID token, and the keys that signed it.

use super::super::agent::agent;
use super::super::{Error, Result};
use super::OidcSettings;
use super::id_token::{self, Person};
use base64::Engine;
use base64::engine::general_purpose::{STANDARD, URL_SAFE_NO_PAD};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};
use std::time::{Duration, Instant};
use tokio::sync::Mutex;
use ureq::Agent;
use ureq::http::header;

/// How long one request to the provider may take.
const ANSWER_MAX: Duration = Duration::from_secs(10);
/// Largest answer that is read.
const ANSWER_BYTES_MAX: u64 = 1 << 20;
/// How long its addresses are believed.
const KNOWN: Duration = Duration::from_secs(600);
/// How long a provider that did not answer is left alone: requests that came meanwhile share the failure.
const APART: Duration = Duration::from_secs(2);

/// What a provider says of itself, `/.well-known/openid-configuration`.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct Discovery {
    issuer: String,
    authorization_endpoint: String,
    token_endpoint: String,
    jwks_uri: String,
}

/// A provider.
pub(super) struct Provider {
    settings: OidcSettings,
    host: String,
    agent: Agent,
    /// When it was last asked what it offers, and its answer or why there is none.
    asked: Mutex<Option<(Instant, std::result::Result<Discovery, String>)>>,
}

impl Provider {
    pub(super) fn new(settings: OidcSettings) -> Self {
        let agent = agent(ANSWER_MAX);
        let host = settings.issuer.split('/').nth(2).unwrap_or_default().to_owned();
        Self { settings, host, agent, asked: Mutex::default() }
    }

    pub(super) fn settings(&self) -> &OidcSettings {
        &self.settings
    }

    /// Host of the issuer, for people.
    pub(super) fn host(&self) -> &str {
        &self.host
    }

    /// What the provider offers.
    pub(super) async fn discovery(&self) -> Result<Discovery> {
        let mut asked = self.asked.lock().await;
        if let Some((at, known)) = &*asked
            && at.elapsed() < if known.is_ok() { KNOWN } else { APART }
        {
            return known.clone().map_err(Error::Unavailable);
        }
        let found = self.discover().await;
        *asked = Some((Instant::now(), found.clone()));
        found.map_err(Error::Unavailable)
    }

    async fn discover(&self) -> std::result::Result<Discovery, String> {
        let issuer = &self.settings.issuer;
        let url = format!("{}/.well-known/openid-configuration", issuer.trim_end_matches('/'));
        let found: Discovery = self.read(url).await?;
        if found.issuer != *issuer {
            return Err(format!(
                "{} calls itself `{}`, not `{issuer}`: --oidc-issuer must be exactly that",
                self.host, found.issuer
            ));
        }
        let endpoints = [&found.authorization_endpoint, &found.token_endpoint, &found.jwks_uri];
        match endpoints.iter().find(|it| super::address("", it).is_err()) {
            Some(url) => Err(format!("{} names an address that is not safe: {url}", self.host)),
            None => Ok(found),
        }
    }

    /// The page where a person logs in.
    pub(super) fn page(
        &self,
        endpoints: &Discovery,
        state: &str,
        nonce: &str,
        challenge: &str,
    ) -> String {
        let query = form_urlencoded::Serializer::new(String::new())
            .append_pair("response_type", "code")
            .append_pair("client_id", &self.settings.client_id)
            .append_pair("redirect_uri", &self.settings.redirect_url)
            .append_pair("scope", &self.settings.scopes)
            .append_pair("state", state)
            .append_pair("nonce", nonce)
            .append_pair("code_challenge", challenge)
            .append_pair("code_challenge_method", "S256")
            .finish();
        let page = &endpoints.authorization_endpoint;
        format!("{page}{}{query}", if page.contains('?') { '&' } else { '?' })
    }

    /// Who logged in, from the code that the provider gave the browser.
    pub(super) async fn person(&self, code: &str, verifier: &str, nonce: &str) -> Result<Person> {
        let endpoints = self.discovery().await?;
        let token = self.id_token(endpoints.token_endpoint, code, verifier).await?;
        // Read anew for each log-in: they are rare, and keys change.
        let keys: id_token::Keys =
            self.read(endpoints.jwks_uri).await.map_err(Error::Unavailable)?;
        id_token::verify(&token, &keys, &self.settings, nonce).map_err(|why| {
            Error::Refused(format!("the answer of {} cannot be trusted: {why}", self.host))
        })
    }

    async fn id_token(&self, url: String, code: &str, verifier: &str) -> Result<String> {
        let OidcSettings { client_id, client_secret, redirect_url, .. } = &self.settings;
        let form = form_urlencoded::Serializer::new(String::new())
            .append_pair("grant_type", "authorization_code")
            .append_pair("code", code)
            .append_pair("redirect_uri", redirect_url)
            .append_pair("code_verifier", verifier)
            .finish();
        let encoded =
            |text: &str| -> String { form_urlencoded::byte_serialize(text.as_bytes()).collect() };
        let pair = format!("{}:{}", encoded(client_id), encoded(client_secret));
        let basic = format!("Basic {}", STANDARD.encode(pair));
        let (status, body) = self
            .ask(move |agent| {
                agent
                    .post(url)
                    .header(header::AUTHORIZATION, basic)
                    .header(header::CONTENT_TYPE, "application/x-www-form-urlencoded")
                    .send(form)
            })
            .await
            .map_err(Error::Unavailable)?;
        if status >= 500 {
            return Err(Error::Unavailable(format!("{} answers with status {status}", self.host)));
        }
        let said: Exchanged = serde_json::from_slice(&body).unwrap_or_default();
        let host = &self.host;
        match (said.id_token, said.error.as_deref()) {
            (Some(token), _) if status == 200 => Ok(token),
            (_, Some("invalid_client" | "unauthorized_client")) => Err(Error::Refused(format!(
                "{host} does not accept FLIP's client id or secret: whoever runs this service must correct them"
            ))),
            (_, Some("invalid_grant")) => Err(Error::Refused(format!(
                "{host} does not accept the code, which counts once and for a short time: log in again"
            ))),
            _ => Err(Error::Refused(format!(
                "{host} gives no ID token (status {status}): log in again, and check the client's settings there if that does not help"
            ))),
        }
    }

    /// Reads a JSON document.
    async fn read<T: DeserializeOwned>(&self, url: String) -> std::result::Result<T, String> {
        let asked = url.clone();
        let (status, body) = self.ask(move |agent| agent.get(asked).call()).await?;
        if status != 200 {
            return Err(format!("{} answers {url} with status {status}", self.host));
        }
        serde_json::from_slice(&body)
            .map_err(|error| format!("{} answers {url} with something else: {error}", self.host))
    }

    /// Status and body of a request, made where waiting is allowed.
    async fn ask(
        &self,
        request: impl FnOnce(
            &Agent,
        )
            -> std::result::Result<ureq::http::Response<ureq::Body>, ureq::Error>
        + Send
        + 'static,
    ) -> std::result::Result<(u16, Vec<u8>), String> {
        let agent = self.agent.clone();
        let asked = tokio::task::spawn_blocking(move || {
            let mut response = request(&agent)?;
            let body = response.body_mut().with_config().limit(ANSWER_BYTES_MAX).read_to_vec()?;
            Ok::<_, ureq::Error>((response.status().as_u16(), body))
        });
        let answered = asked.await.map_err(|error| error.to_string())?;
        answered.map_err(|error| {
            format!("{} cannot be reached ({error}): try again later, or use a token", self.host)
        })
    }
}

/// Answer of the token endpoint.
#[derive(Default, Deserialize)]
struct Exchanged {
    id_token: Option<String>,
    error: Option<String>,
}

/// What the provider is told of the verifier (PKCE, S256).
pub(super) fn challenge(verifier: &str) -> String {
    URL_SAFE_NO_PAD.encode(Sha256::digest(verifier))
}
