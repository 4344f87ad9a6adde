//! Balance readings of weighings as CSV: one reading a row, and beside it whatever was recorded with it.
//!
//! | columns | what becomes of them |
//! |---------|----------------------|
//! | `weighing_id`, `t_s`, `balance_mg` | the reading; rows of one weighing are in the order of time, wherever they stand |
//! | `kind` | what was on the pan: `dose`, or as a control `zero` (empty) or `standard` (a standard mass); empty is a dose |
//! | `powder`, `session`, `target_mg` | of the whole weighing: one row may say it for all |
//! | the known numbers below, `stable` | of the reading, within bounds |
//! | any other | nothing: no cause of the simulated bench acts through it |
//!
//! An empty cell is a missing value, never zero.

use super::check::Check;
use super::csv_file::{Cells, CsvFile, REFUSALS_MAX, Refused, at, within, yes_or_no};
use super::{Error, Result};
use crate::discover::traces::{Kind, Reading, Traces, Weighing};
use crate::domain::powder::powder_id;
use std::collections::HashMap;

/// Columns without which a row is no reading.
const REQUIRED: [&str; 3] = ["weighing_id", "t_s", "balance_mg"];
/// Most columns.
const COLUMNS_MAX: usize = 60;
/// Longest name of a weighing or a session.
const NAME_CHARS_MAX: usize = 100;
/// Most shakes of a weighing: the readings of one are judged together, which takes their number to the third.
const SHAKES_MAX: usize = 100;

/// What a row says.
struct Line {
    row: usize,
    weighing: String,
    kind: Option<Kind>,
    powder: Option<String>,
    session: Option<String>,
    target_mg: Option<f64>,
    reading: Reading,
}

/// A weighing while its rows are gathered.
struct Gathered {
    weighing: Weighing,
    kind: Option<Kind>,
    shakes: usize,
}

/// The traces that a file describes.
///
/// # Errors
/// Every wrong cell by row and column, up to 50; a missing or repeated column by name; traces that say nothing.
pub(super) fn read(text: &str) -> Result<Traces> {
    let file = CsvFile::open(text, |names, check| {
        for column in REQUIRED.iter().filter(|column| !names.iter().any(|name| name == *column)) {
            check.refuse(column, "is missing in the header");
        }
        if names.len() > COLUMNS_MAX {
            check.refuse("header", format!("has {} columns, and at most {COLUMNS_MAX} are read", names.len()));
        }
    })?;
    let mut places: HashMap<String, usize> = HashMap::new();
    let mut all: Vec<Gathered> = Vec::new();
    let mut refusals = file.rows(|cells| {
        let line = line(cells)?;
        let place = *places.entry(line.weighing.clone()).or_insert(all.len());
        if place == all.len() {
            let Line { weighing: id, .. } = &line;
            let weighing = Weighing {
                id: id.clone(),
                powder: None,
                session: None,
                kind: Kind::Dose,
                target_mg: None,
                readings: Vec::new(),
            };
            all.push(Gathered { weighing, kind: None, shakes: 0 });
        }
        all[place].add(line)
    })?;
    refusals.truncate(REFUSALS_MAX);
    if !refusals.is_empty() {
        return Err(Error::Invalid(refusals));
    }
    let named = |it: Gathered| Weighing { kind: it.kind.unwrap_or(Kind::Dose), ..it.weighing };
    Ok(Traces { weighings: all.into_iter().map(named).collect() }.checked()?)
}

