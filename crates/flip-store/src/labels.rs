//! What people call things: name, note, tags, and whether lists show them.

use super::page::{Page, Window};
use super::row::{Columns, json, word};
use super::sql::Flag;
use super::{Result, Store, Tx};
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;
use std::collections::HashMap;

/// Topic of the events of labels.
pub const LABEL_TOPIC: &str = "label";

/// What can have a label.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LabelKind {
    /// A powder; its name is that of its own row.
    Powder,
    /// A calibration.
    Calibration,
    /// A training.
    Training,
    /// A policy.
    Policy,
    /// An evaluation.
    Evaluation,
    /// An investigation.
    Investigation,
    /// A version of the simulator.
    Simulator,
    /// A weighing or a probing run.
    Weighing,
    /// A list of doses; its id is the name under which it was requested.
    DoseList,
    /// A measurement of the angle of repose by camera.
    Repose,
    /// A film of a weighing.
    Film,
}

/// A name, a note, tags, and whether lists hide it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Label {
    /// What it is on.
    pub kind: LabelKind,
    /// Id of that.
    pub id: String,
    /// Name for people; empty: none.
    pub name: String,
    /// Note; empty: none.
    pub note: String,
    /// Tags, in the order given.
    pub tags: Vec<String>,
    /// Since when lists hide it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub archived_at: Option<Timestamp>,
    /// When it was last changed; absent if nobody ever did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub changed_at: Option<Timestamp>,
    /// By whom, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub changed_by: Option<String>,
}

impl Label {
    /// The label of what nobody has named.
    pub fn none(kind: LabelKind, id: &str) -> Self {
        Self {
            kind,
            id: id.to_owned(),
            name: String::new(),
            note: String::new(),
            tags: Vec::new(),
            archived_at: None,
            changed_at: None,
            changed_by: None,
        }
    }
}

/// Whether archived things are on a list.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ArchivedItems {
    /// Left out.
    #[default]
    Exclude,
    /// Nothing else.
    Only,
    /// Among the others.
    Include,
}

/// Which things a list shows, by their labels.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Shown {
    /// Whether archived ones are shown.
    pub archived: ArchivedItems,
    /// Only with this tag, in any case of a to z.
    pub tag: Option<String>,
}

impl Shown {
    /// Everything, archived or not.
    pub fn all() -> Self {
        Self { archived: ArchivedItems::Include, tag: None }
    }

    /// Argument of [`shown`]: 1 only archived ones, 0 only others, null any.
    pub(super) fn archived(&self) -> Option<bool> {
        match self.archived {
            ArchivedItems::Exclude => Some(false),
            ArchivedItems::Only => Some(true),
            ArchivedItems::Include => None,
        }
    }
}

/// The condition that a row's label meets [`Shown`]: SQL for its kind and its id, then the numbers
/// of the two arguments.
macro_rules! shown {
    ($kind:literal, $id:literal, $archived:literal, $tag:literal) => {
        concat!(
            "(",
            $archived,
            " IS NULL OR ",
            $archived,
            " = EXISTS (SELECT 1 FROM label l WHERE l.kind = ",
            $kind,
            " AND l.id = ",
            $id,
            " AND l.archived_at IS NOT NULL)) AND (",
            $tag,
            " IS NULL OR EXISTS (SELECT 1 FROM label l, json_each(l.tags) t WHERE l.kind = ",
            $kind,
            " AND l.id = ",
            $id,
            " AND lower(t.value) = lower(",
            $tag,
            ")))"
        )
    };
}
pub(super) use shown;

impl Store {
    /// Rows of a list whose statement takes the cursor, the number of rows, and which archived and
    /// tagged things it shows.
    pub(super) async fn rows_shown(
        &self,
        sql: &'static str,
        window: &Window,
    ) -> Result<Vec<AnyRow>> {
        let rows = sqlx::query(sql)
            .bind(window.before())
            .bind(window.rows())
            .bind(window.shown.archived())
            .bind(&window.shown.tag);
        Ok(rows.fetch_all(&self.reader).await?)
    }

    /// The label of one thing, if anybody has changed it.
    pub async fn label(&self, kind: LabelKind, id: &str) -> Result<Option<Label>> {
        let query = sqlx::query("SELECT * FROM label WHERE kind = $1 AND id = $2");
        let row = query.bind(word(&kind)).bind(id).fetch_optional(&self.reader).await?;
        row.as_ref().map(label).transpose()
    }

