//! Powders named in a file, by id or by name.

use super::csv_file::at;
use super::csv_file::words::is_summary;
use flip_core::domain::FieldError;
use flip_core::domain::powder_name::{id_of_powder, same_name};
use flip_discover::reading::NamedPowder;
use std::collections::BTreeMap;

/// The names in a file, by the ids derived from them.
#[derive(Debug, Default)]
pub(super) struct PowderNames {
    named: BTreeMap<String, (usize, String)>,
}

impl PowderNames {
    /// The id of the powder named in a row.
    ///
    /// # Errors
    /// A text that does not name a powder, such as `Mean`; a name whose derived id belongs to
    /// another name.
    pub fn id_of(&mut self, row: usize, text: &str) -> Result<String, FieldError> {
        if is_summary(text) {
            let advice = format!(
                "`{text}` is not a powder but a summary of the rows above: leave the row out"
            );
            return Err(at(row, "powder", advice));
        }
        let id = id_of_powder(&format!("row[{row}].powder"), text)?;
        if id == text {
            return Ok(id);
        }
        let (before, known) =
            self.named.entry(id.clone()).or_insert_with(|| (row, text.to_owned()));
        if same_name(known) == same_name(text) {
            return Ok(id);
        }
        let advice = format!(
            "`{text}` gives the id {id}, as `{known}` in row {before} does: write each powder in one way, or use ids"
        );
        Err(at(row, "powder", advice))
    }

    /// The name behind an id; none if the file gives the id itself.
    pub fn name_of(&self, id: &str) -> Option<&str> {
        self.named.get(id).map(|(_, name)| name.as_str())
    }

    /// All of them, by id.
    pub fn named(&self) -> Vec<NamedPowder> {
        self.named
            .iter()
            .map(|(id, (_, name))| NamedPowder { name: name.clone(), id: id.clone() })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_powder_has_one_name_and_two_names_have_two_ids() {
        let mut names = PowderNames::default();
        for (row, text) in
            [(2, "Lactose 200M"), (3, "lactose_200m"), (4, "LACTOSE  200M"), (5, "salt")]
        {
            assert!(names.id_of(row, text).is_ok(), "{text}");
        }
        let refused = names.id_of(6, "Lactose-200M").unwrap_err();
        assert_eq!(refused.field, "row[6].powder");
        assert!(
            refused.message.contains("lactose_200m") && refused.message.contains("row 2"),
            "{refused}"
        );
        assert_eq!(
            (names.name_of("lactose_200m"), names.name_of("salt")),
            (Some("Lactose 200M"), None)
        );
        assert_eq!(names.named().len(), 1);
        assert_eq!(names.id_of(7, "Mean").unwrap_err().field, "row[7].powder");
    }

    #[test]
    fn a_row_called_overall_or_all_powders_is_no_powder() {
        for text in ["Overall", "All powders", "All", "ALL POWDERS:"] {
            let refused = PowderNames::default().id_of(9, text).unwrap_err();
            assert!(
                refused.field == "row[9].powder" && refused.message.contains("leave the row out"),
                "{refused}"
            );
        }
    }
}
