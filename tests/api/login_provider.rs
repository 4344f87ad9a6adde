//! A small provider of log-ins on a real socket: everything that OpenID Connect asks of one, and the
//! mistakes that a test asks for.

use axum::extract::{Query, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::{get, post};
use axum::{Form, Json, Router};
use base64::Engine;
use base64::engine::general_purpose::{STANDARD, URL_SAFE_NO_PAD};
use flip::app::{Oidc, OidcSettings, Role};
use ring::rand::SystemRandom;
use ring::signature::{ECDSA_P256_SHA256_FIXED_SIGNING, EcdsaKeyPair, KeyPair};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};
use tokio::net::TcpListener;

/// Where the page of the service is for browsers; nothing is asked there.
pub const PAGE: &str = "http://127.0.0.1:1/";
const CLIENT: &str = "flip id";
const SECRET: &str = "a secret: 100 %";

type Change = Box<dyn Fn(&mut Value) + Send>;

/// A provider where Ada is always logged in.
#[derive(Clone)]
pub struct Provider {
    pub issuer: String,
    inner: Arc<Inner>,
}

struct Inner {
    key: EcdsaKeyPair,
    other_key: EcdsaKeyPair,
    desk: Mutex<Desk>,
}

#[derive(Default)]
struct Desk {
    /// Codes given and not yet exchanged: nonce and challenge.
    codes: HashMap<String, (String, String)>,
    given: usize,
    /// What is changed in the claims of the next tokens.
    change: Option<Change>,
    /// Whether tokens are signed with a key that is not published.
    forges: bool,
}

fn new_key() -> EcdsaKeyPair {
    let (random, of) = (SystemRandom::new(), &ECDSA_P256_SHA256_FIXED_SIGNING);
    let pkcs8 = EcdsaKeyPair::generate_pkcs8(of, &random).unwrap();
    EcdsaKeyPair::from_pkcs8(of, pkcs8.as_ref(), &random).unwrap()
}

fn text(bytes: impl AsRef<[u8]>) -> String {
    URL_SAFE_NO_PAD.encode(bytes)
}

/// What FLIP is told of the provider with this issuer.
pub fn settings(issuer: &str) -> Oidc {
    Oidc::new(OidcSettings {
        issuer: issuer.to_owned(),
        client_id: CLIENT.to_owned(),
        client_secret: SECRET.to_owned(),
        redirect_url: PAGE.to_owned(),
        scopes: "openid profile".to_owned(),
        role_claim: "groups".to_owned(),
        roles: [(Role::Viewer, "staff"), (Role::Operator, "balance"), (Role::Admin, "it")]
            .map(|(role, group)| (role, group.to_owned()))
            .into(),
    })
    .unwrap()
}

impl Provider {
    pub async fn start() -> Self {
        Self::start_at("127.0.0.1:0".parse().unwrap()).await
    }

    pub async fn start_at(address: SocketAddr) -> Self {
        let listener = TcpListener::bind(address).await.unwrap();
        let issuer = format!("http://{}", listener.local_addr().unwrap());
        let inner = Inner { key: new_key(), other_key: new_key(), desk: Mutex::default() };
        let provider = Self { issuer, inner: Arc::new(inner) };
        let router = Router::new()
            .route("/.well-known/openid-configuration", get(discovery))
            .route("/jwks", get(jwks))
            .route("/authorize", get(authorize))
            .route("/token", post(token))
            .with_state(provider.clone());
        tokio::spawn(async move { axum::serve(listener, router).await.unwrap() });
        provider
    }

    /// From now on tokens say this instead.
    pub fn says(&self, change: impl Fn(&mut Value) + Send + 'static) {
        self.desk().change = Some(Box::new(change));
    }

    pub fn forges(&self) {
        self.desk().forges = true;
    }

    fn desk(&self) -> std::sync::MutexGuard<'_, Desk> {
        self.inner.desk.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn id_token(&self, nonce: &str) -> String {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs();
        let mut claims = json!({ "iss": self.issuer, "aud": CLIENT, "sub": "person-17", "nonce": nonce,
            "name": "Ada", "groups": ["staff", "balance"], "iat": now, "exp": now + 300 });
        let desk = self.desk();
        if let Some(change) = &desk.change {
            change(&mut claims);
        }
        let header = json!({ "alg": "ES256", "kid": "first" });
        let said = format!("{}.{}", text(header.to_string()), text(claims.to_string()));
        let key = if desk.forges { &self.inner.other_key } else { &self.inner.key };
        let signature = key.sign(&SystemRandom::new(), said.as_bytes()).unwrap();
        format!("{said}.{}", text(signature.as_ref()))
    }
}

async fn discovery(State(provider): State<Provider>) -> Json<Value> {
    let issuer = &provider.issuer;
    Json(
        json!({ "issuer": issuer, "authorization_endpoint": format!("{issuer}/authorize?ui=plain"),
        "token_endpoint": format!("{issuer}/token"), "jwks_uri": format!("{issuer}/jwks") }),
    )
}

async fn jwks(State(provider): State<Provider>) -> Json<Value> {
    let (x, y) = provider.inner.key.public_key().as_ref()[1..].split_at(32);
    Json(json!({ "keys": [{ "kty": "odd" },
        { "kty": "EC", "crv": "P-256", "use": "sig", "alg": "ES256", "kid": "first", "x": text(x), "y": text(y) }] }))
}

type Fields = HashMap<String, String>;

async fn authorize(State(provider): State<Provider>, Query(asked): Query<Fields>) -> Redirect {
    assert_eq!(asked["response_type"], "code");
    assert_eq!(asked["client_id"], CLIENT);
    assert_eq!(asked["redirect_uri"], PAGE, "a provider refuses any other");
    assert_eq!(asked["code_challenge_method"], "S256");
    assert_eq!(asked["ui"], "plain", "its own query stays");
    let mut desk = provider.desk();
    desk.given += 1;
    let code = format!("code-{}", desk.given);
    let kept = (asked["nonce"].clone(), asked["code_challenge"].clone());
    desk.codes.insert(code.clone(), kept);
    Redirect::to(&format!("{PAGE}?code={code}&state={}", asked["state"]))
}

async fn token(
    State(provider): State<Provider>,
    headers: HeaderMap,
    Form(asked): Form<Fields>,
) -> Response {
    let refuse =
        |error: &str| (StatusCode::BAD_REQUEST, Json(json!({ "error": error }))).into_response();
    // Id and secret are encoded as in a form before they are joined (RFC 6749, 2.3.1).
    let basic = format!("Basic {}", STANDARD.encode("flip+id:a+secret%3A+100+%25"));
    if headers.get("authorization").and_then(|it| it.to_str().ok()) != Some(&basic) {
        return refuse("invalid_client");
    }
    if asked["grant_type"] != "authorization_code" || asked["redirect_uri"] != PAGE {
        return refuse("invalid_request");
    }
    let kept = provider.desk().codes.remove(&asked["code"]);
    let Some((nonce, challenge)) = kept else { return refuse("invalid_grant") };
    if text(Sha256::digest(&asked["code_verifier"])) != challenge {
        return refuse("invalid_grant");
    }
    Json(json!({ "id_token": provider.id_token(&nonce), "token_type": "Bearer", "access_token": "x" }))
        .into_response()
}
