//! A running `flip serve`, asked over REST: what `--server` names.
//!
//! A request that would pour has one key, whatever happens to its answers, and is sent again only
//! under that key. A request that changes something and has none is sent once.

mod address;
mod leaving;
mod refusal;
mod request;

pub(super) use address::Address;
pub(super) use request::{Answer, Request};

use super::failure::Failure;
use crate::app::{self, Error, Job, Page, PageQuery, Weighing, agent};
use crate::telemetry;
use flip_core::domain::FieldError;
use leaving::Underway;
use refusal::refusal;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use ureq::Agent;
use ureq::http::{HeaderMap, header};

/// Environment variable with the token.
const VARIABLE: &str = "FLIP_TOKEN";
/// Longest time to connect.
const CONNECT: Duration = Duration::from_secs(10);
/// Longest time for a whole answer; [`Request`] says how long one may be silent.
const ANSWER: Duration = Duration::from_secs(24 * 3600);
/// How often a request is sent again that may be.
const TRIES: u32 = 6;
/// First pause before the next try; each further one is twice as long.
const PAUSE: Duration = Duration::from_millis(200);
const PAUSE_MAX: Duration = Duration::from_secs(5);
/// Longest pause that a server may ask for.
const RETRY_AFTER_MAX_S: u64 = 60;
/// Statuses worth another try: it is too early, too much, or a proxy speaks.
const RETRIED: [u16; 6] = [408, 425, 429, 502, 503, 504];

/// A server, and what this command has begun there. Cheap to clone.
#[derive(Clone)]
pub(super) struct Server {
    inner: Arc<Inner>,
}

struct Inner {
    address: Address,
    token: Option<String>,
    agent: Agent,
    /// Whether it has answered this command: then it is worth waiting for.
    has_answered: AtomicBool,
    /// Locked while something is being begun, so that whoever leaves learns its id.
    underway: Mutex<Vec<Underway>>,
}

/// Why there is no answer.
struct Silence {
    error: ureq::Error,
    /// Whether the server may have got the request.
    may_have_arrived: bool,
}

impl Server {
    /// The server at an address, with the token of `token_file`, or of the environment.
    ///
    /// # Errors
    /// A token file that cannot be read, or a token that cannot be sent.
    pub(super) fn at(address: &Address, token_file: Option<&Path>) -> Result<Self, Failure> {
        let token = token(token_file)?;
        if token.is_some() && address.is_open() {
            telemetry::say(format_args!(
                "flip: the token goes to {address} over plain HTTP, where others on the network can read it; https:// hides it"
            ));
        }
        let inner = Inner {
            address: address.clone(),
            token,
            agent: agent(ANSWER),
            has_answered: AtomicBool::new(false),
            underway: Mutex::default(),
        };
        Ok(Self { inner: Arc::new(inner) })
    }

    /// The JSON at a path below `/v1`.
    pub(super) async fn get<T: DeserializeOwned>(&self, path: &[&str]) -> app::Result<T> {
        self.ask(Request::get(path)).await
    }

    /// The JSON that answers a request.
    pub(super) async fn ask<T: DeserializeOwned>(&self, request: Request) -> app::Result<T> {
        self.answer(request).await?.json()
    }

    /// Posts JSON, once.
    pub(super) async fn post<T: DeserializeOwned>(
        &self,
        path: &[&str],
        body: &impl Serialize,
    ) -> app::Result<T> {
        self.ask(Request::post(path, body)?).await
    }

    /// The answer to a request.
    pub(super) async fn answer(&self, request: Request) -> app::Result<Answer> {
        self.blocking(move |server| server.send(&request)).await
    }

    /// The answer to a request, also that what it is about is missing (404) or lost (410).
    pub(super) async fn found_or_not(&self, request: Request) -> app::Result<Answer> {
        self.blocking(move |server| {
            let (answer, headers) = server.exchange(&request)?;
            match answer.status {
                404 | 410 => Ok(answer),
                _ => server.checked(answer, &headers),
            }
        })
        .await
    }