    /// The labels of these things of one kind, by id.
    pub async fn labels_of(&self, kind: LabelKind, ids: &[&str]) -> Result<HashMap<String, Label>> {
        let sql = "SELECT * FROM label WHERE kind = $1 AND id IN (SELECT value FROM json_each($2))";
        let rows = sqlx::query(sql).bind(word(&kind)).bind(json(&ids)?);
        let rows = rows.fetch_all(&self.reader).await?;
        rows.iter().map(label).map(|it| it.map(|it| (it.id.clone(), it))).collect()
    }

    /// Labels, the one first made first; of one kind if given.
    pub async fn labels(&self, kind: Option<LabelKind>, window: Window) -> Result<Page<Label>> {
        let sql = concat!(
            "SELECT * FROM label WHERE seq > $1 AND ($3 IS NULL OR kind = $3) AND ",
            shown!("label.kind", "label.id", "$4", "$5"),
            " ORDER BY seq LIMIT $2"
        );
        let rows = sqlx::query(sql)
            .bind(window.after())
            .bind(window.rows())
            .bind(kind.as_ref().map(word))
            .bind(window.shown.archived())
            .bind(&window.shown.tag)
            .fetch_all(&self.reader)
            .await?;
        window.page_of(&rows, label)
    }

    /// Whether any weighing names this list of doses.
    pub async fn is_dose_list(&self, name: &str) -> Result<bool> {
        let sql = "SELECT EXISTS (SELECT 1 FROM weighing WHERE asked ->> 'list' = $1)";
        let Flag(is) = sqlx::query_scalar(sql).bind(name).fetch_one(&self.reader).await?;
        Ok(is)
    }

    /// Whether a dose of this list has not ended.
    pub async fn is_list_unfinished(&self, name: &str) -> Result<bool> {
        let sql = "SELECT EXISTS (SELECT 1 FROM weighing WHERE asked ->> 'list' = $1 AND outcome IS NULL)";
        let Flag(is) = sqlx::query_scalar(sql).bind(name).fetch_one(&self.reader).await?;
        Ok(is)
    }
}

impl Tx {
    /// The label of one thing as of this transaction.
    pub async fn label(&mut self, kind: LabelKind, id: &str) -> Result<Option<Label>> {
        let query = sqlx::query("SELECT * FROM label WHERE kind = $1 AND id = $2");
        let row = query.bind(word(&kind)).bind(id).fetch_optional(&mut *self.inner).await?;
        row.as_ref().map(label).transpose()
    }

    /// Store a label in place of the one before.
    pub async fn set_label(&mut self, label: &Label) -> Result<()> {
        let sql = "INSERT INTO label (kind, id, name, note, tags, archived_at, changed_at, changed_by) \
                   VALUES ($1, $2, $3, $4, $5, $6, $7, $8) ON CONFLICT (kind, id) DO UPDATE SET name = $3, note = $4, \
                   tags = $5, archived_at = $6, changed_at = $7, changed_by = $8";
        let ms = |at: Option<Timestamp>| at.map(|at| at.unix_ms());
        sqlx::query(sql)
            .bind(word(&label.kind))
            .bind(&label.id)
            .bind(&label.name)
            .bind(&label.note)
            .bind(json(&label.tags)?)
            .bind(ms(label.archived_at))
            .bind(ms(label.changed_at))
            .bind(&label.changed_by)
            .execute(&mut *self.inner)
            .await?;
        self.emit(LABEL_TOPIC, "changed", label).await
    }

    /// Rename a powder.
    pub async fn rename_powder(&mut self, id: &str, name: &str) -> Result<()> {
        let query = sqlx::query("UPDATE powder SET name = $2 WHERE id = $1");
        query.bind(id).bind(name).execute(&mut *self.inner).await?;
        Ok(())
    }

    /// Id and name of every powder as of this transaction, oldest first.
    pub async fn powder_names(&mut self) -> Result<Vec<(String, String)>> {
        let query = sqlx::query_as("SELECT id, name FROM powder ORDER BY seq");
        Ok(query.fetch_all(&mut *self.inner).await?)
    }
}

/// A label as stored; also what the record says of it.
pub(super) fn label(row: &AnyRow) -> Result<Label> {
    Ok(Label {
        kind: row.word("label", "kind")?,
        id: row.plain("id")?,
        name: row.plain("name")?,
        note: row.plain("note")?,
        tags: row.json("tags")?,
        archived_at: row.maybe_time("archived_at")?,
        changed_at: row.maybe_time("changed_at")?,
        changed_by: row.plain("changed_by")?,
    })
}
