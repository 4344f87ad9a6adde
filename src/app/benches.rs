//! The benches of a database: which there are, what is in whose container, and which of them a
//! weighing goes to.

use super::bench::BenchStatus;
use super::bench_requests::{BenchAsk, asks};
use super::check::Check;
use super::{App, Error, Result, WeighingRequest};
use flip_core::domain::FieldError;
use flip_core::domain::bench_check::CheckKind;
use flip_store::benches::{BenchRow, Loaded};
use flip_store::weighings::Weighing;
use flip_store::{Store, now};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What a request names to be sent to any bench that holds its powder.
pub const ANY_BENCH: &str = "any";
/// Longest name of a bench, characters.
const NAME_MAX: usize = 100;

/// What a bench's container holds from now on.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoadRequest {
    /// Powder id; absent: the container is empty.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub powder: Option<String>,
    /// Its lot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lot: Option<String>,
}

/// Checks the name of a bench that a process is to have.
///
/// # Errors
/// [`FieldError`]
pub fn check_bench_name(name: &str) -> std::result::Result<(), FieldError> {
    let is_plain = |b: u8| b.is_ascii_alphanumeric() || b"-_.".contains(&b);
    match (1..=NAME_MAX).contains(&name.len()) && name.bytes().all(is_plain) && name != ANY_BENCH {
        true => Ok(()),
        false => Err(FieldError::new(
            "bench_name",
            format!(
                "must be 1 to {NAME_MAX} letters, digits, `-`, `_` or `.`, and not `{ANY_BENCH}`, got `{name}`"
            ),
        )),
    }
}

impl App {
    /// All benches, by name.
    ///
    /// # Errors
    /// `Internal`
    pub async fn benches(&self) -> Result<Vec<BenchRow>> {
        let mut benches = self.store().benches().await?;
        let Some(jobs) = self.inner.jobs.as_ref() else { return Ok(benches) };
        let ours = jobs.bench();
        for row in benches.iter_mut().filter(|row| row.name == self.store().bench_name()) {
            let standing = ours.standing();
            (row.kind, row.served) = (Some(ours.kind()), ours.works());
            row.latch = standing.latch.map(|latch| latch.reason);
            row.held = standing.held.map(|held| held.reason);
            row.moving = standing.moving;
        }
        Ok(benches)
    }

    /// The store that speaks for another bench; `None`: it is this process's own.
    ///
    /// # Errors
    /// `NotFound`
    pub(super) async fn elsewhere(&self, name: &str) -> Result<Option<Store>> {
        if name == self.store().bench_name() && self.inner.jobs.is_some() {
            return Ok(None);
        }
        let there = self.store().at_bench(name).await?;
        there.map(Some).ok_or_else(|| Error::not_found("bench", name))
    }

    /// The state of a bench; of another process's from what is stored.
    ///
    /// # Errors
    /// `NotFound`
    pub async fn bench_named(&self, name: &str) -> Result<BenchStatus> {
        match self.elsewhere(name).await? {
            None => self.bench().await,
            Some(there) => stored_status(&there).await,
        }
    }

    /// Says what a bench's container holds, until it is said again.
    ///
    /// # Errors
    /// `Invalid`; `NotFound`.
    pub async fn load_bench(&self, name: &str, request: LoadRequest) -> Result<BenchRow> {
        let mut check = Check::default();
        request.lot.iter().for_each(|lot| check.text("lot", lot, 200));
        if request.powder.is_none() && request.lot.is_some() {
            check.refuse("lot", "needs `powder`: name it too, or leave both out".to_owned());
        }
        check.done()?;
        let loaded = match &request.powder {
            Some(powder) => {
                let powder = self.powder_of("powder", powder).await?.id;
                Some(Loaded { powder, lot: request.lot, at: now() })
            }
            None => None,
        };
        let there = self.elsewhere(name).await?;
        let store = there.as_ref().unwrap_or(self.store());
        let mut tx = store.write().await?;
        tx.load_bench(loaded.as_ref(), now()).await?;
        tx.commit().await?;
        let benches = self.benches().await?;
        benches
            .into_iter()
            .find(|it| it.name == name)
            .ok_or_else(|| Error::not_found("bench", name))
    }

