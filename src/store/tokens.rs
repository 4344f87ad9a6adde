//! API tokens: only their hashes are stored.

use serde::{Deserialize, Serialize};

/// What the holder of a token may do; each role may do what the ones before it may.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Read.
    Viewer,
    /// Start and stop jobs and weighings, add powders.
    Operator,
    /// Everything.
    Admin,
}
