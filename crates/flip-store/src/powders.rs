//! Powders and their measurements.

use super::labels::shown;
use super::page::{Page, Window};
use super::row::{Columns, word};
use super::sql::Flag;
use super::withdrawals::{Withdrawn, withdrawn};
use super::{Result, Store, Tx, new_id, now};
use flip_core::domain::powder::{Flowability, Method, PUBLISHED, PUBLISHED_SOURCE};
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;

/// A real powder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Powder {
    /// Short name in lower case, e.g. `sodium_bicarbonate`.
    pub id: String,
    /// Display name.
    pub name: String,
    /// The flowability that calibrations target: the latest automated measurement, else the latest
    /// manual one.
    pub flowability: Option<Flowability>,
    /// Whether it dissolves in water that it takes up from humid air; absent where nobody said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub soluble: Option<bool>,
    /// When it was registered.
    pub created_at: Timestamp,
}

/// One measurement of a powder's flowability.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// Id.
    pub id: String,
    /// Powder id.
    pub powder: String,
    /// How it was measured.
    pub method: Method,
    /// Mean angle of repose, degrees.
    pub repose_deg: f64,
    /// Standard deviation over the repeats, degrees.
    pub sd_deg: f64,
    /// A single value has no known spread: `sd_deg` is 0 then, and carries no information.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub sd_unknown: bool,
    /// Number of repeats.
    pub n: u32,
    /// Where the numbers come from.
    pub source: String,
    /// On which day it was made, as `2026-02-03`; absent if nobody said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured_on: Option<String>,
    /// When it was registered.
    pub created_at: Timestamp,
    /// Why it no longer counts; absent if it does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub withdrawn: Option<Withdrawn>,
}

/// Where numbers come from.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Origin {
    /// In words; may be empty.
    pub source: String,
    /// The day on which they were measured, as `2026-02-03`.
    pub measured_on: Option<String>,
}

impl Origin {
    /// On a day that nobody named.
    pub fn undated(source: &str) -> Self {
        Self { source: source.to_owned(), measured_on: None }
    }
}

impl Store {
    /// Powders, oldest first.
    pub async fn powders(&self, window: Window) -> Result<Page<Powder>> {
        let sql = concat!(
            "SELECT * FROM powder_now WHERE seq > $1 AND ",
            shown!("'powder'", "powder_now.id", "$3", "$4"),
            " ORDER BY seq LIMIT $2"
        );
        let rows = sqlx::query(sql)
            .bind(window.after())
            .bind(window.rows())
            .bind(window.shown.archived())
            .bind(&window.shown.tag)
            .fetch_all(&self.reader)
            .await?;
        window.page_of(&rows, powder)
    }

    /// One powder.
    pub async fn powder(&self, id: &str) -> Result<Option<Powder>> {
        let row = sqlx::query("SELECT * FROM powder_now WHERE id = $1")
            .bind(id)
            .fetch_optional(&self.reader)
            .await?;
        row.as_ref().map(powder).transpose()
    }

    /// What was said of the solubility of powders, by id.
    pub async fn said_of_solubility(&self) -> Result<Vec<(String, bool)>> {
        let sql = "SELECT id, soluble FROM powder WHERE soluble IS NOT NULL";
        let rows = sqlx::query(sql).fetch_all(&self.reader).await?;
        rows.iter().map(|row| Ok((row.plain("id")?, row.flag("soluble")?))).collect()
    }

    /// Id and name of every powder, oldest first.
    pub async fn powder_names(&self) -> Result<Vec<(String, String)>> {
        Ok(sqlx::query_as("SELECT id, name FROM powder ORDER BY seq")
            .fetch_all(&self.reader)
            .await?)
    }

    /// Measurements of a powder, withdrawn ones too, oldest first.
    pub async fn measurements(&self, powder: &str, window: Window) -> Result<Page<Measurement>> {
        let rows = sqlx::query(
            "SELECT * FROM measurement_all WHERE powder = $1 AND seq > $2 ORDER BY seq LIMIT $3",
        )
        .bind(powder)
        .bind(window.after())
        .bind(window.rows())
        .fetch_all(&self.reader)
        .await?;
        window.page_of(&rows, measurement)
    }

