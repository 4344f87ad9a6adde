//! Powders named in a file: which registered ones they are, and which are new.

use super::Result;
use super::check::Check;
use super::nearest::did_you_mean;
use super::powder_names::PowderNames;
use flip_core::domain::powder_name::same_name;
use flip_discover::reading::NamedPowder;
use flip_store::Tx;
use flip_store::said::{Row, RowOf};
use serde_json::json;
use std::collections::HashMap;

/// The powders of a file.
#[derive(Debug)]
pub(super) struct FilePowders {
    /// The id under which each is registered, by the id made from its name in the file.
    ids: HashMap<String, String>,
    /// Those that the file gives by name, with their ids.
    pub named: Vec<NamedPowder>,
    /// Those to register: id and name.
    new: Vec<(String, String)>,
}

/// How a powder in a file relates to the registered powders.
enum Registered {
    /// It is this one.
    As(String),
    /// It is not registered.
    Not,
    /// Its id belongs to a powder with this different name.
    Another(String),
}

/// Which of the `known` powders, id and name, has this id, or this name if the file gives one.
fn registered(known: &[(String, String)], id: &str, name: Option<&str>) -> Registered {
    let of_id = known.iter().find(|(known, _)| known == id);
    let Some(name) = name else {
        return of_id.map_or(Registered::Not, |(id, _)| Registered::As(id.clone()));
    };
    let is_same =
        |(id, known): &&(String, String)| same_name(known) == same_name(name) || known == id;
    // A powder that was registered by its id alone has no name of its own.
    let of_name = known.iter().find(|(_, known)| same_name(known) == same_name(name));
    match (of_id.filter(is_same).or(of_name), of_id) {
        (Some((id, _)), _) => Registered::As(id.clone()),
        (None, Some((_, other))) => Registered::Another(other.clone()),
        (None, None) => Registered::Not,
    }
}

impl FilePowders {
    /// Of a file with these names, whose `entries` are the ids made from them, in order, each with
    /// its row. `known` are the registered powders, id and name; with `create`, others become new
    /// ones.
    ///
    /// # Errors
    /// Every powder that is not registered, or whose id belongs to another, by its first row.
    pub fn find<'a>(
        entries: impl Iterator<Item = (&'a str, usize)>,
        names: &PowderNames,
        known: &[(String, String)],
        create: bool,
    ) -> Result<Self> {
        let mut found = Self { ids: HashMap::new(), named: names.named(), new: Vec::new() };
        let mut check = Check::default();
        for (made, row) in entries {
            if found.ids.contains_key(made) {
                continue;
            }
            let name = names.name_of(made);
            let field = format!("row[{row}].powder");
            let mut id = made.to_owned();
            match registered(known, made, name) {
                Registered::As(registered) => id = registered,
                Registered::Not if create => {
                    found.new.push((made.to_owned(), name.unwrap_or(made).to_owned()))
                }
                Registered::Not => check.refuse(&field, unknown(known, made, name)),
                Registered::Another(other) => {
                    let advice = format!(
                        "gives the id {made}, which belongs to `{other}`: write the id if it is that powder"
                    );
                    check.refuse(&field, advice);
                }
            }
            found.ids.insert(made.to_owned(), id);
        }
        check.done()?;
        for powder in &mut found.named {
            if let Some(id) = found.ids.get(&powder.id) {
                id.clone_into(&mut powder.id);
            }
        }
        Ok(found)
    }

    /// Replaces the id made from a powder's name by the one under which it is registered.
    pub fn rename(&self, powder: &mut String) {
        if let Some(id) = self.ids.get(powder) {
            id.clone_into(powder);
        }
    }

    /// Ids of the powders to register.
    pub fn new_ids(&self) -> Vec<String> {
        self.new.iter().map(|(id, _)| id.clone()).collect()
    }

    /// Registers the new ones, and returns their rows for the record.
    pub async fn register(&self, tx: &mut Tx) -> Result<Vec<Row>> {
        let mut rows = Vec::new();
        for (id, name) in &self.new {
            if let Some(created_at) = tx.insert_powder(id, name, None).await? {
                let powder = json!({ "id": id, "name": name, "created_at": created_at });
                rows.push(Row::of(RowOf::Powder, id, &powder));
            }
        }
        Ok(rows)
    }
}

fn unknown(known: &[(String, String)], id: &str, name: Option<&str>) -> String {
    let called = name.map_or_else(String::new, |name| format!(" and none called `{name}`"));
    let ids = did_you_mean(id, known.iter().map(|(id, _)| id.as_str()));
    let meant = match name {
        Some(name) if ids.is_empty() => {
            did_you_mean(name, known.iter().map(|(_, name)| name.as_str()))
        }
        _ => ids,
    };
    format!("there is no powder `{id}`{called}{meant}: register it first, or import with `create`")
}
