//! The tokens in memory: the holder of a secret is found without querying the database, so that a
//! stop waits for no reader.
//!
//! The table remains authoritative. It is read again every second, after every change made here,
//! and when a secret is not known: another process may just have created it. Unknown secrets share
//! one query at a time, at most twenty a second, on a dedicated connection.

use flip_core::domain::timestamp::Timestamp;
use flip_store::tokens::{HashedToken, Role};
use flip_store::{self as store, Store, now};
use sha2::{Digest, Sha256};
use std::collections::HashMap;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{PoisonError, RwLock, RwLockReadGuard};
use std::time::{Duration, Instant};
use subtle::ConstantTimeEq;
use tokio::sync::{Mutex, watch};

/// Minimum interval between queries caused by unknown secrets.
const LOOKS_APART: Duration = Duration::from_millis(50);
/// How long a query may take before the caller is answered from what is known so far.
const LOOK_MAX: Duration = Duration::from_secs(1);

/// Holder of a valid token.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Holder {
    /// The token's id.
    pub id: String,
    /// The token's name.
    pub name: String,
    /// Role of the holder.
    pub role: Role,
    /// Whether the holder may clear a latched bench.
    pub may_clear: bool,
    /// When the token expires; never if absent.
    pub expires_at: Option<Timestamp>,
    /// Provider that the holder logged in with; absent for a token that somebody created.
    pub issuer: Option<String>,
}

/// All tokens by id.
#[derive(Default)]
pub(super) struct Keyring {
    known: RwLock<HashMap<String, Key>>,
    /// Notified whenever the table was read: a token may have ended.
    asked: watch::Sender<()>,
    /// When the table was last read.
    looked: Mutex<Option<Instant>>,
}

struct Key {
    token: HashedToken,
    /// Last use, ms since 1970; 0 for never.
    used_ms: AtomicI64,
}

impl Keyring {
    /// Loads the current content of the table.
    pub(super) async fn of(store: &Store) -> store::Result<Self> {
        let keyring = Self::default();
        keyring.look(store).await?;
        Ok(keyring)
    }

    /// Reads the table.
    pub(super) async fn look(&self, store: &Store) -> store::Result<()> {
        let mut looked = self.looked.lock().await;
        *looked = Some(Instant::now());
        self.replace(store.every_token().await?);
        Ok(())
    }

    /// Reads the table because a secret is not known; callers that arrive while another query is
    /// due wait for it. Returns whether this caller made the query.
    pub(super) async fn look_after_a_miss(&self, store: &Store) -> bool {
        let missed = Instant::now();
        let look = async {
            let mut looked = self.looked.lock().await;
            match *looked {
                // It started after the miss, so it has seen what was there then.
                Some(last) if last >= missed => return Ok(false),
                Some(last) => tokio::time::sleep(LOOKS_APART.saturating_sub(last.elapsed())).await,
                None => {}
            }
            *looked = Some(Instant::now());
            self.replace(store.every_token().await?);
            store::Result::Ok(true)
        };
        match tokio::time::timeout(LOOK_MAX, look).await {
            Ok(Ok(asked)) => return asked,
            Ok(Err(error)) => {
                tracing::warn!(%error, "the tokens could not be looked up; those known so far count")
            }
            Err(_) => tracing::warn!(
                "the tokens could not be looked up within a second; those known so far count"
            ),
        }
        true
    }

    fn replace(&self, tokens: Vec<HashedToken>) {
        let mut known = self.known.write().unwrap_or_else(PoisonError::into_inner);
        let before = std::mem::take(&mut *known);
        *known = tokens
            .into_iter()
            .map(|token| (token.entry.id.clone(), Key::new(token, &before)))
            .collect();
        drop(known);
        self.asked.send_replace(());
    }

    /// Whether the token with this id is still valid.
    pub(super) fn is_good(&self, id: &str) -> bool {
        self.known().get(id).is_some_and(|key| key.is_good(now()))
    }

    /// Completes when the token with this id is no longer valid.
    pub(super) async fn ended(&self, id: &str) {
        let mut asked = self.asked.subscribe();
        while self.is_good(id) {
            let expires_at = self.known().get(id).and_then(|key| key.token.entry.expires_at);
            let left_ms = expires_at.map_or(i64::MAX, |end| end.unix_ms() - now().unix_ms());
            // No longer than a polling interval: clocks can be set.
            let left = Duration::from_millis(u64::try_from(left_ms).unwrap_or(0)).min(LOOK_MAX);
            tokio::select! {
                _ = asked.changed() => {}
                () = tokio::time::sleep(left) => {}
            }
        }
    }

    /// Holder of this secret; `None` if there is none, or none any longer.
    pub(super) fn holder(&self, secret: &str) -> Option<Holder> {
        let id = secret.strip_prefix("flip_").and_then(|rest| rest.split('_').next())?;
        let known = self.known();
        let key = known.get(id)?;
        let same = Sha256::digest(secret).ct_eq(key.token.sha256.as_slice());
        let at = now();
        if !bool::from(same) || !key.is_good(at) {
            return None;
        }
        key.used_ms.fetch_max(at.unix_ms(), Ordering::Relaxed);
        Some(key.holder())
    }

    /// Holder of the newest valid token with this name.
    pub(super) fn named(&self, name: &str) -> Option<Holder> {
        let (known, at) = (self.known(), now());
        let named = known.values().filter(|key| key.token.entry.name == name && key.is_good(at));
        let key = named.max_by_key(|key| key.token.entry.created_at)?;
        key.used_ms.fetch_max(at.unix_ms(), Ordering::Relaxed);
        Some(key.holder())
    }