    /// Every measurement that counts, oldest first; of one powder if given.
    pub async fn all_measurements(&self, powder: Option<&str>) -> Result<Vec<Measurement>> {
        let sql = "SELECT * FROM measurement_all WHERE withdrawn_at IS NULL AND ($1 IS NULL OR powder = $1) ORDER BY seq";
        sqlx::query(sql)
            .bind(powder)
            .fetch_all(&self.reader)
            .await?
            .iter()
            .map(measurement)
            .collect()
    }

    /// Measurements that count after a position, oldest first, at most a few thousand, and the position of the
    /// last one; of one powder if given.
    pub async fn measurements_after(
        &self,
        powder: Option<&str>,
        after: i64,
    ) -> Result<(Vec<Measurement>, i64)> {
        let sql = "SELECT * FROM measurement_all WHERE seq > $2 AND withdrawn_at IS NULL AND ($1 IS NULL OR powder = $1) ORDER BY seq LIMIT $3";
        self.batch(sql, powder, after, measurement).await
    }

    /// Register the published powders, once: any that a user later removes or renames are left
    /// alone.
    pub(super) async fn seed_published_powders(&self) -> Result<()> {
        let mut tx = self.write().await?;
        let Flag(seeded) = sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM powder)")
            .fetch_one(&mut *tx.inner)
            .await?;
        if seeded {
            return Ok(());
        }
        for row in PUBLISHED {
            tx.insert_powder(row.id, row.name, None).await?;
            for (method, flowability) in
                [(Method::Automated, row.automated), (Method::Manual, row.manual)]
            {
                let origin = Origin::undated(PUBLISHED_SOURCE);
                tx.insert_measurement(row.id, method, flowability, &origin).await?;
            }
        }
        tx.commit().await
    }
}

impl Tx {
    /// Add a powder; returns when. `None`: the id is taken.
    pub async fn insert_powder(
        &mut self,
        id: &str,
        name: &str,
        soluble: Option<bool>,
    ) -> Result<Option<Timestamp>> {
        let at = now();
        let sql = "INSERT INTO powder (id, name, created_at, soluble) VALUES ($1, $2, $3, $4) ON CONFLICT (id) DO NOTHING";
        let done = sqlx::query(sql)
            .bind(id)
            .bind(name)
            .bind(at.unix_ms())
            .bind(soluble)
            .execute(&mut *self.inner)
            .await?;
        Ok((done.rows_affected() == 1).then_some(at))
    }

    /// Add a measurement of an existing powder.
    pub async fn insert_measurement(
        &mut self,
        powder: &str,
        method: Method,
        flowability: Flowability,
        origin: &Origin,
    ) -> Result<Measurement> {
        let sql = "INSERT INTO measurement (id, powder, method, repose_deg, sd_deg, n, source, created_at, measured_on) \
                   VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9) \
                   RETURNING *, NULL AS withdrawn_at";
        let row = sqlx::query(sql)
            .bind(new_id())
            .bind(powder)
            .bind(word(&method))
            .bind(flowability.repose_deg)
            .bind(flowability.sd_deg)
            .bind(i64::from(flowability.n))
            .bind(&origin.source)
            .bind(now().unix_ms())
            .bind(&origin.measured_on)
            .fetch_one(&mut *self.inner)
            .await?;
        measurement(&row)
    }
}

fn powder(row: &AnyRow) -> Result<Powder> {
    let flowability = match row.plain::<Option<f64>>("repose_deg")? {
        Some(repose_deg) => {
            Some(Flowability { repose_deg, sd_deg: row.plain("sd_deg")?, n: row.count("n")? })
        }
        None => None,
    };
    Ok(Powder {
        id: row.plain("id")?,
        name: row.plain("name")?,
        flowability,
        soluble: row.plain::<Option<Flag>>("soluble")?.map(|Flag(is)| is),
        created_at: row.time("created_at")?,
    })
}

pub(super) fn measurement(row: &AnyRow) -> Result<Measurement> {
    let (sd_deg, n) = (row.plain("sd_deg")?, row.count("n")?);
    Ok(Measurement {
        id: row.plain("id")?,
        powder: row.plain("powder")?,
        method: row.word("measurement", "method")?,
        repose_deg: row.plain("repose_deg")?,
        sd_deg,
        sd_unknown: n == 1 && sd_deg == 0.0,
        n,
        source: row.plain("source")?,
        measured_on: row.plain("measured_on")?,
        created_at: row.time("created_at")?,
        withdrawn: withdrawn(row)?,
    })
}
