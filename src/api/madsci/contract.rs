//! The messages of MADSci's REST nodes, as its clients read them (`madsci.common` 0.8).

use crate::api::problem::Problem;
use crate::app::Timestamp;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;

/// Where an action stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ActionStatus {
    /// It was created.
    NotStarted,
    /// It was refused for now: too many wait for the bench.
    NotReady,
    /// It waits or moves.
    Running,
    /// A dose within its tolerance, a job with a result.
    Succeeded,
    /// Everything else that is not a stop.
    Failed,
    /// Somebody stopped it.
    Cancelled,
}

/// What went wrong.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Trouble {
    /// In words.
    pub message: String,
    /// Its kind: an outcome such as `over`, or that of a problem such as `calibration-missing`.
    pub error_type: String,
}

impl Trouble {
    /// A problem, as MADSci tells it.
    pub fn of(problem: &Problem) -> Self {
        let kind = problem.kind.rsplit(':').next().unwrap_or_default();
        Self { message: problem.detail.clone(), error_type: kind.to_owned() }
    }
}

/// An action and what came of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ActionResult {
    pub action_id: String,
    pub status: ActionStatus,
    pub errors: Vec<Trouble>,
    /// The weighing, the measurement or the calibration, as REST gives it.
    pub json_result: Option<Value>,
    /// Keys of its files.
    pub files: Option<Vec<&'static str>>,
    pub history_created_at: Timestamp,
}

/// What a node is.
#[derive(Debug, Serialize)]
pub struct NodeInfo {
    pub node_name: &'static str,
    pub node_id: String,
    pub node_description: &'static str,
    pub node_type: &'static str,
    pub module_name: &'static str,
    pub module_version: &'static str,
    pub capabilities: Capabilities,
    pub actions: BTreeMap<&'static str, ActionDefinition>,
    pub config: Option<Value>,
    pub config_schema: Value,
}

/// What a node can do.
#[derive(Debug, Serialize)]
pub struct Capabilities {
    pub get_info: bool,
    pub get_state: bool,
    pub get_status: bool,
    pub send_action: bool,
    pub get_action_status: bool,
    pub get_action_result: bool,
    pub get_action_history: bool,
    pub action_files: bool,
    pub send_admin_commands: bool,
    pub set_config: bool,
    pub get_log: bool,
    pub admin_commands: [&'static str; 6],
}

/// An action of a node.
#[derive(Debug, Serialize)]
pub struct ActionDefinition {
    pub name: &'static str,
    pub description: &'static str,
    pub args: Vec<Argument>,
    pub results: Vec<ResultDefinition>,
    pub blocking: bool,
    pub asynchronous: bool,
}

/// An argument of an action.
#[derive(Debug, Serialize)]
pub struct Argument {
    pub name: &'static str,
    pub description: &'static str,
    pub argument_type: &'static str,
    pub required: bool,
    pub default: Option<Value>,
}

/// A result of an action.
#[derive(Debug, Serialize)]
pub struct ResultDefinition {
    pub result_label: &'static str,
    pub description: &'static str,
    pub result_type: &'static str,
}

/// Whether a node can take an action.
#[derive(Debug, Default, PartialEq, Serialize)]
pub struct NodeStatus {
    /// A dose or a pile moves, or waits.
    pub busy: bool,
    pub running_actions: Vec<String>,
    pub paused: bool,
    /// The bench is reserved.
    pub locked: bool,
    /// The bench is held after a stop.
    pub stopped: bool,
    /// The bench is latched.
    pub errored: bool,
    pub errors: Vec<Trouble>,
}

/// The answer to a command of an administrator.
#[derive(Debug, Serialize)]
pub struct CommandAnswer {
    pub success: bool,
    pub errors: Vec<Trouble>,
    pub data: Option<Value>,
}
