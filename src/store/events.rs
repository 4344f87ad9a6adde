//! What has happened, in order: the source of every live view.

use crate::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};

/// Something that happened to a job or a weighing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Event {
    /// Position in the order of all events; the `id:` of a server-sent event.
    pub seq: i64,
    /// `job:<id>` or `weighing:<id>`.
    pub topic: String,
    /// `state`, `progress`, `trial` or `episode` of a job; `state` or `tick` of a weighing.
    pub kind: String,
    /// What happened; the fields depend on the kind.
    #[schema(value_type = Object)]
    pub data: serde_json::Value,
    /// When.
    pub at: Timestamp,
}
