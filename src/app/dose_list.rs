//! Lists of doses: checked row by row before anything is stored, then planned together or not at
//! all.
//!
//! A list is the weighings that name it (`asked.list`): they wait in their order like any others, so
//! that a stop, a latch, a hold or a restart does with them what it does with every dose.

use super::check::Check;
use super::csv_file::{Cells, Columns, Holds, REFUSALS_MAX, Refused, Table, at, within};
use super::retry::{check_key, replay, request_sha256};
use super::vials::refused;
use super::weighings::latched;
use super::{App, Error, Result, Target, Tolerance, WeighingRequest};
use crate::jobs::bench::WAITING_MAX;
use flip_core::domain::FieldError;
use flip_core::domain::labels::Labels;
use flip_core::domain::powder_name::{id_of_powder, same_name};
use flip_core::domain::vial::VialCheck;
use flip_core::domain::weighing::{Asked, WeighRequest};
use flip_store::weighings::{Intent, Weighing};
use flip_store::{new_id, now};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

/// Maximum length of a name, characters.
const NAME_MAX: usize = 200;
/// Maximum length of the key of a list: each dose has a key of its own made from it.
const KEY_MAX: usize = 200;
/// Most columns of a table.
const COLUMNS_MAX: usize = 60;
/// Largest mass in a table, mg; what the spoons hold is a tighter bound.
const MASS_MG_MAX: f64 = 1e9;
const NUMBERS: [&str; 7] = [
    "target_mg",
    "target_g",
    "tolerance_mg",
    "tolerance_pct",
    "tolerance_lower_mg",
    "tolerance_upper_mg",
    "repeats",
];
const WORDS: [&str; 5] = ["powder", "position", "vial", "lot", "operator"];

/// Doses that belong together.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DoseListRequest {
    /// Name of the list, a new one.
    pub name: String,
    /// Its doses, in order; or `table`.
    pub doses: Vec<WeighingRequest>,
    /// Its doses as a table with a header.
    pub table: Option<String>,
    /// Of rows of the table that give none; default 1 mg on either side.
    pub tolerance: Option<Tolerance>,
    /// Of rows of the table that give none.
    pub operator: Option<String>,
    /// What was confirmed before asking, for the rows of the table.
    pub checked: Vec<String>,
    /// Policy of the rows of the table.
    pub policy: Option<String>,
    /// For the rows of the table.
    pub vial_check: VialCheck,
    /// The bench reservation under which the table is requested, if any.
    pub reservation: Option<String>,
    /// What the caller writes on every dose, to find them again.
    pub labels: Labels,
    /// Whether it is only to be checked.
    pub check: bool,
}

/// A list of doses as it was understood.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct DoseList {
    /// Its name.
    pub name: String,
    /// Its doses, in the order in which they are weighed.
    pub doses: Vec<ListedDose>,
}

/// A dose of a list.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct ListedDose {
    /// Its weighing; `None` if the list was only checked.
    pub weighing: Option<String>,
    /// Powder id.
    pub powder: String,
    /// Target mass, mg.
    pub target_mg: f64,
    /// Accepted shortfall, mg.
    pub tolerance_lower_mg: f64,
    /// Accepted excess, mg.
    pub tolerance_upper_mg: f64,
    /// Policy id.
    pub policy: String,
    /// Lot, vial, operator and position.
    #[serde(default)]
    pub asked: Asked,
}

/// A dose, and where the request has it.
struct Line {
    /// `doses[2]`, or the row of the table.
    place: Place,
    request: WeighingRequest,
}

#[derive(Clone, Copy)]
enum Place {
    Dose(usize),
    Row(usize),
}

/// A checked dose.
struct Planned {
    reservation: Option<String>,
    request: WeighRequest,
    parameter_set: String,
}

impl Place {
    /// The error as the sender of the list sees it: under the row and column of a table.
    fn tell(self, error: FieldError) -> FieldError {
        let field = error.field;
        match self {
            Self::Dose(k) => FieldError::new(format!("doses[{k}].{field}"), error.message),
            Self::Row(row) => at(row, column_of(&field), error.message),
        }
    }
}

/// The column of a table that a field of a weighing comes from.
fn column_of(field: &str) -> &str {
    match field {
        "target.value" | "target.unit" => "target_mg",
        "tolerance.lower" => "tolerance_lower_mg",
        "tolerance.upper" | "tolerance.unit" => "tolerance_upper_mg",
        other => other.strip_prefix("asked.").unwrap_or(other),
    }
}

impl App {
    /// What a list of doses means, without storing it.
    ///
    /// # Errors
    /// `Invalid`: every wrong row, up to 50.
    pub async fn check_dose_list(&self, request: DoseListRequest) -> Result<DoseList> {
        let name = request.name.clone();
        let planned = self.plan_all(self.lines(request).await?).await?;
        let doses = planned.into_iter().map(|one| ListedDose::of(one.request)).collect();
        Ok(DoseList { name, doses })
    }

