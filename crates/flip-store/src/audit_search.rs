//! Which records of the audit trail: by kind, person, time and words.
//!
//! Records in the table are chosen by SQL, those in archives by [`AuditWanted::takes`]; a test
//! holds the two together.

use super::archiving::KINDS as ARCHIVED;
use super::audit::AuditRecord;
use super::page::Page;
use super::sql::Parts;
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Where a record names people.
const PEOPLE: [&[&str]; 3] = [&["who", "name"], &["by"], &["asked", "operator"]];

/// Which records. Empty: all.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct AuditWanted {
    /// Only of this weighing.
    pub weighing: Option<String>,
    /// Only of this kind.
    pub kind: Option<String>,
    /// Only where these words, in any case, each stand in the name of the person who acted, signed
    /// or is the operator.
    pub person: Option<String>,
    /// Only at this time or later.
    pub since: Option<Timestamp>,
    /// Only before this time.
    pub before: Option<Timestamp>,
    /// Only with these words, in any case, each in the weighing, the kind or the contents.
    pub text: Option<String>,
}

/// A page of matching records, and how many match.
#[derive(Debug, Clone, PartialEq)]
pub struct AuditFound {
    /// The page.
    pub page: Page<AuditRecord>,
    /// How many match in all.
    pub total: u64,
}

impl AuditWanted {
    /// Every record of one weighing.
    pub fn of(weighing: &str) -> Self {
        Self { weighing: Some(weighing.to_owned()), ..Self::default() }
    }

    /// Whether nothing but the weighing is asked for.
    pub(super) fn is_plain(&self) -> bool {
        *self == Self { weighing: self.weighing.clone(), ..Self::default() }
    }

    /// Whether records in archives may match: these are of a few kinds, and name nobody.
    pub(super) fn may_be_archived(&self) -> bool {
        self.person.is_none() && self.kind.as_ref().is_none_or(|it| ARCHIVED.contains(&&**it))
    }

    /// Adds the conditions to a statement that has come to its `WHERE`.
    pub(super) fn restrict(&self, sql: &mut Parts) {
        sql.push("TRUE");
        for (column, is) in [("weighing", &self.weighing), ("kind", &self.kind)] {
            if let Some(is) = is {
                sql.push(format!(" AND {column} = ")).push_bind(is.clone());
            }
        }
        if let Some(since) = self.since {
            sql.push(" AND at >= ").push_bind(since.unix_ms());
        }
        if let Some(before) = self.before {
            sql.push(" AND at < ").push_bind(before.unix_ms());
        }
        if self.person.is_some() {
            // Most records name nobody; reading their JSON would take most of the time.
            sql.push(format!(" AND kind NOT IN ('{}')", ARCHIVED.join("', '")));
        }
        let people = PEOPLE.map(|path| format!("body ->> '$.{}'", path.join(".")));
        let places = [
            (&self.person, format!("concat_ws(' ', {})", people.join(", "))),
            (&self.text, "concat_ws(' ', weighing, kind, body)".to_owned()),
        ];
        for (words, place) in places {
            for word in words.iter().flat_map(|words| words.split_whitespace()) {
                sql.push(" AND ").contains(&place, word);
            }
        }
    }

    /// Whether this record is one of them. What stands for lost records always is: they might be.
    pub(super) fn takes(&self, record: &AuditRecord) -> bool {
        if record.kind == "lost" {
            return self.weighing.is_none() || self.weighing == record.weighing;
        }
        let is =
            |wanted: &Option<String>, is: Option<&str>| wanted.is_none() || wanted.as_deref() == is;
        let (weighing, kind) = (record.weighing.as_deref(), &*record.kind);
        let people = || {
            let names = PEOPLE.map(|path| {
                path.iter().try_fold(&record.body, |it, key| it.get(key)).and_then(Value::as_str)
            });
            names.into_iter().flatten().collect::<Vec<_>>().join(" ")
        };
        let all = || format!("{} {kind} {}", weighing.unwrap_or_default(), record.body);
        is(&self.weighing, weighing)
            && is(&self.kind, Some(kind))
            && self.since.is_none_or(|since| record.at >= since)
            && self.before.is_none_or(|before| record.at < before)
            && self.person.as_ref().is_none_or(|words| holds(&people(), words))
            && self.text.as_ref().is_none_or(|words| holds(&all(), words))
    }
}

/// Whether each of the words stands in the text; as in SQL, letters beyond ASCII have one case.
fn holds(text: &str, words: &str) -> bool {
    let text = text.to_ascii_lowercase();
    words.split_whitespace().all(|word| text.contains(&word.to_ascii_lowercase()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::audit::About;
    use crate::page::PageQuery;
    use crate::{now, testing};
    use serde_json::json;

    #[tokio::test]
    async fn sql_and_the_search_of_archives_choose_the_same_records() {
        let folder = tempfile::tempdir().unwrap();
        let store = testing::open(folder.path()).await.unwrap();
        let records = [
            (Some("w1"), "reading", json!({ "mass_mg": 5.25, "note": "100 % stable_now" })),
            (Some("w1"), "person", json!({ "action": "stop", "who": { "name": "Ada Byron" } })),
            (Some("w2"), "intent", json!({ "asked": { "operator": "ada" }, "powder": "salt" })),
            (None, "hold", json!({ "by": "Bob", "reason": "stop was pressed" })),
            (Some("w2"), "state", json!("dosing")),
        ];
        for (weighing, kind, body) in &records {
            let mut tx = store.write().await.unwrap();
            tx.audit(About { weighing: *weighing, kind }, body, now()).await.unwrap();
            tx.commit().await.unwrap();
        }
        let some = |text: &str| Some(text.to_owned());
        let none = AuditWanted::default;
        let all = [
            (none(), 7),
            (AuditWanted::of("w1"), 2),
            (AuditWanted { kind: some("state"), ..none() }, 1),
            (AuditWanted { person: some("ADA"), ..none() }, 2),
            (AuditWanted { person: some("byron ada"), ..none() }, 1),
            (AuditWanted { person: some("bob"), ..none() }, 1),
            (AuditWanted { person: some("mass_mg"), ..none() }, 0),
            (AuditWanted { text: some("STOP"), ..none() }, 2),
            (AuditWanted { text: some("100 %"), kind: some("reading"), ..none() }, 1),
            (AuditWanted { text: some("e_n"), kind: some("reading"), ..none() }, 1),
            (AuditWanted { text: some("w2 dosing"), ..none() }, 1),
            (AuditWanted { since: Some(Timestamp::from_unix_ms(i64::MAX)), ..none() }, 0),
            (AuditWanted { before: Some(Timestamp::from_unix_ms(1)), ..none() }, 0),
        ];
        let window = || PageQuery::first(200).window(200).unwrap();
        let every = store.audit_records(&none(), window()).await.unwrap().page.items;
        for (wanted, n) in all {
            let found = store.audit_records(&wanted, window()).await.unwrap();
            assert_eq!(found.page.items.len(), n, "{wanted:?}");
            assert_eq!(found.total, n as u64, "{wanted:?}");
            let taken: Vec<_> = every.iter().filter(|it| wanted.takes(it)).cloned().collect();
            assert_eq!(found.page.items, taken, "{wanted:?}");
        }
    }
}