/// A row, if it is right.
fn line(cells: &Cells<'_>) -> Refused<Line> {
    let row = cells.row;
    let mut check = Check::default();
    for column in REQUIRED.iter().filter(|column| !cells.holds(column)) {
        check.keep::<()>(Err(at(row, column, "is missing")));
    }
    for column in ["weighing_id", "session"].iter().filter(|column| cells.holds(column)) {
        check.text(&format!("row[{row}].{column}"), cells.text(column), NAME_CHARS_MAX);
    }
    let powder = cells.holds("powder").then(|| powder_id(&format!("row[{row}].powder"), cells.text("powder")));
    let powder = powder.and_then(|id| check.keep(id));
    let kind = match cells.text("kind") {
        "" => None,
        "dose" => Some(Kind::Dose),
        "zero" => Some(Kind::Zero),
        "standard" => Some(Kind::Standard),
        other => {
            check.keep::<()>(Err(at(row, "kind", format!("must be dose, zero or standard, got `{other}`"))));
            None
        }
    };
    let stable = yes_or_no(cells.text("stable")).map(|it| it == "yes");
    if cells.holds("stable") && stable.is_none() {
        let advice = format!("must be one of 1, 0, true, false, yes and no, got `{}`", cells.text("stable"));
        check.keep::<()>(Err(at(row, "stable", advice)));
    }
    let mut number = |column: &str, lower: f64, upper: f64, unit: &str| {
        let value = cells.holds(column).then(|| within(cells, column, lower, upper, unit));
        value.and_then(|value| check.keep(value))
    };
    let (t_s, balance_mg) = (number("t_s", -1e12, 1e12, "s"), number("balance_mg", -1e9, 1e9, "mg"));
    let target_mg = number("target_mg", 0.0, 1e9, "mg");
    let reading = Reading {
        t_s: t_s.unwrap_or_default(),
        balance_mg: balance_mg.unwrap_or_default(),
        stable,
        shake_index: None,
        shake_mm: number("shake_mm", 0.0, 1e3, "mm"),
        spoon_pitch_deg: number("spoon_pitch_deg", -180.0, 180.0, "deg"),
        spoon_fill_mg: number("spoon_fill_mg", -1e3, 1e9, "mg"),
        relative_humidity_pct: number("relative_humidity_pct", 0.0, 100.0, "%"),
        vibration_rms_m_s2: number("vibration_rms_m_s2", 0.0, 1e4, "m/s^2"),
    };
    let shake_index = check.keep(cells.whole("shake_index", "shakes")).flatten();
    check.refusals()?;
    let text = |column: &str| cells.holds(column).then(|| cells.text(column).to_owned());
    Ok(Line {
        row,
        weighing: cells.text("weighing_id").to_owned(),
        kind,
        powder,
        session: text("session"),
        target_mg,
        reading: Reading { shake_index, ..reading },
    })
}

impl Gathered {
    /// One row more; refused where it contradicts the rows before.
    fn add(&mut self, line: Line) -> Refused<()> {
        let Line { row, weighing: _, kind, powder, session, target_mg, reading } = line;
        let mut check = Check::default();
        let it = &mut self.weighing;
        let id = it.id.clone();
        let mut agree = |column: &str, agrees: bool| {
            if !agrees {
                let advice = format!("is another one than in the rows of `{id}` before: a weighing has one");
                check.keep::<()>(Err(at(row, column, advice)));
            }
        };
        agree("kind", same(&mut self.kind, kind));
        agree("powder", same(&mut it.powder, powder));
        agree("session", same(&mut it.session, session));
        agree("target_mg", same(&mut it.target_mg, target_mg));
        if let Some(before) = it.readings.last() {
            if reading.t_s < before.t_s {
                let advice = format!("runs backwards in weighing `{id}`, from {} to {} s", before.t_s, reading.t_s);
                check.keep::<()>(Err(at(row, "t_s", advice)));
            }
            if let (Some(before), Some(now)) = (before.shake_index, reading.shake_index)
                && now < before
            {
                let advice = format!("falls from {before} to {now} in weighing `{id}`: shakes are counted up");
                check.keep::<()>(Err(at(row, "shake_index", advice)));
            }
        }
        if it.readings.last().is_none_or(|before| before.shake_index != reading.shake_index) {
            self.shakes += 1;
        }
        // The readings before the first shake are no shake.
        if self.shakes > SHAKES_MAX + 1 {
            let advice =
                format!("is one shake too many: at most {SHAKES_MAX} of a weighing are judged together; split it");
            check.keep::<()>(Err(at(row, "shake_index", advice)));
        }
        check.refusals()?;
        it.readings.push(reading);
        Ok(())
    }
}

