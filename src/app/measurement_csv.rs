//! Measurements as CSV, in the form laboratories keep them: one repeat or one summary per row, with
//! an empty cell for anything not measured.
//!
//! A row with `n` is a summary (mean, SD, n). Rows without it are single repeats; those of one
//! powder, method, source, day and experiment are combined into one measurement at the position of the
//! first of them. [`read`] reads the output of [`write()`].

use super::check::Check;
use super::csv_file::date::day_of;
use super::csv_file::words;
use super::csv_file::{Cells, Columns, Holds, REFUSALS_MAX, Refused, Table, at};
use super::nearest::did_you_mean;
use super::powder_names::PowderNames;
use super::{Error, Result};
use flip_core::domain::FieldError;
use flip_core::domain::observable::{Observable, Observation, SD_MIN};
use flip_core::domain::powder::{Flowability, HeapReadings, Method, mean_and_sd};
use flip_store::observations::PowderObservation;
use flip_store::powders::{Measurement, Origin};
use std::collections::HashMap;

/// All columns, in the order of an export.
const COLUMNS: [&str; 23] = [
    "powder",
    "method",
    "repose_deg",
    "repose_sd_deg",
    "n",
    "height_mm",
    "base_diameter_mm",
    "funnel_height_mm",
    "flow_time_s",
    "flow_time_sd_s",
    "poured_mass_g",
    "orifice_mm",
    "shake_mg",
    "shake_sd_mg",
    "spoon_pitch_deg",
    "shake_mm",
    "drained_deg",
    "drained_sd_deg",
    "pile_height_mm",
    "pile_height_sd_mm",
    "fall_mm",
    "source",
    "date",
];

/// A measured quantity: the columns of its value, its SD and its settings.
struct Quantity {
    value: &'static str,
    /// Empty if the quantity has no summary form.
    sd: &'static str,
    settings: &'static [&'static str],
    /// An optional setting.
    option: &'static str,
}

const ANGLE: Quantity =
    Quantity { value: "repose_deg", sd: "repose_sd_deg", settings: &[], option: "" };
const HEAP: Quantity = Quantity {
    value: "height_mm",
    sd: "",
    settings: &["base_diameter_mm"],
    option: "funnel_height_mm",
};
const FLOW: Quantity = Quantity {
    value: "flow_time_s",
    sd: "flow_time_sd_s",
    settings: &["poured_mass_g", "orifice_mm"],
    option: "",
};
const SHAKE: Quantity = Quantity {
    value: "shake_mg",
    sd: "shake_sd_mg",
    settings: &["spoon_pitch_deg", "shake_mm"],
    option: "",
};
const DRAINED: Quantity =
    Quantity { value: "drained_deg", sd: "drained_sd_deg", settings: &[], option: "" };
const PILE: Quantity = Quantity {
    value: "pile_height_mm",
    sd: "pile_height_sd_mm",
    settings: &["base_diameter_mm", "fall_mm"],
    option: "",
};
const QUANTITIES: [Quantity; 6] = [ANGLE, HEAP, FLOW, SHAKE, DRAINED, PILE];

/// A powder's entry in a file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Entry {
    /// Row number in the file, the header being row 1.
    pub row: usize,
    pub powder: String,
    pub origin: Origin,
    pub value: Value,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Value {
    Angle(Method, Flowability),
    Observed(Observation),
}

/// What the repeats of a group measure.
#[derive(Debug, Clone, Copy)]
enum Subject {
    Angle(Method),
    Observed(Observable),
}

/// Rows of single repeats that belong together, or a summary.
#[derive(Debug)]
struct Group {
    row: usize,
    column: &'static str,
    powder: String,
    origin: Origin,
    subject: Subject,
    /// Values of single repeats.
    repeats: Vec<f64>,
    summary: Option<Value>,
}