    /// Commits the intents to weigh all doses of a list; the bench moves later. `true`: the key was
    /// used before with the same request, and this is the list it created.
    ///
    /// # Errors
    /// `Invalid`: every wrong row, up to 50; `Unprocessable` (the key belongs to another request);
    /// `Busy` (more than 64 would wait); `Conflict` (`list_exists`, `bench_latched`, a reservation).
    pub async fn start_dose_list(
        &self,
        request: DoseListRequest,
        key: &str,
    ) -> Result<(DoseList, bool)> {
        check_key(key)?;
        if key.len() > KEY_MAX {
            let advice = format!("must be at most {KEY_MAX} characters for a list of doses");
            return Err(FieldError::new("Idempotency-Key", advice).into());
        }
        let name = request.name.clone();
        let lines = self.lines(request).await?;
        let keys: Vec<String> =
            (1..=lines.len()).map(|k| format!("{key}/{k}of{}", lines.len())).collect();
        let shas: Result<Vec<_>> = lines.iter().map(|line| request_sha256(&line.request)).collect();
        let shas = shas?;
        if let Some(list) = self.list_before(&name, &keys, &shas).await? {
            return Ok((list, true));
        }
        let mut reservations: Vec<_> =
            lines.iter().map(|line| line.request.reservation.as_deref()).collect();
        reservations.dedup();
        reservations.into_iter().try_for_each(|reserved| self.check_reservation(reserved))?;
        let doses = self.plan_all(lines).await?;
        let bench = self.jobs_or_refuse()?.bench();
        let mut tx = self.store().write().await?;
        if tx.weighing_by_key(&keys[0]).await?.is_some() {
            // The same request came twice at once.
            drop(tx);
            let list = self.list_before(&name, &keys, &shas).await?;
            let partial = || Error::Internal(format!("list `{name}` is stored in part").into());
            return Ok((list.ok_or_else(partial)?, true));
        }
        for dose in &doses {
            if let Some(why) = tx.may_use_bench(dose.reservation.as_deref(), now()).await? {
                return Err(refused(why));
            }
        }
        if tx.is_list(&name).await? {
            let advice =
                format!("there is a list `{name}` already: give this one a name of its own");
            return Err(Error::conflict("list_exists", advice));
        }
        if let Some(latch) = bench.standing().latch {
            return Err(latched(&latch));
        }
        let waiting = tx.planned_weighings().await?;
        if waiting + doses.len() as i64 > WAITING_MAX {
            let advice = format!(
                "{waiting} weighings are waiting for the bench, and at most {WAITING_MAX} may: send a list of {} doses or fewer, or try again when some are done",
                WAITING_MAX - waiting
            );
            return Err(Error::Busy(advice));
        }
        let mut planned = Vec::new();
        for ((idempotency_key, request_sha256), dose) in keys.into_iter().zip(shas).zip(doses) {
            let Planned { request, parameter_set, .. } = dose;
            let id = new_id();
            let intent = Intent { id, idempotency_key, request_sha256, request, parameter_set };
            planned.push(tx.insert_weighing(&intent, now()).await?);
        }
        tx.commit().await?;
        bench.planned().await;
        let doses = planned.into_iter().map(ListedDose::from).collect();
        Ok((DoseList { name, doses }, false))
    }

    /// The list that these keys created, if they did.
    async fn list_before(
        &self,
        name: &str,
        keys: &[String],
        shas: &[Vec<u8>],
    ) -> Result<Option<DoseList>> {
        let mut doses = Vec::new();
        for (key, sha256) in keys.iter().zip(shas) {
            let Some(first) = self.store().weighing_by_key(key).await? else { return Ok(None) };
            let (weighing, _) = replay(first, sha256, key)?;
            doses.push(ListedDose::from(weighing));
        }
        Ok(Some(DoseList { name: name.to_owned(), doses }))
    }

    /// The doses of a request, in order.
    async fn lines(&self, request: DoseListRequest) -> Result<Vec<Line>> {
        let mut check = Check::default();
        check.text("name", &request.name, NAME_MAX);
        if request.doses.is_empty() == request.table.is_none() {
            check.refuse("doses", "give either `doses` or a `table`, and at least one dose");
        }
        check.refusals().map_err(Error::Invalid)?;
        let name = request.name.clone();
        let mut lines = match &request.table {
            Some(table) => {
                let known = self.store().powder_names().await?;
                rows(table, &request, &known)?
            }
            None => request.doses.into_iter().enumerate().map(Line::of).collect(),
        };
        for line in &mut lines {
            for (key, value) in &request.labels.0 {
                line.request.labels.0.entry(key.clone()).or_insert_with(|| value.clone());
            }
            match &line.request.asked.list {
                Some(other) if *other != name => {
                    let advice = format!(
                        "must be `{name}`, the name of the list, or left out, got `{other}`"
                    );
                    check.keep::<()>(Err(line.place.tell(FieldError::new("asked.list", advice))));
                }
                _ => line.request.asked.list = Some(name.clone()),
            }
        }
        check.done()?;
        if lines.len() as i64 > WAITING_MAX {
            let advice = format!(
                "must have at most {WAITING_MAX} doses, got {}: split the list",
                lines.len()
            );
            return Err(FieldError::new("doses", advice).into());
        }
        check_vials(&lines)?;
        Ok(lines)
    }

