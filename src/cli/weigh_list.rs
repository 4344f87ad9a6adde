//! `flip weigh --list`: the doses of a table, one after another.
//!
//! The key of a list is made from its name and its table: the same command again finds the list,
//! goes on with what waits, and pours nothing twice.

use super::Common;
use super::failure::Failure;
use super::lab::Lab;
use super::measurements::read;
use super::session::with_bench;
use super::table::table;
use super::weigh::{Arguments, OFTEN};
use crate::app::{Asked, DoseListRequest, Tolerance, VialCheck, VialReadyRequest, Weighing};
use crate::telemetry;
use flip_core::domain::FieldError;
use flip_core::domain::weighing::{Outcome, WeighingState};
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::io::{BufRead, IsTerminal};
use std::path::Path;

/// The document of `flip weigh --list`.
#[derive(Debug, Serialize)]
struct Document {
    name: String,
    doses: Vec<Dose>,
}

/// A dose of the list, and how it ended.
#[derive(Debug, Serialize)]
struct Dose {
    weighing: String,
    powder: String,
    #[serde(skip_serializing_if = "Asked::is_nothing")]
    asked: Asked,
    target_mg: f64,
    tolerance_lower_mg: f64,
    tolerance_upper_mg: f64,
    state: WeighingState,
    outcome: Option<Outcome>,
    net_mg: Option<f64>,
    uncertainty_mg: Option<f64>,
    error_mg: Option<f64>,
    error: Option<String>,
}

/// Weighs the doses of a table, and prints how each ended.
pub(super) fn run(common: &Common, arguments: &Arguments, file: &Path) -> Result<(), Failure> {
    let stem = || file.file_stem().map(|stem| stem.to_string_lossy().into_owned());
    let name = arguments.name.clone().or_else(stem).unwrap_or_default();
    let request = request(arguments, &name, read("list", file)?)?;
    let table = request.table.as_deref().unwrap_or_default();
    let key = format!("flip-weigh-{}", hex::encode(Sha256::digest(format!("{name}\n{table}"))));
    let (doses, stopped) = with_bench(common, &arguments.bench, async |lab| {
        let exchanges = lab.bench().await?.exchanges_vials == Some(true);
        if !exchanges && !std::io::stdin().is_terminal() {
            let advice = "someone has to change the vials of this bench: run it in a terminal, or send the list to `flip serve` and confirm each vial on the page";
            return Err(FieldError::new("list", advice).into());
        }
        let (list, before) = lab.start_dose_list(request, &key).await?;
        if before {
            telemetry::say(format_args!(
                "flip: list `{name}` was begun before and goes on; with another --name it is weighed anew"
            ));
        }
        let ids: Vec<String> = list.doses.into_iter().filter_map(|dose| dose.weighing).collect();
        weighed(lab, &ids).await
    })?;
    let document = Document { name, doses };
    common.print(&document, || text(&document.doses))?;
    stopped.map_or(Ok(()), |why| Err(Failure::Found(why)))
}

fn request(
    arguments: &Arguments,
    name: &str,
    table: String,
) -> Result<DoseListRequest, FieldError> {
    let mg = arguments.tolerance_mg;
    Ok(DoseListRequest {
        name: name.to_owned(),
        doses: Vec::new(),
        table: Some(table),
        tolerance: Some(Tolerance { lower: mg, upper: mg, unit: "mg".into() }),
        operator: arguments.operator.clone(),
        checked: Vec::new(),
        policy: arguments.policy.clone(),
        vial_check: VialCheck::Confirm,
        reservation: None,
        labels: arguments.labels.all()?,
        check: false,
    })
}

/// The doses once all have ended, or as they are once the bench stands, and why it stands.
async fn weighed(lab: &Lab, ids: &[String]) -> Result<(Vec<Dose>, Option<String>), Failure> {
    let mut stopped = None;
    for (k, id) in ids.iter().enumerate() {
        let place = format!("dose {} of {}", k + 1, ids.len());
        stopped = ended(lab, id, &place).await?;
        if let Some(why) = &mut stopped {
            why.push_str(&format!(
                "; {} of {} doses wait: the same command again goes on with them",
                ids.len() - k,
                ids.len()
            ));
            break;
        }
    }
    let mut doses = Vec::new();
    for id in ids {
        doses.push(Dose::of(lab.weighing(id).await?.weighing));
    }
    Ok((doses, stopped))
}

