//! Balance readings of weighings as CSV: one reading per row, with everything that was recorded
//! alongside it.
//!
//! | columns | what becomes of them |
//! |---------|----------------------|
//! | `weighing_id`, `t_s`, `balance_mg` | the reading; rows of one weighing are in the order of time, wherever they stand |
//! | `kind` | what was on the pan: `dose`, or as a control `zero` (empty) or `standard` (a standard mass); empty is a dose |
//! | `powder`, `session`, `target_mg` | of the whole weighing: one row may say it for all |
//! | the known numbers below, `stable` | of the reading, within bounds; `stable` as balances flag it, S or U, or yes and no |
//! | any other | nothing: no cause of the simulated bench acts through it |
//!
//! An empty cell is a missing value, never zero.

use super::check::Check;
use super::csv_file::words::stable;
use super::csv_file::{Cells, Columns, Holds, REFUSALS_MAX, Refused, Table, Told, at, within};
use super::powder_names::PowderNames;
use super::{Error, Result, humidity};
use flip_core::domain::FieldError;
use flip_discover::reading::{ColumnRead, FileRead, TakenAs};
use flip_discover::traces::{Kind, Reading, Traces, Weighing};
use std::collections::HashMap;

/// Columns without which a row is not a reading.
const REQUIRED: [&str; 3] = ["weighing_id", "t_s", "balance_mg"];
/// Other numeric columns.
const NUMBERS: [&str; 7] = [
    "shake_index",
    "shake_mm",
    "spoon_pitch_deg",
    "spoon_fill_mg",
    "target_mg",
    humidity::COLUMN,
    "vibration_rms_m_s2",
];
/// Other text columns.
const WORDS: [&str; 4] = ["stable", "kind", "powder", "session"];
/// Maximum number of columns.
const COLUMNS_MAX: usize = 60;
/// Maximum length of the name of a weighing or a session.
const NAME_CHARS_MAX: usize = 100;
/// Maximum number of shakes per weighing: the readings of one weighing are judged together, at a
/// cost cubic in their number.
const SHAKES_MAX: usize = 100;

/// Content of a row.
struct Line {
    row: usize,
    weighing: String,
    kind: Option<Kind>,
    powder: Option<String>,
    session: Option<String>,
    target_mg: Option<f64>,
    reading: Reading,
}

/// A weighing whose rows are being gathered.
struct Gathered {
    weighing: Weighing,
    kind: Option<Kind>,
    shakes: usize,
}

/// Traces, and how their file was interpreted.
#[derive(Debug)]
pub(super) struct TracesRead {
    pub traces: Traces,
    pub read: FileRead,
}

/// The traces in a file.
///
/// # Errors
/// Every invalid cell by row and column, up to 50; a missing or repeated column by name;
/// uninformative traces.
pub(super) fn read(text: &str) -> Result<TracesRead> {
    let table = Table::open(
        text,
        &Columns { required: &REQUIRED, known, meant: |_| None, most: COLUMNS_MAX },
        |_, _| {},
    )?;
    let (mut lines, mut powders) = (Vec::new(), PowderNames::default());
    let refusals = table.each(|cells| {
        lines.push(line(cells, &mut powders)?);
        Ok(())
    });
    refused(refusals)?;
    let humid = humidities(&table, &mut lines).map_err(Error::Invalid)?;
    let mut columns = columns(&table);
    if let (Some(note), Some(column)) =
        (humid, columns.iter_mut().find(|it| it.column == humidity::COLUMN))
    {
        column.note = note.to_owned();
    }
    let rows = lines.len() as u32;
    let traces = gathered(lines)?;
    let read = FileRead {
        file: "traces".to_owned(),
        rows,
        columns,
        powders: powders.named(),
        left_out: Vec::new(),
        notes: Vec::new(),
    };
    Ok(TracesRead { traces, read })
}

fn known(name: &str) -> Option<Holds> {
    match name {
        "weighing_id" => Some(Holds::Text),
        _ if REQUIRED.contains(&name) || NUMBERS.contains(&name) => Some(Holds::Numbers),
        _ => WORDS.contains(&name).then_some(Holds::Text),
    }
}

fn refused(mut refusals: Vec<FieldError>) -> Result<()> {
    refusals.truncate(REFUSALS_MAX);
    if refusals.is_empty() { Ok(()) } else { Err(Error::Invalid(refusals)) }
}

/// Weighings in the order of their first rows.
fn gathered(lines: Vec<Line>) -> Result<Traces> {
    let mut places: HashMap<String, usize> = HashMap::new();
    let mut all: Vec<Gathered> = Vec::new();
    let mut refusals = Vec::new();
    for line in lines {
        let place = *places.entry(line.weighing.clone()).or_insert(all.len());
        if place == all.len() {
            all.push(Gathered::new(line.weighing.clone()));
        }
        refusals.extend(all[place].add(line).err().into_iter().flatten());
        if refusals.len() >= REFUSALS_MAX {
            break;
        }
    }
    refused(refusals)?;
    let named = |it: Gathered| Weighing { kind: it.kind.unwrap_or(Kind::Dose), ..it.weighing };
    Ok(Traces { weighings: all.into_iter().map(named).collect() }.checked()?)
}