    /// Sends a weighing to the bench that it names, where that is another process's; otherwise
    /// returns it.
    pub(super) async fn send_weighing(
        &self,
        request: WeighingRequest,
        key: &str,
    ) -> Result<std::result::Result<(Weighing, bool), WeighingRequest>> {
        let Some(name) = &request.bench_name else { return Ok(Err(request)) };
        let name = match name.as_str() {
            ANY_BENCH => self.free_bench(&request).await?,
            name => name.to_owned(),
        };
        let unknown = |error| match error {
            Error::NotFound { .. } => {
                let advice = format!("there is no bench `{name}`: GET /v1/benches lists them");
                FieldError::new("bench_name", advice).into()
            }
            error => error,
        };
        match self.elsewhere(&name).await.map_err(unknown)? {
            None => Ok(Err(request)),
            Some(there) => {
                let ask = BenchAsk::Weigh { request: Box::new(request), key: key.to_owned() };
                self.ask(&there, ask).await.and_then(asks::read).map(Ok)
            }
        }
    }

    /// The bench for a weighing that asks for any: of those that hold its powder and can begin, the
    /// one for which the fewest wait, and this process's own rather than another.
    async fn free_bench(&self, request: &WeighingRequest) -> Result<String> {
        let (benches, ours) = (self.benches().await?, self.store().bench_name());
        let lot = request.asked.lot.as_deref();
        let has = |row: &&BenchRow| {
            row.holds.as_ref().is_some_and(|holds| {
                let same = lot.is_none_or(|lot| holds.lot.as_deref() == Some(lot));
                holds.powder == request.powder && same
            })
        };
        let begins = |row: &&BenchRow| row.served && row.latch.is_none() && row.held.is_none();
        let first =
            benches.iter().filter(has).filter(begins).min_by_key(|row| {
                (row.waiting + u32::from(row.moving.is_some()), row.name != ours)
            });
        first.map(|row| row.name.clone()).ok_or_else(|| {
            let wanted = match lot {
                Some(lot) => format!("`{}` of lot `{lot}`", request.powder),
                None => format!("`{}`", request.powder),
            };
            let all: Vec<String> = benches.iter().map(told).collect();
            let advice = format!(
                "no bench that can begin holds {wanted}: {}. Say what is in a container with `flip bench load`, or name a bench",
                all.join("; ")
            );
            Error::conflict("powder_not_loaded", advice)
        })
    }
}

/// A bench in one line.
fn told(row: &BenchRow) -> String {
    let holds = match &row.holds {
        Some(Loaded { powder, lot: Some(lot), .. }) => format!("holds `{powder}` of lot `{lot}`"),
        Some(Loaded { powder, .. }) => format!("holds `{powder}`"),
        None => "holds nothing that was said".to_owned(),
    };
    let why = match (&row.latch, &row.held) {
        _ if !row.served => ", is not served",
        (Some(_), _) => ", is latched",
        (_, Some(_)) => ", is held",
        _ => "",
    };
    format!("`{}` {holds}{why}", row.name)
}

/// The state of a bench as it is stored.
pub(super) async fn stored_status(store: &Store) -> Result<BenchStatus> {
    let moving = store.interrupted_weighings().await?.into_iter().next();
    let row = store.benches().await?.into_iter().find(|row| row.name == store.bench_name());
    Ok(BenchStatus {
        kind: row.and_then(|row| row.kind),
        devices: BTreeMap::new(),
        exchanges_vials: None,
        latch: store.latch().await?,
        held: store.held().await?,
        moving: moving.map(|(id, _)| id),
        piling: None,
        waiting: store.waiting_weighings().await?,
        vial: store.pan().await?.vial,
        reservation: store.reservation().await?.filter(|it| it.until > now()),
        unwritten: None,
        repeatability: store.newest_check(CheckKind::Repeatability).await?.map(|it| it.1),
    })
}