/// Waits until a dose has ended; asks for its vial if the bench waits for it. Returns why it cannot
/// go on.
async fn ended(lab: &Lab, id: &str, place: &str) -> Result<Option<String>, Failure> {
    let mut asked = false;
    let mut weighing = lab.weighing(id).await?.weighing;
    loop {
        match weighing.state {
            WeighingState::Done => {
                telemetry::say(format_args!("{place}: {}", line(&weighing)));
                lab.has_ended(id);
                return Ok(None);
            }
            WeighingState::Aborted | WeighingState::Unknown => {
                telemetry::say(format_args!("{place}: {}", line(&weighing)));
                // The bench is latched if something has to be looked at; a stopped dose latches nothing.
            }
            WeighingState::AwaitingVial if !asked => {
                vial_is_in(lab, &weighing, place).await?;
                asked = true;
            }
            _ => {}
        }
        if let Some(why) = stands(lab).await? {
            return Ok(Some(why));
        }
        if weighing.outcome.is_some() {
            lab.has_ended(id);
            return Ok(None);
        }
        weighing = lab.weighing_later(id, OFTEN).await?.weighing;
    }
}

/// Why the bench starts nothing.
pub(super) async fn stands(lab: &Lab) -> Result<Option<String>, Failure> {
    let bench = lab.bench().await?;
    let latched = bench.latch.map(|it| {
        format!("the bench is latched: {}. Look at it, then `flip bench clear`", it.reason)
    });
    let held = bench
        .held
        .map(|it| format!("the bench is held: {}. `flip bench resume` lets it go on", it.reason));
    Ok(latched.or(held))
}

/// Asks at the terminal for the vial of a dose.
async fn vial_is_in(lab: &Lab, weighing: &Weighing, place: &str) -> Result<(), Failure> {
    let asked = &weighing.asked;
    let vial = asked.vial.as_ref().map_or("an empty vial".to_owned(), |it| format!("vial {it}"));
    let position = asked.position.as_ref().map_or_else(String::new, |it| format!(" (from {it})"));
    telemetry::say(format_args!(
        "{place}: put {vial}{position} on the balance for {} mg of {}, then press Enter",
        weighing.target_mg, weighing.powder
    ));
    let typed =
        tokio::task::spawn_blocking(|| std::io::stdin().lock().read_line(&mut String::new()));
    match typed.await {
        Ok(Ok(1..)) => {}
        _ => return Err(Failure::NotNow("nobody confirmed the vial; the doses wait".to_owned())),
    }
    let ready = VialReadyRequest { by: asked.operator.clone(), vial: asked.vial.clone() };
    lab.vial_ready(&weighing.id, ready).await?;
    Ok(())
}

impl Dose {
    fn of(weighing: Weighing) -> Self {
        let measured = weighing.measured;
        Self {
            weighing: weighing.id,
            powder: weighing.powder,
            asked: weighing.asked,
            target_mg: weighing.target_mg,
            tolerance_lower_mg: weighing.tolerance_lower_mg,
            tolerance_upper_mg: weighing.tolerance_upper_mg,
            state: weighing.state,
            outcome: weighing.outcome,
            net_mg: measured.as_ref().map(|it| it.net_mg).or(weighing.reading_mg),
            uncertainty_mg: measured.map(|it| it.uncertainty_mg),
            error_mg: weighing.error_mg,
            error: weighing.error,
        }
    }
}

/// How a dose ended, in a line.
fn line(weighing: &Weighing) -> String {
    let dose = Dose::of(weighing.clone());
    let why = dose.error.as_deref().map_or_else(String::new, |why| format!(": {why}"));
    format!("{} of {}, {}{why}", net(&dose), dose.powder, outcome(&dose))
}

fn net(dose: &Dose) -> String {
    let net = dose.net_mg.map_or_else(|| "-".to_owned(), |mg| format!("{mg:.2} mg"));
    dose.uncertainty_mg.map_or(net.clone(), |u| format!("{net} +- {u:.2}"))
}

fn outcome(dose: &Dose) -> String {
    let word = dose.outcome.map(|it| serde_json::json!(it)).or(Some(serde_json::json!(dose.state)));
    word.as_ref().and_then(|it| it.as_str()).unwrap_or_default().replace('_', " ")
}

fn text(doses: &[Dose]) -> String {
    let word = |text: &Option<String>| text.clone().unwrap_or_else(|| "-".to_owned());
    let row = |dose: &Dose| {
        let error = dose.error_mg.map_or_else(|| "-".to_owned(), |mg| format!("{mg:+.2}"));
        vec![
            word(&dose.asked.position),
            word(&dose.asked.vial),
            dose.powder.clone(),
            word(&dose.asked.lot),
            format!("{:.2}", dose.target_mg),
            net(dose),
            error,
            outcome(dose),
        ]
    };
    let header = ["position", "vial", "powder", "lot", "target mg", "net", "error mg", "outcome"];
    let rows: Vec<_> = doses.iter().map(row).collect();
    let within = doses.iter().filter(|dose| dose.outcome == Some(Outcome::Within)).count();
    format!("{}\n{within} of {} within tolerance", table(&header, &rows), doses.len())
}
