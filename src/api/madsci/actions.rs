//! The actions: what they take, what they ask of the application, and what came of them.

use super::contract::{
    ActionDefinition, ActionResult, ActionStatus, Argument, ResultDefinition, Trouble,
};
use crate::api::auth::Caller;
use crate::api::problem::Problem;
use crate::api::rest::extract::parse;
use crate::api::wire::{Answer, Request};
use crate::api::wire::{CalibrationRequest, ClearRequest, ReposeRequest};
use crate::app::{self, App, Asked, Fate, JobKind, JobState, NodeAction, VialCheck};
use flip_core::domain::weighing::Outcome;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;

const DOSE: &str = "dose_powder";
const REPOSE: &str = "measure_repose";
const CALIBRATE: &str = "calibrate";
const CLEAR: &str = "clear_latch";

/// Keys of the files of a dose.
pub const CERTIFICATE: &str = "certificate";
/// See [`CERTIFICATE`].
pub const TRACE: &str = "trace";

/// Arguments of `dose_powder`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Dose {
    powder: String,
    target_mg: f64,
    #[serde(default)]
    tolerance_mg: Option<f64>,
    #[serde(default)]
    tolerance_lower_mg: Option<f64>,
    #[serde(default)]
    tolerance_upper_mg: Option<f64>,
    #[serde(default)]
    vial: Option<String>,
    #[serde(default)]
    position: Option<String>,
    #[serde(default)]
    lot: Option<String>,
    #[serde(default)]
    operator: Option<String>,
    #[serde(default)]
    policy: Option<String>,
    #[serde(default)]
    reservation: Option<String>,
    #[serde(default)]
    vial_in_place: bool,
}

/// Tolerance where none is given, mg.
const TOLERANCE_MG: f64 = 1.0;

impl Dose {
    fn request(self) -> app::WeighingRequest {
        let either = self.tolerance_mg.unwrap_or(TOLERANCE_MG);
        let unit = || "mg".to_owned();
        app::WeighingRequest {
            powder: self.powder,
            target: app::Target { value: self.target_mg, unit: unit() },
            tolerance: app::Tolerance {
                lower: self.tolerance_lower_mg.unwrap_or(either),
                upper: self.tolerance_upper_mg.unwrap_or(either),
                unit: unit(),
            },
            policy: self.policy,
            seed: None,
            simulator: None,
            conditions: BTreeMap::new(),
            asked: Asked {
                vial: self.vial,
                position: self.position,
                lot: self.lot,
                operator: self.operator,
                ..Asked::default()
            },
            vial_check: if self.vial_in_place { VialCheck::Skip } else { VialCheck::Confirm },
            reservation: self.reservation,
            bench_name: None,
            labels: app::Labels::default(),
        }
    }
}

/// What an action asks for.
enum Asks {
    Dose(app::WeighingRequest),
    Repose(app::ReposeRequest),
    Calibration(app::CalibrationRequest),
    Clear(app::ClearRequest),
}

/// Reads the arguments of an action.
///
/// # Errors
/// 404 for an unknown action, 400 for arguments that it does not take.
fn read(name: &str, args: &Value) -> Result<Asks, Problem> {
    let text = args.to_string();
    let text = text.as_bytes();
    Ok(match name {
        DOSE => Asks::Dose(parse::<Dose>(text)?.request()),
        REPOSE => Asks::Repose(parse::<ReposeRequest>(text)?.means()),
        CALIBRATE => Asks::Calibration(parse::<CalibrationRequest>(text)?.means()),
        CLEAR => Asks::Clear(parse::<ClearRequest>(text)?.means()),
        _ => {
            let actions = [DOSE, REPOSE, CALIBRATE, CLEAR].join(", ");
            return Err(Problem::not_found(format!(
                "there is no action `{name}`: the actions are {actions}"
            )));
        }
    })
}

/// Checks that an action exists and takes these arguments.
///
/// # Errors
/// As [`read`].
pub fn check(name: &str, args: &Value) -> Result<(), Problem> {
    read(name, args).map(drop)
}

