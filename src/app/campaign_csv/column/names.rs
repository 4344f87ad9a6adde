//! A column of names, if it is informative.
//!
//! Names that differ only in capitals and blanks are the same, written as first found in the file:
//! `Ada`, `ada`. A column of yes, no, 1 and 0 has two values.

use super::super::{Cell, NAMES, is_name};
use super::Column;
use crate::app::csv_file::Told;
use crate::app::csv_file::words::yes_or_no;
use flip_core::domain::powder_name::same_name;
use flip_discover::{LEVELS_MAX, Values};
use std::collections::BTreeMap;

/// Number of names listed in a note.
const NAMED: usize = 5;

/// Reads a column of these names.
pub(super) fn read(name: &str, cells: &[Cell<'_>], filled: usize) -> Column {
    let (cells, note) = as_one(cells);
    let mut names: Vec<&str> =
        cells.iter().filter(|cell| cell.is_filled()).map(|cell| cell.text).collect();
    names.sort_unstable();
    names.dedup();
    // A column that a cause needs is kept, so that the report can explain why the cause cannot be
    // judged.
    let is_needed = NAMES.contains(&name);
    if !names.iter().all(|name| is_name(name)) {
        return Column::nothing(filled, "it holds sentences");
    }
    if names.len() > LEVELS_MAX && !is_needed {
        return Column::nothing(
            filled,
            &format!("it holds {} names, more than {LEVELS_MAX}", names.len()),
        );
    }
    if 2 * names.len() > filled && !is_needed {
        return Column::nothing(filled, "hardly a name stands twice");
    }
    let numbers = cells.iter().filter(|cell| matches!(cell.told, Told::Number(..))).count();
    let counted = (numbers > 0 && !is_needed)
        .then(|| format!("{numbers} of its cells are numbers and count as names"));
    let note = note.or(counted).unwrap_or_default();
    let of =
        |cell: &Cell<'_>| cell.is_filled().then(|| names.binary_search(&cell.text).ok()).flatten();
    let of = cells.iter().map(of).collect();
    Column {
        values: Some(Values::Levels { names: names.into_iter().map(str::to_owned).collect(), of }),
        filled,
        note,
    }
}

/// The cells with one spelling per name, and the note on it.
fn as_one<'a>(cells: &[Cell<'a>]) -> (Vec<Cell<'a>>, Option<String>) {
    let mut ways: BTreeMap<String, Vec<&'a str>> = BTreeMap::new();
    for cell in cells.iter().filter(|cell| cell.is_filled()) {
        let known = ways.entry(same_name(cell.text)).or_default();
        if !known.contains(&cell.text) {
            known.push(cell.text);
        }
    }
    let named = |cell: &Cell<'a>| Cell {
        text: ways.get(&same_name(cell.text)).map_or(cell.text, |known| known[0]),
        ..*cell
    };
    // Single letters, such as t and n, are ambiguous.
    let has_word = ways.keys().any(|name| name.len() > 1 && name.chars().all(char::is_alphabetic));
    if ways.len() > 2 && has_word && ways.keys().all(|name| yes_or_no(name).is_some()) {
        let told = |cell: &Cell<'a>| {
            yes_or_no(cell.text).map_or(*cell, |text| Cell { text, told: Told::Text(text) })
        };
        return (
            cells.iter().map(told).collect(),
            Some("written in several ways, taken as yes and no".to_owned()),
        );
    }
    let several: Vec<String> = ways
        .values()
        .filter(|known| known.len() > 1)
        .take(NAMED)
        .map(|known| known.join(" = "))
        .collect();
    let note = (!several.is_empty()).then(|| format!("taken as one name: {}", several.join(", ")));
    (cells.iter().map(named).collect(), note)
}
