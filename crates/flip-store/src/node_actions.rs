//! Actions of a workcell: created, then started once; what each became.

use super::row::Columns;
use super::{Result, Store, Tx, now};
use flip_core::domain::timestamp::Timestamp;
use serde_json::Value;
use sqlx::any::AnyRow;

/// An action that a workcell created.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeAction {
    /// A ULID.
    pub id: String,
    /// Which action.
    pub name: String,
    /// Its arguments, as they were sent.
    pub args: Value,
    /// When it was created.
    pub created_at: Timestamp,
    /// What became of it.
    pub fate: Fate,
}

/// What became of an action.
#[derive(Debug, Clone, PartialEq)]
pub enum Fate {
    /// It has not been started.
    Created,
    /// It is this weighing or job; or, with its own id, it was done at once.
    Made(String),
    /// It was refused, with this problem.
    Refused(Value),
}

fn action(row: &AnyRow) -> Result<NodeAction> {
    let (made, refused): (Option<String>, _) = (row.plain("made")?, row.maybe_json("refused")?);
    Ok(NodeAction {
        id: row.plain("id")?,
        name: row.plain("name")?,
        args: row.json("args")?,
        created_at: row.time("created_at")?,
        fate: match (made, refused) {
            (Some(made), _) => Fate::Made(made),
            (None, Some(refused)) => Fate::Refused(refused),
            (None, None) => Fate::Created,
        },
    })
}

impl Store {
    /// The UUID that names this data folder to other systems.
    pub async fn installation(&self) -> Result<String> {
        let row = sqlx::query("SELECT id FROM installation").fetch_one(&self.reader).await?;
        row.plain("id")
    }

    /// One action.
    pub async fn node_action(&self, id: &str) -> Result<Option<NodeAction>> {
        let row = sqlx::query("SELECT * FROM node_action WHERE id = $1")
            .bind(id)
            .fetch_optional(&self.reader)
            .await?;
        row.as_ref().map(action).transpose()
    }

    /// The newest actions, at most `limit`.
    pub async fn node_actions(&self, limit: u32) -> Result<Vec<NodeAction>> {
        let rows =
            sqlx::query("SELECT * FROM node_action ORDER BY created_at DESC, id DESC LIMIT $1")
                .bind(i64::from(limit))
                .fetch_all(&self.reader)
                .await?;
        rows.iter().map(action).collect()
    }

    /// Ids of the actions whose weighing or job has not ended.
    pub async fn running_node_actions(&self) -> Result<Vec<String>> {
        let rows = sqlx::query(
            "SELECT a.id FROM weighing w JOIN node_action a ON a.made = w.id WHERE w.outcome IS NULL
             UNION SELECT a.id FROM job j JOIN node_action a ON a.made = j.id WHERE j.state IN ('queued', 'running')",
        )
        .fetch_all(&self.reader)
        .await?;
        rows.iter().map(|row| row.plain("id")).collect()
    }
}

impl Tx {
    /// Create an action.
    pub async fn create_node_action(&mut self, id: &str, name: &str, args: &Value) -> Result<()> {
        sqlx::query("INSERT INTO node_action (id, name, args, created_at) VALUES ($1, $2, $3, $4)")
            .bind(id)
            .bind(name)
            .bind(args.to_string())
            .bind(now().unix_ms())
            .execute(&mut *self.inner)
            .await?;
        Ok(())
    }

    /// Note what became of an action; what was noted before stays.
    pub async fn node_action_became(&mut self, id: &str, fate: &Fate) -> Result<()> {
        let (made, refused) = match fate {
            Fate::Created => return Ok(()),
            Fate::Made(made) => (Some(made), None),
            Fate::Refused(problem) => (None, Some(problem.to_string())),
        };
        sqlx::query(
            "UPDATE node_action SET made = $2, refused = $3
             WHERE id = $1 AND made IS NULL AND refused IS NULL",
        )
        .bind(id)
        .bind(made)
        .bind(refused)
        .execute(&mut *self.inner)
        .await?;
        Ok(())
    }
}
