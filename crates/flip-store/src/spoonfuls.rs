//! What spoons let fall: weighings whose traces hold it, spoonfuls imported from elsewhere, and from
//! when on both count.
//!
//! The shakes of a weighing are in its trace and nowhere else.

use super::page::Window;
use super::row::{Columns, json, word};
use super::weighing_rows::weighing_row;
use super::weighings::WeighingRow;
use super::{Result, Store, Tx, new_id};
use flip_core::domain::bench::BenchKind;
use flip_core::domain::shake::Spoonful;
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;

/// Which shakes.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ShakesWanted {
    /// Of this powder; of any if none.
    pub powder: Option<String>,
    /// Of this lot; of any, and of unknown ones, if none.
    pub lot: Option<String>,
    /// Of weighings on this bench, and all imported ones; of any bench if none.
    pub bench: Option<BenchKind>,
}

/// A spoonful imported from elsewhere.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ImportedSpoonful {
    /// Id.
    pub id: String,
    /// The spoonful.
    #[serde(flatten)]
    pub spoonful: Spoonful,
    /// Where the numbers come from.
    pub source: String,
    /// When it was imported.
    pub created_at: Timestamp,
}

/// Up to when the shakes of a powder, or of one of its lots, are neither used nor listed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Forgotten {
    /// Id.
    pub id: String,
    /// Powder id.
    pub powder: String,
    /// The lot; absent for all lots and shakes of unknown lots.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lot: Option<String>,
    /// Weighings that began, and spoonfuls imported, until then.
    pub at: Timestamp,
}

/// No one has asked to forget the row of `$table`, which was made at `$at`, of the lot `$lot`.
macro_rules! counts {
    ($table:literal, $lot:literal, $at:literal) => {
        concat!(
            " AND NOT EXISTS (SELECT 1 FROM forgotten WHERE forgotten.powder = ",
            $table,
            ".powder AND (forgotten.lot IS NULL OR forgotten.lot = ",
            $lot,
            ") AND forgotten.at >= ",
            $at,
            ")"
        )
    };
}

/// The condition that a weighing's shakes still count.
macro_rules! weighing_counts {
    () => {
        counts!("weighing", "json_extract(weighing.asked, '$.lot')", "weighing.started_at")
    };
}

impl Store {
    /// Where to find the ticks of a powder's latest doses and probing runs on such a bench that ran their
    /// course, or until the spoon was blocked, and still count, newest first; of this lot, if one is given.
    pub async fn traces_of(
        &self,
        powder: &str,
        lot: Option<&str>,
        bench: BenchKind,
        count: u32,
    ) -> Result<Vec<String>> {
        let sql = concat!(
            "SELECT trace FROM weighing WHERE powder = $1 AND bench = $2 AND outcome IN ('within', 'under', 'over', 'blocked', 'probed') \
             AND trace IS NOT NULL AND ($4 IS NULL OR json_extract(asked, '$.lot') = $4) AND bench_name = $5",
            weighing_counts!(),
            " ORDER BY seq DESC LIMIT $3"
        );
        let query = sqlx::query_scalar(sql)
            .bind(powder)
            .bind(word(&bench))
            .bind(i64::from(count))
            .bind(lot)
            .bind(self.bench_name());
        Ok(query.fetch_all(&self.reader).await?)
    }

    /// Weighings with a trace whose shakes count, oldest first, with their positions.
    pub async fn shaken(
        &self,
        wanted: &ShakesWanted,
        window: Window,
    ) -> Result<Vec<(i64, WeighingRow)>> {
        let sql = concat!(
            "SELECT * FROM weighing WHERE seq > $1 AND trace IS NOT NULL AND ($2 IS NULL OR powder = $2) \
             AND ($3 IS NULL OR json_extract(asked, '$.lot') = $3) AND ($4 IS NULL OR bench = $4)",
            weighing_counts!(),
            " ORDER BY seq LIMIT $5"
        );
        let rows = sqlx::query(sql)
            .bind(window.after())
            .bind(&wanted.powder)
            .bind(&wanted.lot)
            .bind(wanted.bench.as_ref().map(word))
            .bind(window.rows())
            .fetch_all(&self.reader)
            .await?;
        rows.iter().map(|row| Ok((row.plain("seq")?, weighing_row(row)?))).collect()
    }

    /// Imported spoonfuls that count, oldest first, with their positions.
    pub async fn imported_spoonfuls(
        &self,
        wanted: &ShakesWanted,
        window: Window,
    ) -> Result<Vec<(i64, ImportedSpoonful)>> {
        let sql = concat!(
            "SELECT * FROM spoonful WHERE seq > $1 AND ($2 IS NULL OR powder = $2) AND ($3 IS NULL OR lot = $3)",
            counts!("spoonful", "spoonful.lot", "spoonful.created_at"),
            " ORDER BY seq LIMIT $4"
        );
        let rows = sqlx::query(sql)
            .bind(window.after())
            .bind(&wanted.powder)
            .bind(&wanted.lot)
            .bind(window.rows())
            .fetch_all(&self.reader)
            .await?;
        rows.iter().map(|row| Ok((row.plain("seq")?, imported(row)?))).collect()
    }

    /// What was asked to be forgotten, oldest first.
    pub async fn forgotten(&self) -> Result<Vec<Forgotten>> {
        let rows =
            sqlx::query("SELECT * FROM forgotten ORDER BY seq").fetch_all(&self.reader).await?;
        rows.iter().map(forgotten).collect()
    }
}

