//! Who does something, for the record: known to the task that does it, and written where a person's deed is.
//!
//! The layer that knows a caller runs its work within [`acting`]. What nobody asked for, such as the bench's own work, has nobody.

use super::tokens::Role;
use serde::{Deserialize, Serialize};

/// Who does something.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Who {
    /// The token's name, `command line` or `anonymous`.
    pub name: String,
    /// The token's id.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub token: Option<String>,
    /// The token's role.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub role: Option<Role>,
}

impl Who {
    /// Whoever has a shell on this machine.
    pub fn command_line() -> Self {
        Self { name: "command line".to_owned(), token: None, role: None }
    }

    /// Whoever calls without a token.
    pub fn anonymous() -> Self {
        Self { name: "anonymous".to_owned(), token: None, role: None }
    }

    /// Who the present task works for: take it along where work goes on in another.
    pub fn now() -> Option<Self> {
        WHO.try_with(Clone::clone).ok()
    }
}

tokio::task_local! {
    static WHO: Who;
}

/// Do this on behalf of somebody.
pub async fn acting<T>(who: Who, work: impl Future<Output = T>) -> T {
    WHO.scope(who, work).await
}

/// Do this on behalf of whoever it was begun for elsewhere, if anybody.
pub async fn acting_maybe<T>(who: Option<Who>, work: impl Future<Output = T>) -> T {
    match who {
        Some(who) => acting(who, work).await,
        None => work.await,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_task_works_for_whoever_it_was_begun_for_and_for_nobody_afterwards() {
        assert_eq!(Who::now(), None);
        assert_eq!(acting(Who::command_line(), async { Who::now() }).await, Some(Who::command_line()));
        assert_eq!(Who::now(), None);
    }
}
