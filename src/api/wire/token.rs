//! Tokens.

use super::Timestamp;
use crate::api::auth;
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
    /// Provider that the holder logged in with; absent for a token that somebody created.
    pub issuer: Option<String>,
    /// The provider's own name for the holder, which no two people share.
    pub subject: Option<String>,
}

answer! { flip_store::tokens::TokenEntry => TokenEntry {
    id, name, role, may_clear, created_at, expires_at, revoked_at, last_used_at, issuer,
    subject,
} }

/// Who a caller is, and what the caller may do.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Identity {
    /// Id of the token; absent without one.
    pub token: Option<String>,
    /// Its holder.
    pub name: Option<String>,
    /// What the caller may do: without a token, on the service's own computer, read.
    pub role: Role,
    /// Whether the caller may clear a latched bench.
    pub may_clear: bool,
    /// When the token expires; absent if it does not.
    pub expires_at: Option<Timestamp>,
    /// Provider that the holder logged in with; absent for a token that somebody created.
    pub issuer: Option<String>,
}

answer! { auth::Identity => Identity { token, name, role, may_clear, expires_at, issuer } }

/// Where people can log in.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LogInOffer {
    /// Host of the lab's provider of log-ins; absent if this service has none.
    pub provider: Option<String>,
}

/// The first half of a log-in.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct BegunLogIn {
    /// Page of the provider to open in a browser.
    pub url: String,
    /// The provider returns it with its code.
    pub state: String,
    /// Needed to finish; to be kept by whoever began.
    pub secret: String,
}

answer! { app::BegunLogIn => BegunLogIn { url, state, secret } }

/// The second half of a log-in.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LogInAnswer {
    /// As returned by the provider.
    pub state: String,
    /// As returned by the provider.
    pub code: String,
    /// As given when it began.
    pub secret: String,
}

request! { LogInAnswer => app::LogInAnswer { state, code, secret } }