impl Tx {
    /// Add a spoonful of an existing powder. It is dated after whatever was forgotten, so that it
    /// counts even if both happen within a millisecond or the clock was set back.
    pub async fn insert_spoonful(
        &mut self,
        spoonful: &Spoonful,
        source: &str,
        now: Timestamp,
    ) -> Result<ImportedSpoonful> {
        let sql = "INSERT INTO spoonful (id, powder, lot, body, source, created_at) VALUES ($1, $2, $3, $4, $5, \
                   max($6, (SELECT coalesce(max(at) + 1, 0) FROM forgotten WHERE powder = $2))) RETURNING *";
        let row = sqlx::query(sql)
            .bind(new_id())
            .bind(&spoonful.powder)
            .bind(&spoonful.lot)
            .bind(json(spoonful)?)
            .bind(source)
            .bind(now.unix_ms())
            .fetch_one(&mut *self.inner)
            .await?;
        imported(&row)
    }

    /// From now on neither use nor list what was shaken or imported of this powder until now, or of
    /// one of its lots.
    pub async fn forget_shakes(
        &mut self,
        powder: &str,
        lot: Option<&str>,
        now: Timestamp,
    ) -> Result<Forgotten> {
        // A spoonful may be dated a little later than it was imported.
        let sql = "INSERT INTO forgotten (id, powder, lot, at) VALUES ($1, $2, $3, \
                   max($4, (SELECT coalesce(max(created_at), 0) FROM spoonful WHERE powder = $2))) RETURNING *";
        let row = sqlx::query(sql)
            .bind(new_id())
            .bind(powder)
            .bind(lot)
            .bind(now.unix_ms())
            .fetch_one(&mut *self.inner)
            .await?;
        let found = forgotten(&row)?;
        let said = serde_json::json!({ "forgotten": found });
        self.audit_deed(None, "forget shakes", said, now).await?;
        Ok(found)
    }
}

fn imported(row: &AnyRow) -> Result<ImportedSpoonful> {
    Ok(ImportedSpoonful {
        id: row.plain("id")?,
        spoonful: row.json("body")?,
        source: row.plain("source")?,
        created_at: row.time("created_at")?,
    })
}

fn forgotten(row: &AnyRow) -> Result<Forgotten> {
    Ok(Forgotten {
        id: row.plain("id")?,
        powder: row.plain("powder")?,
        lot: row.plain("lot")?,
        at: row.time("at")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use flip_core::domain::shake::Shake;

    fn spoonful(weighing: &str, lot: Option<&str>) -> Spoonful {
        let shake = Shake {
            pitch_deg: 30.0,
            shake_mm: 4.0,
            strokes: 1,
            acceleration_m_s2: None,
            spoon_mg: None,
            fell_mg: -0.1,
            sd_mg: 0.04,
            since_filled_s: None,
        };
        Spoonful {
            weighing: weighing.to_owned(),
            spoonful: 1,
            powder: "salt".to_owned(),
            lot: lot.map(str::to_owned),
            session: None,
            readability_mg: None,
            shakes: vec![shake],
        }
    }

    async fn import(store: &Store, weighing: &str, lot: Option<&str>, at_ms: i64) {
        let mut tx = store.write().await.unwrap();
        let at = Timestamp::from_unix_ms(at_ms);
        tx.insert_spoonful(&spoonful(weighing, lot), "", at).await.unwrap();
        tx.commit().await.unwrap();
    }

    async fn forget(store: &Store, lot: Option<&str>, at_ms: i64) {
        let mut tx = store.write().await.unwrap();
        tx.forget_shakes("salt", lot, Timestamp::from_unix_ms(at_ms)).await.unwrap();
        tx.commit().await.unwrap();
    }

    async fn names(store: &Store, lot: Option<&str>) -> Vec<String> {
        let wanted = ShakesWanted { lot: lot.map(str::to_owned), ..ShakesWanted::default() };
        let window = Window { limit: 200, ..Window::default() };
        let found = store.imported_spoonfuls(&wanted, window).await.unwrap();
        found.into_iter().map(|(_, it)| it.spoonful.weighing).collect()
    }

    #[tokio::test]
    async fn what_was_imported_before_is_forgotten_by_lot_or_altogether_and_what_comes_later_counts()
     {
        let folder = tempfile::tempdir().unwrap();
        let store = testing::open(folder.path()).await.unwrap();
        import(&store, "a", Some("L1"), 1000).await;
        import(&store, "b", Some("L2"), 1000).await;
        import(&store, "c", None, 1000).await;
        assert_eq!(names(&store, Some("L1")).await, ["a"]);
        forget(&store, Some("L1"), 1000).await;
        assert_eq!(names(&store, None).await, ["b", "c"]);
        // In the same millisecond, and with a clock that was set back.
        import(&store, "d", Some("L1"), 1000).await;
        import(&store, "e", Some("L1"), 10).await;
        assert_eq!(names(&store, None).await, ["b", "c", "d", "e"]);
        forget(&store, None, 500).await;
        assert_eq!(names(&store, None).await, Vec::<String>::new());
        let rows: i64 = sqlx::query_scalar("SELECT count(*) FROM spoonful")
            .fetch_one(&store.reader)
            .await
            .unwrap();
        assert_eq!(rows, 5, "the rows stay as evidence");
        let forgotten = store.forgotten().await.unwrap();
        assert_eq!(forgotten[0].lot.as_deref(), Some("L1"));
        store.close().await;
    }
}