/// Everything in a file, in the order of its rows, and the powders that it gives by name.
///
/// # Errors
/// Every invalid cell by row and column, up to 50; an unknown, missing or repeated column by name.
pub(super) fn read(text: &str) -> Result<(Vec<Entry>, PowderNames)> {
    let (mut groups, mut powders) = (Groups::default(), PowderNames::default());
    let table = Table::open(
        text,
        &Columns { required: &["powder"], known, meant: |_| None, most: COLUMNS.len() },
        check_header,
    )?;
    let mut refusals =
        table.each(|cells| Row { row: cells.row, cells }.read(&mut groups, &mut powders));
    let entries: Vec<_> = groups
        .list
        .into_iter()
        .filter_map(|group| group.entry().map_err(|e| refusals.push(e)).ok())
        .collect();
    refusals.truncate(REFUSALS_MAX);
    if refusals.is_empty() { Ok((entries, powders)) } else { Err(Error::Invalid(refusals)) }
}

fn known(name: &str) -> Option<Holds> {
    match name {
        "powder" | "method" | "source" | "date" => Some(Holds::Text),
        _ => COLUMNS.contains(&name).then_some(Holds::Numbers),
    }
}

fn check_header(header: &[String], check: &mut Check) {
    let is_unknown = |name: &&String| !name.is_empty() && known(name).is_none();
    for name in header.iter().filter(is_unknown) {
        let meant = did_you_mean(name, COLUMNS);
        check.refuse(
            name,
            format!("is not a known column{meant}; the columns are: {}", COLUMNS.join(", ")),
        );
    }
}

/// One row.
struct Row<'a> {
    row: usize,
    cells: &'a Cells<'a>,
}