    /// Every dose checked and with every choice made, or the errors of all.
    async fn plan_all(&self, lines: Vec<Line>) -> Result<Vec<Planned>> {
        let (mut doses, mut errors) = (Vec::new(), Vec::new());
        for Line { place, request } in lines {
            let reservation = request.reservation.clone();
            match self.plan_dose(request).await {
                Ok((request, parameter_set)) => {
                    doses.push(Planned { reservation, request, parameter_set });
                }
                Err(Error::Invalid(wrong)) => {
                    errors.extend(wrong.into_iter().map(|error| place.tell(error)));
                }
                // Of the powder: it is not calibrated.
                Err(Error::Conflict { message, .. }) => {
                    errors.push(place.tell(FieldError::new("powder", message)));
                }
                Err(other) => return Err(other),
            }
            if errors.len() >= REFUSALS_MAX {
                break;
            }
        }
        errors.truncate(REFUSALS_MAX);
        if errors.is_empty() { Ok(doses) } else { Err(Error::Invalid(errors)) }
    }
}

impl Line {
    fn of((k, request): (usize, WeighingRequest)) -> Self {
        Self { place: Place::Dose(k), request }
    }
}

/// Refuses a list that names a vial twice: it would be poured into twice.
fn check_vials(lines: &[Line]) -> Result<()> {
    let mut before: HashMap<(&str, &str), Place> = HashMap::new();
    let mut check = Check::default();
    for line in lines {
        let asked = &line.request.asked;
        for (field, value) in [("asked.vial", &asked.vial), ("asked.position", &asked.position)] {
            let Some(value) = value.as_deref() else { continue };
            if let Some(first) = before.insert((field, value), line.place) {
                let where_ = match first {
                    Place::Dose(k) => format!("doses[{k}]"),
                    Place::Row(row) => format!("row {row}"),
                };
                let advice = format!(
                    "is that of {where_} too, `{value}`: each dose needs a vial of its own"
                );
                check.keep::<()>(Err(line.place.tell(FieldError::new(field, advice))));
            }
        }
    }
    check.done()
}

/// The doses of a table.
fn rows(text: &str, request: &DoseListRequest, powders: &[(String, String)]) -> Result<Vec<Line>> {
    let columns = Columns { required: &["powder"], known, meant, most: COLUMNS_MAX };
    let table = Table::open(text, &columns, |names, check| {
        if !names.iter().any(|name| name == "target_mg" || name == "target_g") {
            check.refuse(
                "row[1]",
                "has no column `target_mg` or `target_g`: add one with the mass of each dose",
            );
        }
    })?;
    let mut lines = Vec::new();
    let errors = table.each(|cells| {
        let (one, times) = dose(cells, request, powders)?;
        let line = || Line { place: Place::Row(cells.row), request: one.clone() };
        lines.extend((0..times).map(|_| line()));
        Ok(())
    });
    if errors.is_empty() { Ok(lines) } else { Err(Error::Invalid(errors)) }
}

