//! State of the pan, and the reservation of the bench: one row each.

use super::bench::BENCH_TOPIC;
use super::row::{Columns, json};
use super::{Result, Store, Tx};
use crate::audit::About;
use flip_core::domain::timestamp::Timestamp;
use flip_core::domain::vial::Pan;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;

/// A reservation: exclusive use of the bench.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reservation {
    /// Id used in requests: `rs-…`.
    pub id: String,
    /// Who holds it.
    pub owner: String,
    /// When it expires.
    pub until: Timestamp,
}

/// Why the bench may not be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Refused {
    /// Someone else has reserved it.
    Reserved(Reservation),
    /// The given reservation, by its id, has ended or never existed.
    Ended(String),
    /// This weighing was requested before.
    InUse(String),
}

impl Store {
    /// State of the pan.
    pub async fn pan(&self) -> Result<Pan> {
        let row = sqlx::query("SELECT body FROM bench_pan WHERE one = $1").bind(self.bench.one());
        let row = row.fetch_optional(&self.reader).await?;
        row.map_or_else(|| Ok(Pan::default()), |row| row.json("body"))
    }

    /// The last reservation, which may have ended.
    pub async fn reservation(&self) -> Result<Option<Reservation>> {
        let row =
            sqlx::query("SELECT * FROM bench_reservation WHERE one = $1").bind(self.bench.one());
        let row = row.fetch_optional(&self.reader).await?;
        row.as_ref().map(reservation).transpose()
    }
}

impl Tx {
    /// Update the state of the pan.
    pub async fn set_pan(&mut self, pan: &Pan) -> Result<()> {
        let sql = "INSERT INTO bench_pan (one, body) VALUES ($2, $1) ON CONFLICT (one) DO UPDATE SET body = excluded.body";
        let row = sqlx::query(sql).bind(json(pan)?).bind(self.store.bench.one());
        row.execute(&mut *self.inner).await?;
        let said = self.named(&serde_json::json!({ "vial": pan.vial }))?;
        self.emit(BENCH_TOPIC, "vial", &said).await
    }

    /// Someone confirms that the vial of a weighing is in.
    pub async fn vial_is_in(
        &mut self,
        weighing: &str,
        by: Option<&str>,
        vial: Option<&str>,
        now: Timestamp,
    ) -> Result<()> {
        let said = serde_json::json!({ "action": "vial ready", "by": by, "vial": vial });
        self.audit(About { weighing: Some(weighing), kind: "person" }, &said, now).await
    }

    /// Why a weighing or a measurement with this reservation, or none, may not be requested now, as
    /// seen inside the requesting transaction.
    pub async fn may_use_bench(
        &mut self,
        named: Option<&str>,
        now: Timestamp,
    ) -> Result<Option<Refused>> {
        let row = sqlx::query("SELECT * FROM bench_reservation WHERE one = $1")
            .bind(self.store.bench.one());
        let row = row.fetch_optional(&mut *self.inner).await?;
        let reserved = row.as_ref().map(reservation).transpose()?;
        Ok(refusal(reserved.filter(|it| it.until > now), named))
    }

    /// Why the bench cannot be reserved now: extended under this id, or newly without one.
    pub async fn may_reserve(
        &mut self,
        id: Option<&str>,
        now: Timestamp,
    ) -> Result<Option<Refused>> {
        let refused = self.may_use_bench(id, now).await?;
        if refused.is_some() || id.is_some() {
            return Ok(refused);
        }
        let first = "SELECT id FROM weighing WHERE outcome IS NULL AND bench_name = $1 ORDER BY seq LIMIT 1";
        let first = sqlx::query_scalar(first).bind(&*self.store.bench.name);
        let first: Option<String> = first.fetch_optional(&mut *self.inner).await?;
        Ok(first.map(Refused::InUse))
    }

    /// Reserve the bench, replacing any earlier reservation.
    pub async fn reserve_bench(&mut self, reserved: &Reservation, now: Timestamp) -> Result<()> {
        let sql = "INSERT INTO bench_reservation (one, id, owner, until) VALUES ($4, $1, $2, $3) \
                   ON CONFLICT (one) DO UPDATE SET id = excluded.id, owner = excluded.owner, until = excluded.until";
        let row = sqlx::query(sql)
            .bind(&reserved.id)
            .bind(&reserved.owner)
            .bind(reserved.until.unix_ms())
            .bind(self.store.bench.one());
        row.execute(&mut *self.inner).await?;
        let said = serde_json::json!({ "action": "reserve", "reservation": reserved });
        self.audit_at_bench(About { weighing: None, kind: "person" }, &said, now).await?;
        let said = self.named(reserved)?;
        self.emit(BENCH_TOPIC, "reserved", &said).await
    }

    /// Release a reservation. `false`: it is not the current one.
    pub async fn release_bench(&mut self, id: &str, now: Timestamp) -> Result<bool> {
        let deleted = sqlx::query("DELETE FROM bench_reservation WHERE id = $1 AND one = $2")
            .bind(id)
            .bind(self.store.bench.one())
            .execute(&mut *self.inner)
            .await?;
        if deleted.rows_affected() == 0 {
            return Ok(false);
        }
        let mut said = serde_json::json!({ "action": "release", "reservation": id });
        self.name_bench(&mut said);
        self.audit_at_bench(About { weighing: None, kind: "person" }, &said, now).await?;
        self.emit(BENCH_TOPIC, "released", &said).await?;
        Ok(true)
    }
}

/// Why a request with this reservation, or none, may not use a bench that is reserved like this.
pub fn refusal(reserved: Option<Reservation>, named: Option<&str>) -> Option<Refused> {
    match (reserved, named) {
        (Some(reserved), Some(id)) if reserved.id == id => None,
        (Some(reserved), _) => Some(Refused::Reserved(reserved)),
        (None, named) => named.map(|id| Refused::Ended(id.to_owned())),
    }
}

fn reservation(row: &AnyRow) -> Result<Reservation> {
    Ok(Reservation { id: row.plain("id")?, owner: row.plain("owner")?, until: row.time("until")? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{now, testing};
    use flip_core::domain::vial::Vial;

    #[tokio::test]
    async fn the_pan_and_the_reservation_are_there_after_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let store = testing::open(folder.path()).await.unwrap();
        assert_eq!(
            (store.pan().await.unwrap(), store.reservation().await.unwrap()),
            (Pan::default(), None)
        );
        let vial = Vial {
            name: Some("A".into()),
            weighing: "w".into(),
            holds_mg: Some(8.0),
            since: now(),
        };
        let pan = Pan {
            vial: Some(vial),
            zero_mg: Some(12_000.0),
            shown_mg: Some(8.0),
            empties_mg: vec![12_000.0],
        };
        let reserved = Reservation { id: "rs-1".into(), owner: "Ada".into(), until: now() };
        let mut tx = store.write().await.unwrap();
        tx.set_pan(&Pan::default()).await.unwrap();
        tx.set_pan(&pan).await.unwrap();
        tx.reserve_bench(&reserved, now()).await.unwrap();
        tx.commit().await.unwrap();
        store.close().await;
        drop(store);
        let store = testing::open(folder.path()).await.unwrap();
        assert_eq!(
            (store.pan().await.unwrap(), store.reservation().await.unwrap()),
            (pan, Some(reserved))
        );
        let mut tx = store.write().await.unwrap();
        assert!(
            !tx.release_bench("rs-2", now()).await.unwrap()
                && tx.release_bench("rs-1", now()).await.unwrap()
        );
    }
}