    /// All items of a list.
    pub(super) async fn all<T: DeserializeOwned>(&self, list: Request) -> app::Result<Vec<T>> {
        let (mut items, mut after) = (Vec::new(), None);
        loop {
            let page = PageQuery { after, ..super::FIRST_PAGE };
            let found: Page<T> = self.ask(list.clone().page(&page)).await?;
            items.extend(found.items);
            after = found.next;
            if after.is_none() {
                return Ok(items);
            }
        }
    }

    /// Begins a job; `true` if it is new.
    pub(super) async fn start(&self, request: Request) -> app::Result<(Job, bool)> {
        self.begin(request, |answer| {
            let job: Job = answer.json()?;
            let underway = vec![Underway::job(&job.id)];
            Ok(((job, answer.status == 202), underway))
        })
        .await
    }

    /// Begins a dose, under a key.
    pub(super) async fn dose(&self, request: Request) -> app::Result<Weighing> {
        self.begin(request, |answer| {
            let weighing: Weighing = answer.json()?;
            let underway = vec![Underway::dose(&weighing.id)];
            Ok((weighing, underway))
        })
        .await
    }

    /// Sends what begins something, and notes what it is.
    async fn begin<T: Send + 'static>(
        &self,
        request: Request,
        read: impl FnOnce(&Answer) -> app::Result<(T, Vec<Underway>)> + Send + 'static,
    ) -> app::Result<T> {
        self.blocking(move |server| {
            let mut underway = server.underway();
            let begun = server.send(&request).and_then(|answer| read(&answer));
            let (begun, new) =
                begun.inspect_err(|error| underway.extend(Underway::unsure(error)))?;
            underway.extend(new);
            Ok(begun)
        })
        .await
    }

    async fn blocking<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Inner) -> app::Result<T> + Send + 'static,
    ) -> app::Result<T> {
        let inner = self.inner.clone();
        let done = tokio::task::spawn_blocking(move || work(&inner)).await;
        done.map_err(|error| Error::Internal(error.into()))?
    }
}

impl Inner {
    fn underway(&self) -> MutexGuard<'_, Vec<Underway>> {
        self.underway.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The answer to a request, unless it is a refusal.
    fn send(&self, request: &Request) -> app::Result<Answer> {
        let (answer, headers) = self.exchange(request)?;
        self.checked(answer, &headers)
    }

    /// Sends a request, again if that changes nothing and the server may answer then.
    fn exchange(&self, request: &Request) -> app::Result<(Answer, HeaderMap)> {
        let (mut tried, mut may_have_arrived) = (0, false);
        loop {
            let is_last = tried == TRIES || !request.repeatable;
            let pause = match self.send_once(request) {
                Ok((answer, headers)) if is_last || !RETRIED.contains(&answer.status) => {
                    return Ok((answer, headers));
                }
                Ok((_, headers)) => {
                    may_have_arrived = true;
                    asked_for(&headers).unwrap_or_else(|| pause(tried))
                }
                Err(silence) => {
                    may_have_arrived |= silence.may_have_arrived;
                    let is_met = self.has_answered.load(Ordering::Relaxed) || may_have_arrived;
                    if is_last || !is_met {
                        return Err(self.silent(request, &silence.error, may_have_arrived));
                    }
                    pause(tried)
                }
            };
            std::thread::sleep(pause);
            tried += 1;
        }
    }

    /// Sends a request, whatever the status of its answer.
    fn send_once(&self, request: &Request) -> Result<(Answer, HeaderMap), Silence> {
        let broken = |error: ureq::Error| Silence { may_have_arrived: has_left(&error), error };
        let mut head = ureq::http::Request::builder()
            .method(request.method.clone())
            .uri(format!("{}{}", self.address, request.path));
        if let Some(token) = &self.token {
            head = head.header(header::AUTHORIZATION, format!("Bearer {token}"));
        }
        if let Some(key) = &request.key {
            head = head.header("idempotency-key", key);
        }
        let answered = match request.body.clone() {
            Some(body) => {
                let head = head.header(header::CONTENT_TYPE, request.content_type).body(body);
                self.run(request, head.map_err(|error| broken(error.into()))?)
            }
            None => self.run(request, head.body(()).map_err(|error| broken(error.into()))?),
        };
        let response = answered.map_err(broken)?;
        self.has_answered.store(true, Ordering::Relaxed);
        let (head, body) = response.into_parts();
        let body = body.into_with_config().limit(u64::MAX).read_to_vec().map_err(broken)?;
        let is_replayed = head.headers.contains_key("idempotency-replayed");
        Ok((Answer { status: head.status.as_u16(), is_replayed, body }, head.headers))
    }

