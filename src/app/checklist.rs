//! What a person checks before a dose. A lab writes its own; a weighing keeps what was confirmed.

use super::check::Check;
use super::{App, Result};
use flip_core::domain::timestamp::Timestamp;
use flip_store::checklist::StoredChecklist;
use serde::{Deserialize, Serialize};

/// Most items of a checklist.
const ITEMS_MAX: usize = 20;
/// The checklist of a lab that has written none.
const SHIPPED: [&str; 3] =
    ["The vial is empty and in place", "The powder is loaded", "The balance is level"];

/// What a person checks before a dose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Checklist {
    /// In order.
    pub items: Vec<String>,
    /// When the lab wrote it; absent while it is the one that ships.
    pub changed_at: Option<Timestamp>,
}

/// A checklist to use from now on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewChecklist {
    /// In order, at most 20, each 1 to 200 characters; empty asks for nothing.
    pub items: Vec<String>,
}

impl App {
    /// The lab's checklist, or the one that ships.
    pub async fn checklist(&self) -> Result<Checklist> {
        Ok(match self.store().checklist().await? {
            Some(StoredChecklist { items, changed_at }) => {
                Checklist { items, changed_at: Some(changed_at) }
            }
            None => Checklist { items: SHIPPED.map(str::to_owned).into(), changed_at: None },
        })
    }

    /// Replaces the checklist, for everyone.
    ///
    /// # Errors
    /// `Invalid`: an item, too many, or the same twice; `Unavailable` if opened read-only.
    pub async fn change_checklist(&self, new: &NewChecklist) -> Result<Checklist> {
        let mut check = Check::default();
        check_items(&mut check, "items", &new.items);
        check.done()?;
        let mut tx = self.store().write().await?;
        tx.change_checklist(&new.items).await?;
        tx.commit().await?;
        self.checklist().await
    }
}

/// Checks the items of a checklist, or what was confirmed of one.
pub(super) fn check_items(check: &mut Check, field: &str, items: &[String]) {
    if items.len() > ITEMS_MAX {
        check.refuse(field, format!("must be at most {ITEMS_MAX} items, got {}", items.len()));
    }
    for (k, item) in items.iter().enumerate().take(ITEMS_MAX) {
        check.text(&format!("{field}[{k}]"), item, 200);
        if items[..k].contains(item) {
            check.refuse(&format!("{field}[{k}]"), "is there already: name it once");
        }
    }
}
