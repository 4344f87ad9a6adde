//! `/madsci`: this installation as a node of a MADSci workcell.
//!
//! The contract is that of `madsci.node_module` 0.8, as its own client uses it: an action is created
//! with its arguments, started once, and asked about by its id. The id of a dose's action is its
//! idempotency key, because the client repeats a start that got no answer. MADSci can send only
//! HTTP Basic: the token is the password ([`super::auth`]).

mod actions;
mod contract;

use super::auth::{Caller, Operator, Viewer};
use super::problem::Problem;
use super::rest::extract::{Path, Query, parse};
use super::wire::Answer;
use crate::app::{
    self, App, AuditAsked, NodeAction, PageQuery, ReservationRequest, ResumeRequest, Who,
};
use actions::{CERTIFICATE, TRACE};
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{Extensions, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use contract::{
    ActionResult, ActionStatus, Capabilities, CommandAnswer, NodeInfo, NodeStatus, Trouble,
};
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::{Cursor, Write};
use ulid::Ulid;
use uuid::Uuid;
use zip::write::SimpleFileOptions;

/// Actions in the history.
const HISTORY: u32 = 200;
/// Records in the log.
const LOG: u32 = 50;
/// Duration of a lock, s: a day, the longest reservation.
const LOCK_S: u32 = 24 * 60 * 60;
/// How the owner of a lock's reservation begins.
const LOCKED_BY: &str = "MADSci, ";

/// The routes, except the stop.
pub fn router(app: App) -> Router {
    Router::new()
        .route("/madsci/info", get(info))
        .route("/madsci/state", get(state))
        .route("/madsci/status", get(status))
        .route("/madsci/log", get(log))
        .route("/madsci/config", post(config))
        .route("/madsci/admin/{command}", post(command))
        .route("/madsci/action", get(history))
        .route("/madsci/action/{name}", post(create))
        .route("/madsci/action/{id}/{what}", get(ask))
        .route("/madsci/action/{name}/{id}/start", post(start))
        .route("/madsci/action/{name}/{id}/{what}", get(ask_by_name))
        .with_state(app)
        .method_not_allowed_fallback(async || Problem::method_not_allowed())
}

/// The commands that stop, for the front end, which carries them out before everything else. On
/// Python 3.11 and later MADSci 0.8 writes a command as its enum prints it.
pub fn stop(app: App) -> Router {
    let names = ["safety_stop", "cancel", "AdminCommands.SAFETY_STOP", "AdminCommands.CANCEL"];
    let stops = names.into_iter().fold(Router::new(), |router, name| {
        router.route(&format!("/madsci/admin/{name}"), post(safety_stop))
    });
    stops.with_state(app)
}

async fn info(_: Viewer, State(app): State<App>) -> Result<Json<NodeInfo>, Problem> {
    Ok(Json(NodeInfo {
        node_name: "flip",
        node_id: ulid(app.installation())?,
        node_description: "Weighs powder by the milligram.",
        node_type: "device",
        module_name: "flip",
        module_version: env!("CARGO_PKG_VERSION"),
        capabilities: Capabilities {
            get_info: true,
            get_state: true,
            get_status: true,
            send_action: true,
            get_action_status: true,
            get_action_result: true,
            get_action_history: true,
            action_files: true,
            send_admin_commands: true,
            set_config: false,
            get_log: true,
            admin_commands: ["cancel", "lock", "reset", "resume", "safety_stop", "unlock"],
        },
        actions: actions::definitions(),
        config: None,
        config_schema: json!({}),
    }))
}

async fn state(_: Viewer, State(app): State<App>) -> Result<Json<Value>, Problem> {
    Ok(Json(json!({ "bench": app.bench().await?.wire() })))
}

async fn status(_: Viewer, State(app): State<App>) -> Result<Json<NodeStatus>, Problem> {
    let bench = app.bench().await?;
    let trouble = |message: &str, error_type: &str| Trouble {
        message: message.to_owned(),
        error_type: error_type.to_owned(),
    };
    let latched = bench.latch.iter().map(|latch| trouble(&latch.reason, "bench-latched"));
    let unwritten = bench.unwritten.iter().map(|it| trouble(&it.why, "ending-unwritten"));
    let errors: Vec<_> = latched.chain(unwritten).collect();
    Ok(Json(NodeStatus {
        busy: bench.moving.is_some() || bench.piling.is_some() || !bench.waiting.is_empty(),
        running_actions: app.running_node_actions().await?,
        paused: false,
        locked: bench.reservation.is_some(),
        stopped: bench.held.is_some(),
        errored: !errors.is_empty(),
        errors,
    }))
}

/// The newest records of the audit trail, by their number.
async fn log(_: Viewer, State(app): State<App>) -> Result<Json<BTreeMap<String, Value>>, Problem> {
    let found = app.audit(AuditAsked::default(), PageQuery::first(LOG)).await?;
    let event = |it: app::AuditRecord| {
        let event = json!({
            "event_id": it.seq.to_string(),
            "event_type": "log_info",
            "event_timestamp": it.at,
            "event_data": { "kind": it.kind, "weighing": it.weighing, "body": it.body },
        });
        (it.seq.to_string(), event)
    };
    Ok(Json(found.page.items.into_iter().map(event).collect()))
}

/// There is nothing to configure over this interface.
async fn config(_: Operator) -> Json<Value> {
    Json(json!({ "success": false }))
}

async fn safety_stop(_: Operator, State(app): State<App>) -> Result<Json<CommandAnswer>, Problem> {
    Ok(answer(app.stop_bench().await.map(|bench| Some(json!(bench.wire())))))
}

async fn command(
    _: Operator,
    State(app): State<App>,
    Path(command): Path<String>,
) -> Result<Json<CommandAnswer>, Problem> {
    let person = Who::now().map_or_else(|| "unknown".to_owned(), |who| who.name);
    let bench = app.bench().await?;
    let refused = |message: &str| {
        let trouble =
            Trouble { message: message.to_owned(), error_type: "not-supported".to_owned() };
        Ok(Json(CommandAnswer { success: false, errors: vec![trouble], data: None }))
    };
    // As `stop` says.
    let command = command.trim_start_matches("AdminCommands.").to_ascii_lowercase();
    match command.as_str() {
        "resume" | "reset" if bench.latch.is_some() => {
            refused("the bench is latched: a person looks at it, then sends the action clear_latch")
        }
        "reset" if bench.held.is_none() => {
            Ok(Json(CommandAnswer { success: true, errors: Vec::new(), data: None }))
        }
        "resume" | "reset" => {
            let request = ResumeRequest { by: person, note: "by a workcell (MADSci)".to_owned() };
            Ok(answer(app.resume_bench(request).await.map(|bench| Some(json!(bench.wire())))))
        }
        "lock" => {
            let owner = format!("{LOCKED_BY}{person}");
            let request = ReservationRequest { owner, seconds: LOCK_S, id: None };
            Ok(answer(app.reserve_bench(request).await.map(|it| Some(json!(it.wire())))))
        }
        "unlock" => match bench.reservation.filter(|it| it.owner.starts_with(LOCKED_BY)) {
            Some(reservation) => {
                Ok(answer(app.release_bench(&reservation.id).await.map(|()| None)))
            }
            None => refused("no workcell has locked this node"),
        },
        "shutdown" => refused("this service serves others too: stop it where it runs"),
        "pause" => refused("a dose cannot be paused: stop it"),
        _ => Err(Problem::not_found(format!(
            "there is no command `{command}`: the commands are cancel, lock, reset, resume, safety_stop, unlock"
        ))),
    }
}

fn answer(done: app::Result<Option<Value>>) -> Json<CommandAnswer> {
    Json(match done {
        Ok(data) => CommandAnswer { success: true, errors: Vec::new(), data },
        Err(error) => {
            let errors = vec![Trouble::of(&Problem::from(error))];
            CommandAnswer { success: false, errors, data: None }
        }
    })
}

/// The body of a creation.
#[derive(Deserialize)]
struct Creation {
    #[serde(default)]
    args: Option<Value>,
    #[serde(default)]
    var_args: Option<Vec<Value>>,
    #[serde(default)]
    var_kwargs: Option<serde_json::Map<String, Value>>,
}

async fn create(
    _: Operator,
    State(app): State<App>,
    Path(name): Path<String>,
    body: Bytes,
) -> Result<Json<Value>, Problem> {
    let Creation { args, var_args, var_kwargs } = parse(&body)?;
    if var_args.is_some_and(|it| !it.is_empty()) || var_kwargs.is_some_and(|it| !it.is_empty()) {
        return Err(Problem::malformed(
            "the actions take named arguments only: send them in `args`",
        ));
    }
    let args = args.filter(|args| !args.is_null()).unwrap_or_else(|| json!({}));
    actions::check(&name, &args)?;
    let id = Ulid::from(Uuid::now_v7().as_u128()).to_string();
    app.create_node_action(&id, &name, &args).await?;
    Ok(Json(json!({ "action_id": id })))
}

async fn start(
    _: Operator,
    State(app): State<App>,
    extensions: Extensions,
    Path((name, id)): Path<(String, String)>,
) -> Result<Json<ActionResult>, Problem> {
    let action = named(&app, &name, &id).await?;
    if action.fate == app::Fate::Created {
        match actions::start(&app, &Caller::of(&extensions), &action).await {
            Ok(()) => {}
            Err(problem) if problem.kind.ends_with("queue-full") => {
                let result = actions::result(&app, &action).await?;
                let errors = vec![Trouble::of(&problem)];
                return Ok(Json(ActionResult { status: ActionStatus::NotReady, errors, ..result }));
            }
            Err(problem) => return Err(problem),
        }
    }
    Ok(Json(actions::result(&app, &app.node_action(&id).await?).await?))
}

/// The action with this id, if it has this name.
async fn named(app: &App, name: &str, id: &str) -> Result<NodeAction, Problem> {
    let action = app.node_action(id).await?;
    match action.name == name {
        true => Ok(action),
        false => Err(Problem::not_found(format!("{id} is a {}, not a {name}", action.name))),
    }
}

async fn ask(
    _: Viewer,
    State(app): State<App>,
    Path((id, what)): Path<(String, String)>,
) -> Result<Response, Problem> {
    told(&app, &app.node_action(&id).await?, &what).await
}

async fn ask_by_name(
    _: Viewer,
    State(app): State<App>,
    Path((name, id, what)): Path<(String, String, String)>,
) -> Result<Response, Problem> {
    told(&app, &named(&app, &name, &id).await?, &what).await
}

async fn told(app: &App, action: &NodeAction, what: &str) -> Result<Response, Problem> {
    let result = actions::result(app, action).await?;
    match what {
        "status" => Ok(Json(result.status).into_response()),
        "result" => Ok(Json(result).into_response()),
        "download" => files(app, action, &result).await,
        _ => Err(Problem::not_found("an action has a status, a result and a download")),
    }
}

/// The files of an action, in a ZIP.
async fn files(app: &App, action: &NodeAction, result: &ActionResult) -> Result<Response, Problem> {
    let (app::Fate::Made(id), Some(_)) = (&action.fate, &result.files) else {
        return Err(Problem::not_found(format!("the action {} has no files", action.id)));
    };
    let certificate = app.certificate(id, None).await?;
    let trace = super::rest::trace_csv(&app.trace(id).await?);
    let packed =
        pack(&[(format!("{CERTIFICATE}.html"), certificate), (format!("{TRACE}.csv"), trace)]);
    let bytes = packed.map_err(|error| {
        tracing::error!(%error, "the files of an action could not be packed");
        Problem::internal()
    })?;
    let name = format!("attachment; filename=\"{}_files.zip\"", action.id);
    let headers =
        [(header::CONTENT_TYPE, "application/zip".to_owned()), (header::CONTENT_DISPOSITION, name)];
    Ok((headers, bytes).into_response())
}

fn pack(files: &[(String, String)]) -> zip::result::ZipResult<Vec<u8>> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let stored = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, text) in files {
        zip.start_file(name, stored)?;
        zip.write_all(text.as_bytes())?;
    }
    Ok(zip.finish()?.into_inner())
}

/// Which actions.
#[derive(Deserialize)]
struct HistoryParams {
    action_id: Option<String>,
}

/// Results by action, the newest 200 actions.
async fn history(
    _: Viewer,
    State(app): State<App>,
    Query(HistoryParams { action_id }): Query<HistoryParams>,
) -> Result<Json<BTreeMap<String, [ActionResult; 1]>>, Problem> {
    let actions = match action_id.filter(|id| !id.is_empty()) {
        Some(id) => vec![app.node_action(&id).await?],
        None => app.node_actions(HISTORY).await?,
    };
    let mut history = BTreeMap::new();
    for action in actions {
        let result = actions::result(&app, &action).await?;
        history.insert(action.id, [result]);
    }
    Ok(Json(history))
}

/// The ULID of the same 128 bits.
fn ulid(uuid: &str) -> Result<String, Problem> {
    let uuid: Uuid = uuid.parse().map_err(|_| Problem::internal())?;
    Ok(Ulid::from(uuid.as_u128()).to_string())
}