    fn run(
        &self,
        request: &Request,
        whole: ureq::http::Request<impl ureq::AsSendBody>,
    ) -> Result<ureq::http::Response<ureq::Body>, ureq::Error> {
        let whole = self
            .agent
            .configure_request(whole)
            .timeout_connect(Some(CONNECT))
            .timeout_per_read(Some(request.patience))
            .build();
        self.agent.run(whole)
    }

    /// The answer, unless it is a refusal.
    fn checked(&self, answer: Answer, headers: &HeaderMap) -> app::Result<Answer> {
        let url = self.address.to_string();
        match answer.status {
            200..300 => Ok(answer),
            300..400 => {
                let place = headers.get(header::LOCATION).and_then(|it| it.to_str().ok());
                let place = place.map_or_else(String::new, |it| format!(" ({it})"));
                let advice = "name the new address with --server";
                Err(Error::Unavailable(format!("{url} points to another address{place}: {advice}")))
            }
            status => Err(refusal(&url, status, &answer.body)),
        }
    }

    /// The error of a server that does not answer: what to check, and what may have happened.
    fn silent(&self, request: &Request, error: &ureq::Error, may_have_arrived: bool) -> Error {
        let url = &self.address;
        let advice = match request.key.is_some() {
            _ if !may_have_arrived => {
                "check that `flip serve` runs there, the address, its port, and http or https"
            }
            true => {
                "it may have taken the dose: look at the page or at `flip bench status` before you weigh again"
            }
            false if request.method == ureq::http::Method::GET => "what was begun there goes on",
            false => "it may have done what was asked: look before you ask again",
        };
        Error::Unavailable(format!("{url} does not answer ({error}): {advice}"))
    }
}

/// Whether a request may have reached the server before it failed.
fn has_left(error: &ureq::Error) -> bool {
    use ureq::Timeout::{Connect, Resolve};
    match error {
        ureq::Error::Io(error) => error.kind() != std::io::ErrorKind::ConnectionRefused,
        ureq::Error::Timeout(Connect | Resolve)
        | ureq::Error::HostNotFound
        | ureq::Error::ConnectionFailed
        | ureq::Error::Tls(_)
        | ureq::Error::Rustls(_)
        | ureq::Error::Http(_)
        | ureq::Error::BadUri(_) => false,
        _ => true,
    }
}

/// The pause that a server asks for.
fn asked_for(headers: &HeaderMap) -> Option<Duration> {
    let seconds: u64 = headers.get(header::RETRY_AFTER)?.to_str().ok()?.parse().ok()?;
    Some(Duration::from_secs(seconds.min(RETRY_AFTER_MAX_S)))
}

fn pause(tried: u32) -> Duration {
    (PAUSE * 2_u32.saturating_pow(tried)).min(PAUSE_MAX)
}

/// The token, from the file or from the environment: on the command line other users would see it.
fn token(file: Option<&Path>) -> Result<Option<String>, Failure> {
    let (field, text) = match file {
        Some(file) => {
            let text = std::fs::read_to_string(file).map_err(|error| {
                FieldError::new("token_file", format!("{} cannot be read: {error}", file.display()))
            })?;
            ("token_file", Some(text))
        }
        None => (VARIABLE, std::env::var(VARIABLE).ok()),
    };
    let token = text.map(|text| text.trim().to_owned()).filter(|token| !token.is_empty());
    match token {
        Some(token) if !token.bytes().all(|byte| byte.is_ascii_graphic()) => {
            Err(FieldError::new(field, "must hold a token alone, as `flip token create` prints it")
                .into())
        }
        token => Ok(token),
    }
}
