//! The table of a run.

use crate::bench::{Dose, Ran};
use crate::cases::Case;
use crate::verdict::{self, Excess};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::time::Duration;

/// The stored result of a case.
pub struct Row {
    case: Case,
    outcome: String,
    over_mg: f64,
    excess: Excess,
    must_look: bool,
    wrong: Vec<String>,
    cause: String,
    wall: Duration,
}

impl Row {
    pub fn new(dose: Dose, case: Case, ran: &Ran, twin_mg: f64, wall: Duration) -> Self {
        let (outcome, cause, must_look) = match &ran.weighed {
            Err(cause) => ("not begun".to_owned(), cause.clone(), false),
            Ok(it) => (
                format!("{:?}", it.outcome).to_lowercase(),
                it.cause.clone().unwrap_or_default(),
                it.must_look,
            ),
        };
        Self {
            case,
            outcome,
            over_mg: ran.vial_mg - dose.limit_mg(),
            excess: verdict::excess(dose, &case, ran, twin_mg),
            must_look: must_look || ran.latched.is_some(),
            wrong: verdict::faults(dose, &case, ran, twin_mg),
            cause,
            wall,
        }
    }

    /// Its problems, in words.
    pub fn complaints(&self) -> Vec<String> {
        let name =
            |what: &String| format!("{}: {what} [{} {}]", self.case, self.outcome, self.cause);
        self.wrong.iter().map(name).collect()
    }
}

impl std::fmt::Display for Row {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { case, outcome, cause, over_mg, .. } = self;
        write!(f, "{case}: {outcome}, {over_mg:.2} mg over, {cause}")
    }
}

/// One line about a dose without a fault.
pub fn twin(dose: Dose, ran: &Ran) -> String {
    let outcome = ran.weighed.as_ref().map(|it| (it.outcome, it.cause.clone(), it.shakes));
    format!("{dose:?} without a fault: {:.2} mg, {outcome:?}", ran.vial_mg)
}

/// Cases by device and fault, how they ended, and the mass in the vial beyond target and tolerance.
pub fn table(rows: &[Row]) -> String {
    let mut text = String::from(
        "\n| device | fault | cases | outcomes | a person must look | over: twin, in flight, chance, fault | worst excess mg |\n|---|---|---|---|---|---|---|\n",
    );
    let mut groups: BTreeMap<(&str, String), Vec<&Row>> = BTreeMap::new();
    for row in rows {
        groups.entry((row.case.fault.device(), row.case.fault.name())).or_default().push(row);
    }
    for ((device, fault), rows) in &groups {
        line(&mut text, device, fault, rows);
    }
    for device in ["the arm", "the balance", "the gripper"] {
        let rows: Vec<&Row> = rows.iter().filter(|row| row.case.fault.device() == device).collect();
        line(&mut text, device, "all", &rows);
    }
    line(&mut text, "all", "all", &rows.iter().collect::<Vec<_>>());
    let longest = rows.iter().max_by_key(|row| row.wall);
    let longest =
        longest.map(|row| format!("longest: {} in {:.1} s", row.case, row.wall.as_secs_f64()));
    let _ = write!(text, "\n{}", longest.unwrap_or_default());
    text
}

fn line(text: &mut String, device: &str, fault: &str, rows: &[&Row]) {
    let mut outcomes: BTreeMap<&str, usize> = BTreeMap::new();
    for row in rows {
        *outcomes.entry(&row.outcome).or_default() += 1;
    }
    let outcomes: Vec<String> =
        outcomes.iter().map(|(outcome, n)| format!("{outcome} {n}")).collect();
    let over = [Excess::Twin, Excess::InFlight, Excess::Chance, Excess::Fault]
        .map(|why| rows.iter().filter(|row| row.excess == why).count().to_string());
    let worst_mg = rows.iter().map(|row| row.over_mg).fold(0.0, f64::max);
    let look = rows.iter().filter(|row| row.must_look).count();
    let (outcomes, over) = (outcomes.join(", "), over.join(", "));
    let _ = writeln!(
        text,
        "| {device} | {fault} | {} | {outcomes} | {look} | {over} | {worst_mg:.2} |",
        rows.len()
    );
}
