//! A server of S3 in memory, on a port of this machine: one bucket, addressed by path, and as much of
//! the protocol as `object_store` uses. It looks whether a request is signed, and not how.
//!
//! It speaks HTTP itself, so that a test can end a connection wherever it wants.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use time::OffsetDateTime;
use time::format_description::well_known::{Rfc2822, Rfc3339};

/// The bucket.
pub const BUCKET: &str = "lab";
/// The key that may use it.
pub const KEY_ID: &str = "flip-of-the-tests";
/// The secret that belongs to the key. A test looks whether it is shown anywhere.
pub const SECRET: &str = "never-to-be-shown";
/// How many objects are listed in one answer: few, so that a test needs more than one.
const LISTED_MAX: usize = 3;

/// A running server; it ends with the process.
#[derive(Debug, Clone)]
pub struct S3 {
    address: SocketAddr,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    objects: BTreeMap<String, Object>,
    requests: Vec<String>,
    /// So many requests are answered with this status.
    refusals: (usize, u16),
    /// So many objects are stored, and the connection ends before that is said.
    hang_ups: usize,
}

#[derive(Debug, Clone)]
struct Object {
    bytes: Vec<u8>,
    written: OffsetDateTime,
}

struct Request {
    method: String,
    /// Without the bucket.
    key: String,
    query: BTreeMap<String, String>,
    is_signed: bool,
    body: Vec<u8>,
}

struct Answer {
    status: u16,
    headers: String,
    body: Vec<u8>,
    /// Of the body, which an answer to HEAD does not have.
    length: usize,
}

impl S3 {
    /// Start one.
    ///
    /// # Panics
    /// When no port is free.
    pub fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let made = Self { address: listener.local_addr().unwrap(), state: Arc::default() };
        let state = made.state.clone();
        std::thread::spawn(move || {
            for connection in listener.incoming().flatten() {
                let state = state.clone();
                // A client that leaves early is its own business.
                std::thread::spawn(move || serve(&connection, &state));
            }
        });
        made
    }

    /// The variables that lead to it.
    pub fn variables(&self) -> [(String, String); 3] {
        variables(&format!("http://{}", self.address))
    }

    /// Answer the next requests with this status.
    pub fn refuse(&self, times: usize, status: u16) {
        self.state().refusals = (times, status);
    }

    /// Store the next objects, and end the connection in place of an answer.
    pub fn hang_up(&self, times: usize) {
        self.state().hang_ups = times;
    }

    /// The keys of all objects, in order.
    pub fn keys(&self) -> Vec<String> {
        self.state().objects.keys().cloned().collect()
    }

    /// Put an object there, or other contents into one that is there.
    pub fn put(&self, key: &str, bytes: &[u8]) {
        self.state().put(key, bytes.to_vec());
    }

    /// Make all objects as old as this.
    pub fn age(&self, by: Duration) {
        let written = OffsetDateTime::now_utc() - by;
        self.state().objects.values_mut().for_each(|object| object.written = written);
    }

    /// Method and key of every request so far.
    pub fn requests(&self) -> Vec<String> {
        self.state().requests.clone()
    }

    fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }
}

/// The variables that lead to a server at an address where none need be.
pub fn variables(endpoint: &str) -> [(String, String); 3] {
    [("AWS_ENDPOINT", endpoint), ("AWS_ACCESS_KEY_ID", KEY_ID), ("AWS_SECRET_ACCESS_KEY", SECRET)]
        .map(|(name, value)| (name.to_owned(), value.to_owned()))
}