    /// Uses that are not stored yet.
    pub(super) fn uses(&self) -> Vec<(String, Timestamp)> {
        let known = self.known();
        let unwritten = known.values().filter_map(|key| {
            let used = Timestamp::from_unix_ms(key.used_ms.load(Ordering::Relaxed));
            (Some(used) > key.token.entry.last_used_at && used.unix_ms() > 0)
                .then(|| (key.token.entry.id.clone(), used))
        });
        unwritten.collect()
    }

    fn known(&self) -> RwLockReadGuard<'_, HashMap<String, Key>> {
        self.known.read().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Key {
    /// A token as read from the table; its last use is carried over.
    fn new(token: HashedToken, before: &HashMap<String, Self>) -> Self {
        let used_ms =
            before.get(&token.entry.id).map_or(0, |key| key.used_ms.load(Ordering::Relaxed));
        Self { token, used_ms: AtomicI64::new(used_ms) }
    }

    fn holder(&self) -> Holder {
        let entry = &self.token.entry;
        Holder {
            id: entry.id.clone(),
            name: entry.name.clone(),
            role: entry.role,
            may_clear: entry.may_clear || entry.role == Role::Admin,
            expires_at: entry.expires_at,
            issuer: entry.issuer.clone(),
        }
    }

    fn is_good(&self, at: Timestamp) -> bool {
        let entry = &self.token.entry;
        entry.revoked_at.is_none() && entry.expires_at.is_none_or(|end| at < end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_store::tokens::TokenEntry;

    const SECRET: &str = "flip_00_11";

    fn ring(change: impl FnOnce(&mut TokenEntry)) -> Keyring {
        let mut entry = TokenEntry {
            id: "00".into(),
            name: "test".into(),
            role: Role::Operator,
            may_clear: false,
            created_at: now(),
            expires_at: None,
            revoked_at: None,
            last_used_at: None,
            issuer: None,
            subject: None,
        };
        change(&mut entry);
        let ring = Keyring::default();
        ring.replace(vec![HashedToken { entry, sha256: Sha256::digest(SECRET).to_vec() }]);
        ring
    }

    #[test]
    fn a_token_that_has_expired_or_was_revoked_opens_nothing() {
        let past = Timestamp::from_unix_ms(now().unix_ms() - 1);
        let future = Timestamp::from_unix_ms(now().unix_ms() + 3_600_000);
        assert!(ring(|_| {}).holder(SECRET).is_some());
        assert!(ring(|it| it.expires_at = Some(future)).holder(SECRET).is_some());
        assert_eq!(ring(|it| it.expires_at = Some(past)).holder(SECRET), None);
        assert_eq!(ring(|it| it.revoked_at = Some(past)).holder(SECRET), None);
        assert_eq!(
            ring(|it| it.revoked_at = Some(future)).holder(SECRET),
            None,
            "revoked is revoked"
        );
    }

    #[tokio::test]
    async fn whoever_waits_for_the_end_of_a_token_hears_of_its_expiry_and_of_its_revocation() {
        let soon = Timestamp::from_unix_ms(now().unix_ms() + 20);
        ring(|it| it.expires_at = Some(soon)).ended("00").await;
        assert!(now() >= soon);
        let ring = ring(|_| {});
        let mut revoked = ring.known()["00"].token.clone();
        revoked.entry.revoked_at = Some(now());
        let revoke = async || ring.replace(vec![revoked]);
        tokio::join!(ring.ended("00"), revoke());
        ring.ended("not there").await;
    }

    #[test]
    fn a_token_is_found_by_its_name_while_it_is_valid() {
        let past = Timestamp::from_unix_ms(now().unix_ms() - 1);
        assert_eq!(ring(|_| {}).named("test").unwrap().id, "00");
        assert_eq!(ring(|_| {}).named("another"), None);
        assert_eq!(ring(|it| it.expires_at = Some(past)).named("test"), None);
    }

    #[test]
    fn only_admins_and_operators_whose_token_says_so_may_clear() {
        let may_clear = |role, flag| {
            let ring = ring(|it| (it.role, it.may_clear) = (role, flag));
            ring.holder(SECRET).unwrap().may_clear
        };
        assert!(
            !may_clear(Role::Operator, false)
                && may_clear(Role::Operator, true)
                && may_clear(Role::Admin, false)
        );
    }

    #[test]
    fn uses_are_remembered_until_they_are_in_the_table_also_when_the_table_is_read_again() {
        let ring = ring(|_| {});
        assert_eq!(ring.uses(), []);
        ring.holder(SECRET).unwrap();
        let uses = ring.uses();
        assert_eq!(uses[0].0, "00");
        let read_again = |last_used_at| {
            let mut token = ring.known()["00"].token.clone();
            token.entry.last_used_at = last_used_at;
            ring.replace(vec![token]);
        };
        read_again(None);
        assert_eq!(ring.uses(), uses);
        read_again(Some(uses[0].1));
        assert_eq!(ring.uses(), []);
    }

    #[tokio::test]
    async fn a_thousand_guesses_at_once_share_a_few_looks() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let ring = Keyring::of(&store).await.unwrap();
        let asked =
            futures::future::join_all((0..1000).map(|_| ring.look_after_a_miss(&store))).await;
        let looks = asked.iter().filter(|asked| **asked).count();
        assert!((1..10).contains(&looks), "{looks} looks");
    }
}
