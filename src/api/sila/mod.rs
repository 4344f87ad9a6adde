//! SiLA 2, the standard of laboratory automation: one file per feature of `proto/sila`, each method
//! one call of the application.
//!
//! The UUID of a command's execution is the id of the weighing or job that it began. Both are
//! stored before anything moves or computes, so an execution outlives its connection and this
//! process: its state and its result are looked up ([`execution`]), never remembered.
//!
//! A request passes, from the outside in: the front end's connections (an instance of its own, so
//! that schedulers and people do not wait for each other), [`super::edge`], [`identity`] (on whose
//! behalf), its feature. Errors of the standard are in [`error`], who may call what in
//! [`feature`].

mod announce;
mod audience;
mod balance;
mod bench;
mod binary;
mod calibration;
mod cancel;
mod certificate;
mod discovery;
mod door;
mod error;
mod execution;
mod feature;
mod identity;
mod lock;
mod login;
mod nameplate;
mod repose;
mod service;
mod value;
mod weighing;

pub use door::{Bound, SilaConfig, bind};

use crate::app::{App, LabelWanted, Labels, Role};
use audience::Audience;
use binary::Binaries;
use error::{may, may_clear};
use identity::Sessions;
use lock::Lock;
use nameplate::NamePlate;
use std::sync::Arc;
use tonic::{Request, Status};

/// Messages, servers and clients, generated from `proto/sila`: a module for each package.
#[expect(missing_docs, reason = "generated; the feature definitions have the descriptions")]
#[allow(non_camel_case_types, reason = "generated; the standard names calls with underscores")]
pub mod proto {
    tonic::include_proto!("sila");
}

/// Types of the standard.
use proto::sila2::org::silastandard as standard;

/// Implements all features; cheap to clone.
#[derive(Clone)]
struct Sila {
    app: App,
    plate: Arc<NamePlate>,
    sessions: Arc<Sessions>,
    binaries: Arc<Binaries>,
    audience: Arc<Audience>,
    /// `None` unless the server can be locked.
    lock: Option<Arc<Lock>>,
    /// Features and commands that need an access token.
    guarded: Arc<[String]>,
}

/// What tells executions of this interface from what others began.
fn begun_here() -> LabelWanted {
    LabelWanted { key: "interface".to_owned(), value: "sila".to_owned() }
}

/// Labels of what is begun here.
fn of_sila() -> Labels {
    let LabelWanted { key, value } = begun_here();
    Labels([(key, value)].into())
}

/// The message, if the caller may read.
fn read<T>(request: Request<T>) -> Result<T, Status> {
    may(request.extensions(), Role::Viewer)?;
    Ok(request.into_inner())
}

/// The message, if the caller may start, stop and add things.
fn operate<T>(request: Request<T>) -> Result<T, Status> {
    may(request.extensions(), Role::Operator)?;
    Ok(request.into_inner())
}

/// The message, if the caller may clear a latched bench.
fn clear<T>(request: Request<T>) -> Result<T, Status> {
    may_clear(request.extensions())?;
    Ok(request.into_inner())
}
