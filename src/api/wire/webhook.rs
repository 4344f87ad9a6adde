//! Webhooks.

use super::Timestamp;
use crate::app;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// An address to tell of ends.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewWebhook {
    /// Where messages go, http or https.
    #[schema(examples("https://lims.lab.example/flip"))]
    pub url: String,
}

request! { NewWebhook => app::NewWebhook { url } }

/// An address that is told of ends.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Webhook {
    /// Id: `wh-…`.
    pub id: String,
    /// Where messages go.
    pub url: String,
    /// When it was added.
    pub created_at: Timestamp,
    /// Since when messages fail; absent while they arrive.
    pub failing_since: Option<Timestamp>,
    /// Why the last message failed.
    pub error: Option<String>,
}

answer! { app::Webhook => Webhook { id, url, created_at, failing_since, error } }
