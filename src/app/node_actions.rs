//! What workcells ask of this installation: actions that are created first and started once, and
//! found again by whoever created them, also after a restart.

use super::{App, Error, Result};
use flip_store::node_actions::{Fate, NodeAction};
use serde_json::Value;

impl App {
    /// The UUID that names this data folder to other systems, for as long as it exists.
    pub fn installation(&self) -> &str {
        &self.inner.installation
    }

    /// Stores an action under a new id. Nothing happens yet.
    ///
    /// # Errors
    /// `Unavailable` if opened read-only.
    pub async fn create_node_action(&self, id: &str, name: &str, args: &Value) -> Result<()> {
        let mut tx = self.store().write().await?;
        tx.create_node_action(id, name, args).await?;
        Ok(tx.commit().await?)
    }

    /// One action.
    ///
    /// # Errors
    /// `NotFound`
    pub async fn node_action(&self, id: &str) -> Result<NodeAction> {
        let found = self.store().node_action(id).await?;
        found.ok_or_else(|| Error::not_found("action", id))
    }

    /// The newest actions, at most `limit`.
    pub async fn node_actions(&self, limit: u32) -> Result<Vec<NodeAction>> {
        Ok(self.store().node_actions(limit).await?)
    }

    /// Ids of the actions whose weighing or job has not ended.
    pub async fn running_node_actions(&self) -> Result<Vec<String>> {
        Ok(self.store().running_node_actions().await?)
    }

    /// Notes what became of an action; what was noted before stays.
    ///
    /// # Errors
    /// `Unavailable` if opened read-only.
    pub async fn node_action_became(&self, id: &str, fate: &Fate) -> Result<()> {
        let mut tx = self.store().write().await?;
        tx.node_action_became(id, fate).await?;
        Ok(tx.commit().await?)
    }
}