/// Remember what a row says of its weighing; whether it says what rows before said.
fn same<T: PartialEq>(known: &mut Option<T>, said: Option<T>) -> bool {
    match (&known, said) {
        (_, None) => true,
        (None, said) => {
            *known = said;
            true
        }
        (Some(known), Some(said)) => *known == said,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dose of 20 shakes, two readings after each, of a day that is named once.
    fn dose(id: &str) -> String {
        (0..40)
            .map(|k| format!("{id},{}.5,{}.1,{},{}\n", k, k / 2, k / 2, if k == 0 { "monday" } else { "" }))
            .collect()
    }

    const HEADER: &str = "weighing_id,t_s,balance_mg,shake_index,session\n";

    fn refused(text: &str) -> Vec<String> {
        match read(text) {
            Err(Error::Invalid(errors)) => errors.into_iter().map(|error| error.field).collect(),
            other => panic!("{text}: {other:?}"),
        }
    }

    #[test]
    fn rows_of_a_weighing_are_gathered_with_what_was_recorded_beside_them() {
        let text = "weighing_id,t_s,balance_mg,stable,shake_index,shake_mm,kind,powder,session,target_mg,relative_humidity_pct,remark\n\
                    b,0,0.0,1,0,,,salt,2,12.5,41,x\nz,0,0.1,no,,,zero,,2,,41,\nb,1.5,3.25,,1.0,6,,,,,,\nz,1,0.0,yes,,,,,,,,\n"
            .to_owned()
            + &(2..40).map(|k| format!("z,{k},0.{k},,,,zero,,,,,\n")).collect::<String>();
        let traces = read(&text).unwrap();
        let [b, z] = &traces.weighings[..] else { panic!("{traces:?}") };
        assert_eq!(
            (b.id.as_str(), b.kind, b.powder.as_deref(), b.session.as_deref()),
            ("b", Kind::Dose, Some("salt"), Some("2"))
        );
        assert_eq!((b.target_mg, b.readings.len()), (Some(12.5), 2));
        let second = b.readings[1];
        assert_eq!(
            (second.t_s, second.balance_mg, second.shake_index, second.shake_mm),
            (1.5, 3.25, Some(1), Some(6.0))
        );
        assert_eq!((second.stable, second.relative_humidity_pct), (None, None), "an empty cell is missing");
        assert_eq!((b.readings[0].stable, z.readings[0].stable), (Some(true), Some(false)));
        assert_eq!((z.kind, z.readings.len()), (Kind::Zero, 40));
    }

    #[test]
    fn wrong_cells_are_named_by_row_and_column() {
        let good = format!("{HEADER}{}", dose("a"));
        assert_eq!(read(&good).unwrap().weighings[0].session.as_deref(), Some("monday"));
        let changed = |from: &str, to: &str| refused(&good.replacen(from, to, 1));
        assert_eq!(changed("a,3.5,1.1", "a,1.5,1.1"), ["row[5].t_s"], "time runs backwards");
        assert_eq!(changed("a,3.5,1.1,1", "a,3.5,1.1,0"), ["row[5].shake_index"], "shakes are counted up");
        assert_eq!(changed("a,3.5,1.1", "a,3.5,1.1 mg"), ["row[5].balance_mg"], "text in a number");
        assert_eq!(changed("a,3.5,1.1", "a,NaN,1.1"), ["row[5].t_s"]);
        assert_eq!(changed("a,3.5,1.1", ",,"), ["row[5].weighing_id", "row[5].t_s", "row[5].balance_mg"]);
        assert_eq!(changed("a,3.5,1.1,1", "a,3.5,1.1,1.5"), ["row[5].shake_index"]);
        assert_eq!(changed("a,3.5,1.1,1", "a,3.5,1.1,-1"), ["row[5].shake_index"]);
        assert_eq!(changed("a,3.5,1.1,1,", "a,3.5,1.1,1,tuesday"), ["row[5].session"], "a weighing has one day");
        let with = |column: &str, cell: &str| refused(&format!("weighing_id,t_s,balance_mg,{column}\na,0,1,{cell}\n"));
        for (column, cell) in [
            ("kind", "tare"),
            ("stable", "perhaps"),
            ("powder", "a b"),
            ("target_mg", "-1"),
            ("shake_mm", "-2"),
            ("spoon_pitch_deg", "200"),
            ("spoon_fill_mg", "full"),
            ("relative_humidity_pct", "120"),
            ("vibration_rms_m_s2", "-0.1"),
        ] {
            assert_eq!(with(column, cell), [format!("row[2].{column}")], "{column} {cell}");
        }
    }

    #[test]
    fn files_that_are_none_or_say_nothing_are_refused() {
        assert_eq!(refused("weighing_id,t_s\na,1\n"), ["balance_mg"]);
        assert_eq!(refused("weighing_id,t_s,balance_mg,t_s\na,1,2,3\n"), ["t_s"]);
        assert_eq!(refused(HEADER), ["row[2]"]);
        let few: String = dose("a").lines().take(29).map(|line| format!("{line}\n")).collect();
        assert_eq!(refused(&format!("{HEADER}{few}")), ["traces"]);
        let flat: String = (0..40).map(|k| format!("a,{k},5,0,\n")).collect();
        assert_eq!(refused(&format!("{HEADER}{flat}")), ["balance_mg"]);
        let long: String = (0..=SHAKES_MAX + 1).map(|k| format!("a,{k},{k},{k},\n")).collect();
        assert_eq!(refused(&format!("{HEADER}{long}")), [format!("row[{}].shake_index", SHAKES_MAX + 3)]);
        let columns: String = (0..COLUMNS_MAX).map(|k| format!(",c{k}")).collect();
        assert_eq!(refused(&format!("weighing_id,t_s,balance_mg{columns}\n")), ["header"]);
    }
}