/// Humidities in per cent, whichever way they are written; returns the note on their column.
fn humidities(table: &Table, lines: &mut [Line]) -> Refused<Option<&'static str>> {
    let mut values: Vec<Option<f64>> =
        lines.iter().map(|line| line.reading.relative_humidity_pct).collect();
    let units: Vec<bool> = table
        .rows()
        .map(|cells| matches!(cells.told(humidity::COLUMN), Told::Number(_, Some(_))))
        .collect();
    let note = humidity::to_percent(humidity::COLUMN, &mut values, |k| units[k], |k| lines[k].row)?;
    lines
        .iter_mut()
        .zip(values)
        .for_each(|(line, value)| line.reading.relative_humidity_pct = value);
    Ok(note)
}

/// How each column was interpreted.
fn columns(table: &Table) -> Vec<ColumnRead> {
    let rows = table.rows().count() as u32;
    let named = table.columns.iter().filter(|name| !name.is_empty());
    named
        .map(|name| {
            let filled = table.rows().filter(|cells| cells.holds(name)).count() as u32;
            let taken_as = match name.as_str() {
                "weighing_id" | "powder" => TakenAs::Subject,
                "session" => TakenAs::Session,
                "t_s" | "balance_mg" => TakenAs::Measured,
                "stable" | "kind" => TakenAs::Names,
                other if NUMBERS.contains(&other) => TakenAs::Numbers,
                _ => TakenAs::Nothing,
            };
            let note = match taken_as {
                TakenAs::Nothing => "no cause of the simulated bench acts through it".to_owned(),
                _ => String::new(),
            };
            ColumnRead { column: name.clone(), taken_as, filled, missing: rows - filled, note }
        })
        .collect()
}