fn lock(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

/// One request and its answer; a connection is not used again.
fn serve(connection: &TcpStream, state: &Mutex<State>) -> Option<()> {
    let request = read(&mut BufReader::new(connection))?;
    let answer = lock(state).answer(request)?;
    let Answer { status, headers, body, length } = answer;
    let head = format!(
        "HTTP/1.1 {status} It\r\nconnection: close\r\ncontent-length: {length}\r\n{headers}\r\n"
    );
    let mut connection = connection;
    connection.write_all(head.as_bytes()).ok()?;
    connection.write_all(&body).ok()
}

fn read(from: &mut impl BufRead) -> Option<Request> {
    let mut line = || {
        let mut line = String::new();
        from.read_line(&mut line).ok()?;
        Some(line.trim_end().to_owned())
    };
    let first = line()?;
    let mut words = first.split(' ');
    let (method, target) = (words.next()?.to_owned(), words.next()?.to_owned());
    let (mut length, mut is_signed) = (0, false);
    loop {
        let header = line()?;
        let Some((name, value)) = header.split_once(": ") else { break };
        match name.to_ascii_lowercase().as_str() {
            "content-length" => length = value.parse().ok()?,
            "authorization" => {
                is_signed = value.starts_with("AWS4-HMAC-SHA256 ")
                    && value.contains(&format!("Credential={KEY_ID}/"))
                    && value.contains("Signature=");
            }
            _ => {}
        }
    }
    let mut body = vec![0; length];
    from.read_exact(&mut body).ok()?;
    let (path, query) = target.split_once('?').unwrap_or((&target, ""));
    let query = query
        .split('&')
        .filter_map(|it| it.split_once('='))
        .map(|(k, v)| (k.to_owned(), decoded(v)));
    let key = decoded(path.trim_start_matches('/'));
    Some(Request { method, key, query: query.collect(), is_signed, body })
}

impl State {
    fn put(&mut self, key: &str, bytes: Vec<u8>) {
        let written = OffsetDateTime::now_utc();
        self.objects.insert(key.to_owned(), Object { bytes, written });
    }

    /// `None`: the connection ends without one.
    fn answer(&mut self, request: Request) -> Option<Answer> {
        let Request { method, key, query, is_signed, body } = request;
        self.requests.push(format!("{method} {key}"));
        if self.refusals.0 > 0 {
            self.refusals.0 -= 1;
            return Some(refused(self.refusals.1, "SlowDown", "Come back later."));
        }
        if !is_signed {
            let said = "The key you provided does not exist in our records.";
            return Some(refused(403, "InvalidAccessKeyId", said));
        }
        let (bucket, key) = key.split_once('/').unwrap_or((&key, ""));
        if bucket != BUCKET {
            return Some(refused(404, "NoSuchBucket", "The bucket does not exist."));
        }
        match method.as_str() {
            "GET" if key.is_empty() => Some(self.list(&query)),
            "GET" | "HEAD" => match self.objects.get(key) {
                None => Some(refused(404, "NoSuchKey", "The key does not exist.")),
                Some(Object { bytes, written }) => {
                    let at = written.format(&Rfc2822).unwrap_or_default();
                    let headers = format!("last-modified: {at}\r\netag: \"{}\"\r\n", bytes.len());
                    let body = if method == "GET" { bytes.clone() } else { Vec::new() };
                    Some(Answer { status: 200, headers, body, length: bytes.len() })
                }
            },
            "PUT" => {
                let headers = format!("etag: \"{}\"\r\n", body.len());
                self.put(key, body);
                if self.hang_ups > 0 {
                    self.hang_ups -= 1;
                    return None;
                }
                Some(Answer { status: 200, headers, body: Vec::new(), length: 0 })
            }
            "DELETE" => {
                self.objects.remove(key);
                Some(Answer { status: 204, headers: String::new(), body: Vec::new(), length: 0 })
            }
            _ => Some(refused(405, "MethodNotAllowed", "Not here.")),
        }
    }

    /// The objects below a prefix, from where the last answer ended.
    fn list(&self, query: &BTreeMap<String, String>) -> Answer {
        let of = |name: &str| query.get(name).map_or("", String::as_str);
        let (prefix, after) = (of("prefix"), of("continuation-token"));
        let below = |(key, _): &(&String, &Object)| key.starts_with(prefix) && key.as_str() > after;
        let mut found: Vec<_> = self.objects.iter().filter(below).take(LISTED_MAX + 1).collect();
        let is_truncated = found.len() > LISTED_MAX;
        found.truncate(LISTED_MAX);
        let next = found
            .last()
            .filter(|_| is_truncated)
            .map(|(key, _)| format!("<NextContinuationToken>{key}</NextContinuationToken>"));
        let contents: String = found
            .iter()
            .map(|(key, Object { bytes, written })| {
                format!(
                    "<Contents><Key>{key}</Key><LastModified>{}</LastModified><ETag>\"{1}\"</ETag><Size>{1}</Size></Contents>",
                    written.format(&Rfc3339).unwrap_or_default(),
                    bytes.len()
                )
            })
            .collect();
        page(
            200,
            &format!("<ListBucketResult>{contents}{}</ListBucketResult>", next.unwrap_or_default()),
        )
    }
}

fn refused(status: u16, code: &str, message: &str) -> Answer {
    page(status, &format!("<Error><Code>{code}</Code><Message>{message}</Message></Error>"))
}

fn page(status: u16, xml: &str) -> Answer {
    let body = format!("<?xml version=\"1.0\" encoding=\"UTF-8\"?>{xml}").into_bytes();
    let length = body.len();
    Answer { status, headers: "content-type: application/xml\r\n".to_owned(), body, length }
}

/// Without its percent signs.
fn decoded(text: &str) -> String {
    let (mut bytes, mut rest) = (Vec::new(), text.as_bytes());
    while let [first, after @ ..] = rest {
        let digits = after.get(..2).and_then(|it| std::str::from_utf8(it).ok());
        match digits.and_then(|it| u8::from_str_radix(it, 16).ok()).filter(|_| *first == b'%') {
            Some(byte) => {
                bytes.push(byte);
                rest = &after[2..];
            }
            None => {
                bytes.push(*first);
                rest = after;
            }
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}
