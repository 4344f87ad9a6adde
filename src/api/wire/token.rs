//! Tokens.

use super::Timestamp;
use crate::app;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A token to create.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewToken {
    /// Holder of the token, for the record.
    pub name: String,
    /// What the holder may do.
    pub role: Role,
    /// Whether the holder may clear a latched bench; an admin always may.
    #[serde(default)]
    pub may_clear: bool,
    /// Seconds until it expires; default never.
    #[serde(default, alias = "expires_in")]
    pub expires_in_s: Option<u64>,
}

request! { NewToken => app::NewToken { name, role, may_clear, expires_in_s } }

/// Permissions of a token's holder; each role includes the ones before it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Read.
    Viewer,
    /// Start and stop jobs and weighings, add powders.
    Operator,
    /// Everything.
    Admin,
}

answer! { flip_store::tokens::Role => enum Role { Viewer, Operator, Admin } }
request! { enum Role => flip_store::tokens::Role { Viewer, Operator, Admin } }

/// Metadata of a token; never its secret.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct TokenEntry {
    /// Id: the first part of the secret, used in records.
    pub id: String,
    /// Who holds it.
    pub name: String,
    /// Role of its holder.
    pub role: Role,
    /// Whether its holder may clear a latched bench; an admin always may.
    pub may_clear: bool,
    /// When it was created.
    pub created_at: Timestamp,
    /// When it expires; absent if it does not.
    pub expires_at: Option<Timestamp>,
    /// When a person revoked it.
    pub revoked_at: Option<Timestamp>,
    /// When it was last used, to about a minute; absent if it never was.
    pub last_used_at: Option<Timestamp>,
}

answer! { flip_store::tokens::TokenEntry => TokenEntry {
    id, name, role, may_clear, created_at, expires_at, revoked_at, last_used_at,
} }