/// Starts an action, unless it was started before. What the application refuses is the fate of the
/// action; what it cannot do now is an error, and the action may be started again.
pub async fn start(app: &App, caller: &Caller, action: &NodeAction) -> Result<(), Problem> {
    let made = match read(&action.name, &action.args)? {
        // Its own id is the key, so that a repeated start pours once.
        Asks::Dose(request) => {
            let key = format!("madsci-{}", action.id);
            app.start_weighing(request, &key).await.map(|(weighing, _)| weighing.id)
        }
        Asks::Repose(request) => app.start_repose(request).await.map(|(job, _)| job.id),
        Asks::Calibration(request) => app.start_calibration(request).await.map(|(job, _)| job.id),
        Asks::Clear(request) => {
            caller.require_clearer()?;
            app.clear_bench(request).await.map(|_| action.id.clone())
        }
    };
    let fate = match made {
        Ok(id) => Fate::Made(id),
        Err(error) => {
            let problem = Problem::from(error);
            if problem.status >= 500 || problem.kind.ends_with("queue-full") {
                return Err(problem);
            }
            Fate::Refused(json!(Trouble::of(&problem)))
        }
    };
    Ok(app.node_action_became(&action.id, &fate).await?)
}

/// What came of an action so far.
pub async fn result(app: &App, action: &NodeAction) -> Result<ActionResult, Problem> {
    let bare = |status, errors| ActionResult {
        action_id: action.id.clone(),
        status,
        errors,
        json_result: None,
        files: None,
        history_created_at: action.created_at,
    };
    match &action.fate {
        Fate::Created => Ok(bare(ActionStatus::NotStarted, Vec::new())),
        Fate::Refused(trouble) => {
            let text = |key: &str| trouble[key].as_str().unwrap_or_default().to_owned();
            let trouble = Trouble { message: text("message"), error_type: text("error_type") };
            Ok(bare(ActionStatus::Failed, vec![trouble]))
        }
        Fate::Made(id) => match action.name.as_str() {
            DOSE => {
                let weighing = app.weighing(id).await?.weighing;
                let (status, errors) = of_dose(&weighing);
                let files = weighing.outcome.map(|_| vec![CERTIFICATE, TRACE]);
                Ok(ActionResult {
                    json_result: Some(json!(weighing.wire())),
                    files,
                    ..bare(status, errors)
                })
            }
            CLEAR => {
                let bench = json!(app.bench().await?.wire());
                Ok(ActionResult {
                    json_result: Some(bench),
                    ..bare(ActionStatus::Succeeded, Vec::new())
                })
            }
            _ => {
                let job = app.job(id).await?;
                let (status, errors) = of_job(&job);
                let found = match job.kind {
                    JobKind::Calibration => json!(app.calibration(id).await?.wire()),
                    _ => json!(app.repose(id).await?.wire()),
                };
                Ok(ActionResult { json_result: Some(found), ..bare(status, errors) })
            }
        },
    }
}

/// MADSci knows success, failure and a stop; the outcome itself is the type of the error.
fn of_dose(weighing: &app::Weighing) -> (ActionStatus, Vec<Trouble>) {
    let Some(outcome) = weighing.outcome else { return (ActionStatus::Running, Vec::new()) };
    let failed = |error_type: &str, message: String| {
        (ActionStatus::Failed, vec![Trouble { message, error_type: error_type.to_owned() }])
    };
    let off = || {
        let (target, error) = (weighing.target_mg, weighing.error_mg.unwrap_or_default());
        format!(
            "the dose is {error:+.2} mg from its target of {target} mg, which is more than its tolerance"
        )
    };
    let why = |otherwise: &str| weighing.error.clone().unwrap_or_else(|| otherwise.to_owned());
    match outcome {
        Outcome::Within | Outcome::Probed => (ActionStatus::Succeeded, Vec::new()),
        Outcome::Stopped => (ActionStatus::Cancelled, Vec::new()),
        Outcome::Under => failed("under", off()),
        Outcome::Over => failed("over", off()),
        Outcome::NotStable => {
            failed("not_stable", why("the balance did not settle: its display is not a valid mass"))
        }
        Outcome::Blocked => failed("blocked", why("no more powder leaves the spoon")),
        Outcome::Aborted => {
            failed("aborted", why("a device failed, or the guard refused to go on"))
        }
        Outcome::Unknown => {
            failed("unknown", why("FLIP ended during the dose: a person must look at the bench"))
        }
    }
}

