//! Artifacts in a bucket of S3, or of a server that speaks as S3 does.

use super::{Found, is_sha256};
use crate::{Error, Result};
use futures::TryStreamExt;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::client::{HttpError, HttpErrorKind};
use object_store::path::Path as Key;
use object_store::prefix::PrefixStore;
use object_store::{
    BackoffConfig, ClientOptions, Error as ObjectError, ObjectStore, ObjectStoreExt, RetryConfig,
};
use std::io;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

/// Longest text of a server that is shown, characters.
const SAID_MAX: usize = 200;

/// How long a bucket that does not answer is waited for.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Patience {
    /// After this, nothing is tried again.
    pub retry: Duration,
    /// For a connection.
    pub connect: Duration,
    /// For one request with its answer: an artifact of some megabytes over a slow line.
    pub request: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        let seconds = Duration::from_secs;
        Self { retry: seconds(15), connect: seconds(5), request: seconds(60) }
    }
}

/// A bucket, or what is below a prefix in it.
#[derive(Clone)]
pub(super) struct Bucket {
    objects: Arc<dyn ObjectStore>,
    /// Its address, without keys.
    name: String,
    has_key: bool,
}

impl Bucket {
    /// Described by variables as Amazon's own programs read them; nothing is asked yet.
    pub fn new(
        bucket: &str,
        prefix: Key,
        variables: impl Iterator<Item = (String, String)>,
        patience: Patience,
    ) -> Result<Self> {
        // reqwest panics without one. A second call changes nothing.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let options = ClientOptions::new()
            .with_connect_timeout(patience.connect)
            .with_timeout(patience.request);
        let backoff = BackoffConfig { max_backoff: Duration::from_secs(3), ..Default::default() };
        let mut builder = AmazonS3Builder::new()
            .with_client_options(options)
            .with_retry(RetryConfig { backoff, max_retries: 10, retry_timeout: patience.retry })
            // At most a hundred at a time, and not every server has the request for many.
            .with_config(AmazonS3ConfigKey::DisableBulkDelete, "true");
        for (name, value) in variables.filter(|(name, _)| name.starts_with("AWS_")) {
            if let Ok(key) = name.to_ascii_lowercase().parse::<AmazonS3ConfigKey>() {
                builder = builder.with_config(key, value);
            }
        }
        let endpoint = builder.get_config_value(&AmazonS3ConfigKey::S3Endpoint);
        let endpoint = endpoint.or_else(|| builder.get_config_value(&AmazonS3ConfigKey::Endpoint));
        if endpoint.is_some_and(|it| it.starts_with("http://")) {
            builder = builder.with_allow_http(true);
        }
        let has_key = builder.get_config_value(&AmazonS3ConfigKey::AccessKeyId).is_some();
        let name = format!("s3://{bucket}/{prefix}").trim_end_matches('/').to_owned();
        let built = builder.with_bucket_name(bucket).build();
        let built =
            built.map_err(|error| Error::Artifacts { at: name.clone(), why: why(&error) })?;
        Ok(Self { objects: Arc::new(PrefixStore::new(built, prefix)), name, has_key })
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    pub fn objects(&self) -> Arc<dyn ObjectStore> {
        self.objects.clone()
    }

    /// Our objects, recognised by their names.
    pub async fn files(&self) -> Result<Vec<Found>> {
        let listed: Vec<_> =
            self.objects.list(None).try_collect().await.map_err(|error| self.failed("", &error))?;
        let found = listed.into_iter().filter_map(|it| {
            let (folder, name) = it.location.as_ref().split_once('/')?;
            if !is_sha256(name) || folder != &name[..2] {
                return None;
            }
            let written = SystemTime::from(it.last_modified);
            Some(Found {
                name: name.to_owned(),
                at: it.location.to_string(),
                age: written.elapsed().ok(),
            })
        });
        Ok(found.collect())
    }

    /// Remove one; it may be gone already.
    pub async fn remove(&self, at: &str) -> Result<()> {
        match self.objects.delete(&Key::from(at)).await {
            Ok(()) | Err(ObjectError::NotFound { .. }) => Ok(()),
            Err(error) => Err(self.failed(at, &error)),
        }
    }

    /// What the server said, or that it did not. `key`: of the object, empty for the bucket.
    pub fn failed(&self, key: &str, error: &ObjectError) -> Error {
        let (at, said, status) = (self.name.clone(), why(error), status(error));
        let refused = |advice: &str| Error::Artifacts {
            at: self.name.clone(),
            why: format!("{said}: {advice}"),
        };
        match status {
            // The words of S3: a server in between that knows nothing of it says 404, too.
            Some(404) if said.contains("NoSuchKey") => {
                let source = io::Error::new(io::ErrorKind::NotFound, "there is no such object");
                Error::File { path: format!("{at}/{key}").into(), source }
            }
            Some(404) if said.contains("NoSuchBucket") => refused("make the bucket first"),
            Some(404) => refused("is AWS_ENDPOINT the address of a server of S3?"),
            Some(401 | 403) => refused(
                "check AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION and what this key may do",
            ),
            _ if !self.has_key => refused(
                "AWS_ACCESS_KEY_ID is not set, and this machine has no role of its own that could be used",
            ),
            Some(429 | 500..) => Error::ArtifactsAway { at, why: said },
            None if is_away(error) => Error::ArtifactsAway { at, why: said },
            _ => Error::Artifacts { at, why: said },
        }
    }
}

/// The status of the answer, if there was one.
fn status(error: &ObjectError) -> Option<u16> {
    match error {
        ObjectError::NotFound { .. } => Some(404),
        ObjectError::PermissionDenied { .. } => Some(403),
        ObjectError::Unauthenticated { .. } => Some(401),
        // Only in its text.
        _ => {
            let said = error.to_string();
            let (_, rest) = said.split_once("status code: ")?;
            rest.get(..3)?.parse().ok()
        }
    }
}

/// Whether it may be back soon: no connection, or no answer in time.
fn is_away(error: &ObjectError) -> bool {
    let mut at: Option<&(dyn std::error::Error + 'static)> = Some(error);
    while let Some(inner) = at {
        if let Some(http) = inner.downcast_ref::<HttpError>() {
            return !matches!(http.kind(), HttpErrorKind::Unknown | HttpErrorKind::Decode);
        }
        at = inner.source();
    }
    false
}

/// The cause, as short as it can be told: S3 answers with a page that repeats the request.
fn why(error: &ObjectError) -> String {
    let mut last: &dyn std::error::Error = error;
    while let Some(inner) = last.source() {
        last = inner;
    }
    let said = last.to_string();
    let part = |name: &str| {
        let (_, rest) = said.split_once(&format!("<{name}>"))?;
        Some(rest.split_once(&format!("</{name}>"))?.0.to_owned())
    };
    match (part("Code"), part("Message")) {
        (Some(code), Some(message)) => format!("{code}, {message}"),
        (Some(code), None) => code,
        _ => said.lines().next().unwrap_or_default().chars().take(SAID_MAX).collect(),
    }
}
