//! The caller of an action, for the record: known to the task that carries it out, and written with
//! the record of a person's action.
//!
//! The layer that knows a caller runs its work within [`acting`]. Work that nobody requested, such
//! as the bench's own, has no caller.

use super::tokens::Role;
use serde::{Deserialize, Serialize};

/// The caller of an action.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
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
    /// A user with a shell on this machine.
    pub fn command_line() -> Self {
        Self { name: "command line".to_owned(), token: None, role: None }
    }

    /// A caller without a token.
    pub fn anonymous() -> Self {
        Self { name: "anonymous".to_owned(), token: None, role: None }
    }

    /// The caller of the present task: pass it along where work continues in another task.
    pub fn now() -> Option<Self> {
        WHO.try_with(Clone::clone).ok()
    }
}

tokio::task_local! {
    static WHO: Who;
    static CORRELATION_ID: String;
}

/// Run this work for a request that its caller knows by this id.
pub async fn correlated<T>(id: Option<String>, work: impl Future<Output = T>) -> T {
    match id {
        Some(id) => CORRELATION_ID.scope(id, work).await,
        None => work.await,
    }
}

/// The caller's own id of the request that the present task works for.
pub fn correlation_id() -> Option<String> {
    CORRELATION_ID.try_with(Clone::clone).ok()
}

/// Run this work on behalf of `who`.
pub async fn acting<T>(who: Who, work: impl Future<Output = T>) -> T {
    WHO.scope(who, work).await
}

/// Run this work on behalf of the caller it was started for elsewhere, if any.
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
        assert_eq!(
            acting(Who::command_line(), async { Who::now() }).await,
            Some(Who::command_line())
        );
        assert_eq!(Who::now(), None);
    }
}