impl Row<'_> {
    fn read(&self, groups: &mut Groups, powders: &mut PowderNames) -> Refused<()> {
        let row = self.row;
        let mut check = Check::default();
        let powder = match self.cells.text("powder") {
            "" => check.keep(Err(at(row, "powder", "is missing"))),
            name => check.keep(powders.id_of(row, name)),
        };
        let method = words::method(self.cells.text("method")).unwrap_or_else(|| {
            let advice = format!(
                "must be automated (camera) or manual, got `{}`",
                self.cells.text("method")
            );
            check.refuse(&format!("row[{row}].method"), advice);
            Method::Automated
        });
        let source = self.cells.written("source");
        check.source(&format!("row[{row}].source"), source);
        let day = |text| day_of(text).map_err(|why| at(row, "date", why));
        let measured_on = match self.cells.text("date") {
            "" => None,
            text => check.keep(day(text)),
        };
        let origin = Origin { source: source.to_owned(), measured_on };
        let n = check.keep(self.cells.repeats("n")).flatten();
        let given: Vec<&Quantity> =
            QUANTITIES.iter().filter(|q| self.cells.holds(q.value)).collect();
        self.check_columns(&given, &mut check);
        let mut found = Vec::new();
        for quantity in &given {
            found.extend(check.keep(self.quantity(quantity, method, n)));
        }
        check.refusals()?;
        let powder = powder.unwrap_or_default();
        for (column, subject, value) in found {
            groups.add(row, column, &powder, &origin, subject, value);
        }
        Ok(())
    }

    /// Checks that every filled cell belongs to a measured quantity, and that a row has only one
    /// angle.
    fn check_columns(&self, given: &[&Quantity], check: &mut Check) {
        let row = self.row;
        let values = QUANTITIES.map(|q| q.value).join(", ");
        if given.is_empty() {
            check.refuse(
                &format!("row[{row}]"),
                format!("has no measured value: fill in one of {values}"),
            );
        }
        if self.cells.holds(ANGLE.value) && self.cells.holds(HEAP.value) {
            check.refuse(
                &format!("row[{row}].height_mm"),
                "is the same angle as `repose_deg`: leave one of them empty",
            );
        }
        for column in COLUMNS.iter().filter(|column| self.cells.holds(column)) {
            let uses = |q: &&Quantity| {
                q.value == *column
                    || q.sd == *column
                    || q.settings.contains(column)
                    || q.option == *column
            };
            let owners: Vec<&str> = QUANTITIES.iter().filter(uses).map(|q| q.value).collect();
            if !owners.is_empty() && !given.iter().any(uses) {
                check.refuse(
                    &format!("row[{row}].{column}"),
                    format!("belongs to {}, which is empty", owners.join(" or ")),
                );
            }
        }
    }

    /// One measured quantity: a summary, or the value of one repeat.
    fn quantity(
        &self,
        quantity: &Quantity,
        method: Method,
        n: Option<u32>,
    ) -> std::result::Result<(&'static str, Subject, Measured), FieldError> {
        let (row, value) = (self.row, self.cells.number(quantity.value)?);
        let is_summary = self.cells.holds("n");
        let sd = match (is_summary, quantity.sd) {
            (true, "") => {
                return Err(at(
                    row,
                    "n",
                    format!(
                        "cannot be given with {}, which is of a single heap: leave it empty",
                        quantity.value
                    ),
                ));
            }
            // The spread of a single value is unknown.
            (true, column) if n == Some(1) && !self.cells.holds(column) => 0.0,
            (true, column) => self.cells.number(column)?,
            (false, column) if self.cells.holds(column) => {
                return Err(at(
                    row,
                    column,
                    "belongs to a summary: fill in `n` too, or leave it empty for a single repeat",
                ));
            }
            (false, _) => 0.0,
        };
        let n = n.unwrap_or(2);
        if quantity.value == ANGLE.value {
            let count = if is_summary { n } else { 1 };
            let angle = Flowability::new(value, sd, count)
                .map_err(|error| self.renamed(quantity, error))?;
            let measured = if is_summary {
                Measured::Summary(Value::Angle(method, angle))
            } else {
                Measured::Repeat(value)
            };
            return Ok((quantity.value, Subject::Angle(method), measured));
        }
        let setting = |k: usize| self.cells.number(quantity.settings[k]);
        if quantity.value == HEAP.value {
            let funnel_height_mm = self
                .cells
                .holds(quantity.option)
                .then(|| self.cells.number(quantity.option))
                .transpose()?;
            let heap = HeapReadings {
                heights_mm: &[value],
                base_diameters_mm: &[setting(0)?],
                funnel_height_mm,
            };
            let angles = heap.angles_deg().map_err(|error| self.renamed(quantity, error))?;
            return Ok((quantity.value, Subject::Angle(method), Measured::Repeat(angles[0])));
        }
        let observable = match quantity.value {
            "flow_time_s" => Observable::FlowTime { mass_g: setting(0)?, orifice_mm: setting(1)? },
            "shake_mg" => Observable::ShakeMass { pitch_deg: setting(0)?, shake_mm: setting(1)? },
            "drained_deg" => Observable::DrainedAngle {},
            _ => Observable::PileHeight { base_diameter_mm: setting(0)?, fall_mm: setting(1)? },
        };
        // A single repeat is valid if a measurement of two such repeats is, whatever their spread.
        // A balance may show a negative reading after a shake that released nothing; the mean of
        // the repeats may not be negative.
        let (sd, mean) = match (is_summary, observable) {
            (true, _) => (sd, value),
            (false, Observable::ShakeMass { .. }) => (SD_MIN, value.abs()),
            (false, _) => (SD_MIN, value),
        };
        let observation = Observation { observable, mean, sd, n }.checked();
        let observation = observation.map_err(|error| self.renamed(quantity, error))?;
        let measured = if is_summary {
            Measured::Summary(Value::Observed(observation))
        } else {
            Measured::Repeat(value)
        };
        Ok((quantity.value, Subject::Observed(observable), measured))
    }

    /// Translates an error to the file: the domain's field is one of its columns.
    fn renamed(&self, quantity: &Quantity, error: FieldError) -> FieldError {
        let column = match error.field.split('[').next().unwrap_or_default() {
            "repose_deg" | "heights_mm" | "mean" => quantity.value,
            "sd_deg" | "sd" => quantity.sd,
            "base_diameters_mm" => "base_diameter_mm",
            "mass_g" => "poured_mass_g",
            "pitch_deg" => "spoon_pitch_deg",
            same => same,
        };
        at(self.row, column, error.message)
    }
}

/// Quantity measured in a cell.
enum Measured {
    Repeat(f64),
    Summary(Value),
}

/// Groups in the order of their first rows.
#[derive(Debug, Default)]
struct Groups {
    list: Vec<Group>,
    /// Position of each key's group.
    places: HashMap<String, usize>,
}