/// The dose of a row, and how often it is weighed.
fn dose(
    cells: &Cells<'_>,
    request: &DoseListRequest,
    powders: &[(String, String)],
) -> Refused<(WeighingRequest, u32)> {
    let row = cells.row;
    let mut check = Check::default();
    let mut number = |column: &str, most: f64, unit: &str| {
        let value = cells.holds(column).then(|| within(cells, column, 0.0, most, unit));
        value.and_then(|value| check.keep(value))
    };
    let target_mg = number("target_mg", MASS_MG_MAX, "mg");
    let target_g = number("target_g", MASS_MG_MAX, "g");
    let both_mg = number("tolerance_mg", MASS_MG_MAX, "mg");
    let both_pct = number("tolerance_pct", 100.0, "%");
    let (lower_mg, upper_mg) = (
        number("tolerance_lower_mg", MASS_MG_MAX, "mg"),
        number("tolerance_upper_mg", MASS_MG_MAX, "mg"),
    );
    let mg = |lower: f64, upper: f64| Tolerance { lower, upper, unit: "mg".to_owned() };
    let tolerance = match (both_mg, both_pct, lower_mg, upper_mg) {
        (Some(both), None, None, None) => mg(both, both),
        (None, Some(pct), None, None) => Tolerance { lower: pct, upper: pct, unit: "%".to_owned() },
        (None, None, Some(lower), Some(upper)) => mg(lower, upper),
        (None, None, None, None) => request.tolerance.clone().unwrap_or_else(|| mg(1.0, 1.0)),
        _ => {
            let advice = "give `tolerance_mg`, `tolerance_pct`, or both of `tolerance_lower_mg` and `tolerance_upper_mg`";
            check.keep::<()>(Err(at(row, "tolerance_mg", advice)));
            mg(1.0, 1.0)
        }
    };
    let target = match (target_mg, target_g) {
        (Some(value), None) => Target { value, unit: "mg".to_owned() },
        (None, Some(value)) => Target { value, unit: "g".to_owned() },
        _ => {
            // A cell that is no number is told above.
            if !["target_mg", "target_g"].iter().any(|column| cells.holds(column)) {
                check.keep::<()>(Err(at(row, "target_mg", "is missing")));
            } else if target_mg.is_some() {
                let advice = "give `target_mg` or `target_g`, not both";
                check.keep::<()>(Err(at(row, "target_g", advice)));
            }
            Target { value: f64::NAN, unit: "mg".to_owned() }
        }
    };
    let text = |column: &str| cells.holds(column).then(|| cells.text(column).to_owned());
    let powder = match text("powder") {
        None => check.keep(Err(at(row, "powder", "is missing"))),
        Some(text) => {
            let known = powders.iter().find(|(_, name)| same_name(name) == same_name(&text));
            let field = format!("row[{row}].powder");
            check.keep(known.map_or_else(|| id_of_powder(&field, &text), |(id, _)| Ok(id.clone())))
        }
    };
    let repeats = check.keep(cells.whole("repeats", "repeats")).flatten().unwrap_or(1);
    check.count(&format!("row[{row}].repeats"), repeats, 1, WAITING_MAX as u32);
    let asked = Asked {
        lot: text("lot"),
        vial: text("vial"),
        operator: text("operator").or_else(|| request.operator.clone()),
        position: text("position"),
        checked: request.checked.clone(),
        ..Asked::default()
    };
    if repeats > 1 && (asked.vial.is_some() || asked.position.is_some()) {
        let advice = "a row with a vial or a position is one dose: write a row for each vial";
        check.keep::<()>(Err(at(row, "repeats", advice)));
    }
    check.refusals()?;
    let dose = WeighingRequest {
        powder: powder.unwrap_or_default(),
        target,
        tolerance,
        policy: request.policy.clone(),
        seed: None,
        simulator: None,
        conditions: Default::default(),
        asked,
        vial_check: request.vial_check,
        reservation: request.reservation.clone(),
        bench_name: None,
        labels: Labels::default(),
    };
    Ok((dose, repeats))
}

fn known(name: &str) -> Option<Holds> {
    if NUMBERS.contains(&name) {
        return Some(Holds::Numbers);
    }
    WORDS.contains(&name).then_some(Holds::Text)
}

/// The column that a laboratory's name for it means; its letters and digits, in lower case.
fn meant(letters: &str) -> Option<&'static str> {
    Some(match letters {
        "substance" | "material" | "compound" | "chemical" | "name" => "powder",
        "mg" | "target" | "mass" | "massmg" | "amount" | "amountmg" | "weight" | "weightmg" => {
            "target_mg"
        }
        "g" | "massg" | "amountg" | "weightg" => "target_g",
        "tolerance" | "tol" | "tolmg" => "tolerance_mg",
        "tolpct" | "tolerancepercent" => "tolerance_pct",
        "well" | "pos" | "slot" | "rack" | "rackposition" => "position",
        "container" | "tube" | "barcode" | "vialname" => "vial",
        "batch" | "lotnumber" | "lotno" => "lot",
        "user" | "person" | "requestedby" => "operator",
        "repeat" | "replicates" | "n" | "count" => "repeats",
        _ => return None,
    })
}

impl ListedDose {
    fn of(request: WeighRequest) -> Self {
        let WeighRequest { powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, .. } =
            request;
        let WeighRequest { policy, asked, .. } = request;
        let weighing = None;
        Self { weighing, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, policy, asked }
    }
}

impl From<Weighing> for ListedDose {
    fn from(weighing: Weighing) -> Self {
        Self {
            weighing: Some(weighing.id),
            powder: weighing.powder,
            target_mg: weighing.target_mg,
            tolerance_lower_mg: weighing.tolerance_lower_mg,
            tolerance_upper_mg: weighing.tolerance_upper_mg,
            policy: weighing.policy,
            asked: weighing.asked,
        }
    }
}