/// A row, if it is valid.
fn line(cells: &Cells<'_>, powders: &mut PowderNames) -> Refused<Line> {
    let row = cells.row;
    let mut check = Check::default();
    for column in REQUIRED.iter().filter(|column| !cells.holds(column)) {
        check.keep::<()>(Err(at(row, column, "is missing")));
    }
    for column in ["weighing_id", "session"].iter().filter(|column| cells.holds(column)) {
        check.text(&format!("row[{row}].{column}"), cells.text(column), NAME_CHARS_MAX);
    }
    let powder = cells.holds("powder").then(|| powders.id_of(row, cells.text("powder")));
    let powder = powder.and_then(|id| check.keep(id));
    let kind = match cells.text("kind").to_lowercase().as_str() {
        "" => None,
        "dose" => Some(Kind::Dose),
        "zero" => Some(Kind::Zero),
        "standard" => Some(Kind::Standard),
        other => {
            check.keep::<()>(Err(at(
                row,
                "kind",
                format!("must be dose, zero or standard, got `{other}`"),
            )));
            None
        }
    };
    let stood = stable(cells.text("stable"));
    if cells.holds("stable") && stood.is_none() {
        let advice = format!(
            "must be S, ST, yes, true or 1 for stable, or U, US, D, SD, no, false or 0 for unstable, got `{}`",
            cells.text("stable")
        );
        check.keep::<()>(Err(at(row, "stable", advice)));
    }
    let mut number = |column: &str, lower: f64, upper: f64, unit: &str| {
        let value = cells.holds(column).then(|| within(cells, column, lower, upper, unit));
        value.and_then(|value| check.keep(value))
    };
    let (t_s, balance_mg) =
        (number("t_s", -1e12, 1e12, "s"), number("balance_mg", -1e9, 1e9, "mg"));
    let target_mg = number("target_mg", 0.0, 1e9, "mg");
    let reading = Reading {
        t_s: t_s.unwrap_or_default(),
        balance_mg: balance_mg.unwrap_or_default(),
        stable: stood,
        shake_index: None,
        shake_mm: number("shake_mm", 0.0, 1e3, "mm"),
        spoon_pitch_deg: number("spoon_pitch_deg", -180.0, 180.0, "deg"),
        spoon_fill_mg: number("spoon_fill_mg", -1e3, 1e9, "mg"),
        relative_humidity_pct: number(humidity::COLUMN, 0.0, 100.0, "%"),
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
    fn new(id: String) -> Self {
        let (powder, session, target_mg) = (None, None, None);
        let weighing =
            Weighing { id, powder, session, kind: Kind::Dose, target_mg, readings: Vec::new() };
        Self { weighing, kind: None, shakes: 0 }
    }

    /// Adds a row; refuses one that contradicts earlier rows.
    fn add(&mut self, line: Line) -> Refused<()> {
        let Line { row, weighing: _, kind, powder, session, target_mg, reading } = line;
        let mut check = Check::default();
        let it = &mut self.weighing;
        let id = it.id.clone();
        let mut agree = |column: &str, agrees: bool| {
            if !agrees {
                let advice = format!(
                    "differs from the earlier rows of weighing `{id}`: give the same in each"
                );
                check.keep::<()>(Err(at(row, column, advice)));
            }
        };
        agree("kind", same(&mut self.kind, kind));
        agree("powder", same(&mut it.powder, powder));
        agree("session", same(&mut it.session, session));
        agree("target_mg", same(&mut it.target_mg, target_mg));
        if let Some(before) = it.readings.last() {
            if reading.t_s < before.t_s {
                let advice = format!(
                    "runs backwards in weighing `{id}`, from {} to {} s",
                    before.t_s, reading.t_s
                );
                check.keep::<()>(Err(at(row, "t_s", advice)));
            }
            if let (Some(before), Some(now)) = (before.shake_index, reading.shake_index)
                && now < before
            {
                let advice = format!(
                    "falls from {before} to {now} in weighing `{id}`: it must never decrease"
                );
                check.keep::<()>(Err(at(row, "shake_index", advice)));
            }
        }
        if it.readings.last().is_none_or(|before| before.shake_index != reading.shake_index) {
            self.shakes += 1;
        }
        // The readings before the first shake are not a shake.
        if self.shakes > SHAKES_MAX + 1 {
            let advice = format!(
                "is above the limit of {SHAKES_MAX} shakes in one weighing: split the weighing"
            );
            check.keep::<()>(Err(at(row, "shake_index", advice)));
        }
        check.refusals()?;
        it.readings.push(reading);
        Ok(())
    }
}

/// Stores a row's value for its weighing; returns whether it agrees with earlier rows.
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

    /// A dose of 20 shakes, with two readings after each, on a day that is given once.
    fn dose(id: &str) -> String {
        (0..40)
            .map(|k| {
                format!(
                    "{id},{}.5,{}.1,{},{}\n",
                    k,
                    k / 2,
                    k / 2,
                    if k == 0 { "monday" } else { "" }
                )
            })
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
        let traces = read(&text).unwrap().traces;
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
        assert_eq!(
            (second.stable, second.relative_humidity_pct),
            (None, None),
            "an empty cell is missing"
        );
        assert_eq!((b.readings[0].stable, z.readings[0].stable), (Some(true), Some(false)));
        assert_eq!((z.kind, z.readings.len()), (Kind::Zero, 40));
    }

    #[test]
    fn wrong_cells_are_named_by_row_and_column() {
        let good = format!("{HEADER}{}", dose("a"));
        assert_eq!(read(&good).unwrap().traces.weighings[0].session.as_deref(), Some("monday"));
        let changed = |from: &str, to: &str| refused(&good.replacen(from, to, 1));
        assert_eq!(changed("a,3.5,1.1", "a,1.5,1.1"), ["row[5].t_s"], "time runs backwards");
        assert_eq!(
            changed("a,3.5,1.1,1", "a,3.5,1.1,0"),
            ["row[5].shake_index"],
            "shakes are counted up"
        );
        assert_eq!(changed("a,3.5,1.1", "a,3.5,1.1 g"), ["row[5].balance_mg"], "another unit");
        assert_eq!(changed("a,3.5,1.1", "a,NaN,1.1"), ["row[5].t_s"]);
        assert_eq!(
            changed("a,3.5,1.1", ",,"),
            ["row[5].weighing_id", "row[5].t_s", "row[5].balance_mg"]
        );
        assert_eq!(changed("a,3.5,1.1,1", "a,3.5,1.1,1.5"), ["row[5].shake_index"]);
        assert_eq!(changed("a,3.5,1.1,1", "a,3.5,1.1,-1"), ["row[5].shake_index"]);
        assert_eq!(
            changed("a,3.5,1.1,1,", "a,3.5,1.1,1,tuesday"),
            ["row[5].session"],
            "a weighing has one day"
        );
        let with = |column: &str, cell: &str| {
            refused(&format!("weighing_id,t_s,balance_mg,{column}\na,0,1,{cell}\n"))
        };
        for (column, cell) in [
            ("kind", "tare"),
            ("stable", "perhaps"),
            ("powder", "?!"),
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
        assert_eq!(
            refused(&format!("{HEADER}{long}")),
            [format!("row[{}].shake_index", SHAKES_MAX + 3)]
        );
        let columns: String = (0..COLUMNS_MAX).map(|k| format!(",c{k}")).collect();
        assert_eq!(refused(&format!("weighing_id,t_s,balance_mg{columns}\n")), ["header"]);
    }
}