fn of_job(job: &app::Job) -> (ActionStatus, Vec<Trouble>) {
    let failed = || {
        let message = job.error.clone().unwrap_or_default();
        vec![Trouble { message, error_type: "failed".to_owned() }]
    };
    match job.state {
        JobState::Queued | JobState::Running => (ActionStatus::Running, Vec::new()),
        JobState::Succeeded => (ActionStatus::Succeeded, Vec::new()),
        JobState::Failed => (ActionStatus::Failed, failed()),
        JobState::Cancelled => (ActionStatus::Cancelled, Vec::new()),
    }
}

/// The actions, as a workcell reads them.
pub fn definitions() -> BTreeMap<&'static str, ActionDefinition> {
    let must = |name, argument_type, description| Argument {
        name,
        description,
        argument_type,
        required: true,
        default: None,
    };
    let may = |name, argument_type, description| Argument {
        required: false,
        ..must(name, argument_type, description)
    };
    let json = |description| ResultDefinition {
        result_label: "json_result",
        description,
        result_type: "json",
    };
    let file = |result_label, description| ResultDefinition {
        result_label,
        description,
        result_type: "file",
    };
    let define = |name, description, args, results| ActionDefinition {
        name,
        description,
        args,
        results,
        blocking: false,
        asynchronous: true,
    };
    let reservation =
        may("reservation", "str", "The bench reservation under which it is asked for, rs-…");
    let dose = vec![
        must("powder", "str", "Powder id"),
        must("target_mg", "float", "Target mass, mg"),
        Argument {
            default: Some(json!(TOLERANCE_MG)),
            ..may("tolerance_mg", "float", "Accepted error on either side, mg")
        },
        may("tolerance_lower_mg", "float", "Accepted shortfall, mg; default tolerance_mg"),
        may("tolerance_upper_mg", "float", "Accepted excess, mg; default tolerance_mg"),
        may("vial", "str", "Label of the vial"),
        may("position", "str", "Its place in a rack"),
        may("lot", "str", "Lot of the powder"),
        may("operator", "str", "Name of the operator"),
        may("policy", "str", "Policy id; default the best by evidence"),
        Argument {
            default: Some(json!(false)),
            ..may(
                "vial_in_place",
                "bool",
                "An empty vial is on the balance: no person is waited for, and it is not checked",
            )
        },
        reservation,
    ];
    let clear = vec![
        must("by", "str", "Name of the person who looked at the bench"),
        must("looked", "bool", "Spoon, vial and balance were looked at"),
        must("vial_ready", "bool", "The vial is empty or was exchanged"),
        may("note", "str", "What was found and done"),
        may("resume", "bool", "Waiting weighings may start at once"),
    ];
    let repose = vec![
        must("powder", "str", "Powder id"),
        may("run", "int", "Which measurement of this powder; default the next"),
        may("procedure", "dict", "How piles are made, as in POST /v1/repose-measurements"),
        may("rig", "dict", "The rig's dimensions"),
        may("limits", "dict", "What frames must show"),
        may("reservation", "str", "The bench reservation under which it is asked for, rs-…"),
    ];
    let calibrate = vec![
        must("powder", "str", "Powder id"),
        may("sets", "int", "Parameter sets to find; default 10"),
        may("method", "str", "emulator, sequential or published"),
        may("tolerance_deg", "float", "Accepted difference of the angles, degrees"),
        may("seed", "int", "Seed; further arguments as in POST /v1/calibrations"),
    ];
    [
        define(
            DOSE,
            "Weigh a dose of powder into the vial on the balance.",
            dose,
            vec![
                json("The weighing"),
                file(CERTIFICATE, "Its certificate, HTML"),
                file(TRACE, "Actions and balance readings, CSV"),
            ],
        ),
        define(
            REPOSE,
            "Measure the angle of repose by camera.",
            repose,
            vec![json("The measurement")],
        ),
        define(
            CALIBRATE,
            "Find simulated powders that pile alike.",
            calibrate,
            vec![json("The calibration")],
        ),
        define(
            CLEAR,
            "Clear a latched bench that a person has looked at.",
            clear,
            vec![json("The bench")],
        ),
    ]
    .into_iter()
    .map(|it| (it.name, it))
    .collect()
}