impl Groups {
    fn add(
        &mut self,
        row: usize,
        column: &'static str,
        powder: &str,
        origin: &Origin,
        subject: Subject,
        measured: Measured,
    ) {
        let group = |repeats, summary| Group {
            row,
            column,
            powder: powder.to_owned(),
            origin: origin.clone(),
            subject,
            repeats,
            summary,
        };
        match measured {
            Measured::Summary(value) => self.list.push(group(Vec::new(), Some(value))),
            Measured::Repeat(value) => {
                // Different values print differently, and no id contains a line break.
                let place = *self
                    .places
                    .entry(format!("{powder}\n{origin:?}\n{subject:?}"))
                    .or_insert(self.list.len());
                match self.list.get_mut(place) {
                    Some(known) => known.repeats.push(value),
                    None => self.list.push(group(vec![value], None)),
                }
            }
        }
    }
}

impl Group {
    /// The measurement formed by its repeats.
    fn entry(self) -> std::result::Result<Entry, FieldError> {
        let Self { row, column, powder, origin, subject, repeats, summary } = self;
        let renamed = |error: FieldError| {
            at(
                row,
                column,
                format!("and its {} further repeats: {}", repeats.len() - 1, error.message),
            )
        };
        let value = match (summary, subject) {
            (Some(value), _) => value,
            (None, Subject::Angle(method)) => {
                Value::Angle(method, Flowability::of_repeats("repeats", &repeats).map_err(renamed)?)
            }
            (None, Subject::Observed(_)) if repeats.len() < 2 => {
                let advice = "is the only repeat of its experiment: give at least two, to know their spread, or a summary with `n`";
                return Err(at(row, column, advice));
            }
            (None, Subject::Observed(observable)) => {
                let (mean, sd) = mean_and_sd(&repeats);
                let observation = Observation { observable, mean, sd, n: repeats.len() as u32 };
                Value::Observed(observation.checked().map_err(renamed)?)
            }
        };
        Ok(Entry { row, powder, origin, value })
    }
}

/// A file that [`read`] reads: one summary per row, measurements before observations, numbers with
/// all their digits.
pub(super) fn write(measurements: &[Measurement], observations: &[PowderObservation]) -> String {
    let angle = |m: &Measurement| {
        vec![
            ("powder", m.powder.clone()),
            ("method", m.method.name().to_owned()),
            ("repose_deg", m.repose_deg.to_string()),
            // The spread of a single value is unknown.
            ("repose_sd_deg", if m.sd_unknown { String::new() } else { m.sd_deg.to_string() }),
            ("n", m.n.to_string()),
            ("source", m.source.clone()),
            ("date", m.measured_on.clone().unwrap_or_default()),
        ]
    };
    let observed = |o: &PowderObservation| {
        let (quantity, settings) = match o.observable {
            Observable::FlowTime { mass_g, orifice_mm } => (FLOW, vec![mass_g, orifice_mm]),
            Observable::ShakeMass { pitch_deg, shake_mm } => (SHAKE, vec![pitch_deg, shake_mm]),
            Observable::DrainedAngle {} => (DRAINED, vec![]),
            Observable::PileHeight { base_diameter_mm, fall_mm } => {
                (PILE, vec![base_diameter_mm, fall_mm])
            }
        };
        let mut cells = vec![
            ("powder", o.powder.clone()),
            (quantity.value, o.mean.to_string()),
            (quantity.sd, o.sd.to_string()),
            ("n", o.n.to_string()),
            ("source", o.source.clone()),
            ("date", o.measured_on.clone().unwrap_or_default()),
        ];
        cells.extend(quantity.settings.iter().copied().zip(settings.iter().map(f64::to_string)));
        cells
    };
    let rows = measurements.iter().map(angle).chain(observations.iter().map(observed));
    let mut text = csv::WriterBuilder::new().from_writer(Vec::new());
    let header = COLUMNS.map(str::to_owned).to_vec();
    for row in std::iter::once(header).chain(rows.map(|cells| {
        let cell = |column| {
            cells
                .iter()
                .find(|(name, _)| *name == column)
                .map_or_else(String::new, |(_, text)| text.clone())
        };
        COLUMNS.map(cell).to_vec()
    })) {
        // Writing rows of equal length to memory cannot fail.
        let _infallible = text.write_record(row);
    }
    String::from_utf8(text.into_inner().unwrap_or_default()).unwrap_or_default()
}

#[cfg(test)]
mod tests;
