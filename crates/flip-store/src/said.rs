//! Compares rows other than weighings with the record: tokens, powders, their measurements,
//! imported spoonfuls, labels, checks of the bench, whether it is latched or held, and the current simulator.
//!
//! The record of an action holds the row it made; records of kind `rows` hold rows whose action
//! made many, or none. The compared fields are listed in [`row_says`]; a field that no record
//! mentions is not compared.

use super::audit::Written;
use super::benches::DEFAULT_BENCH;
use super::row::Columns;
use super::sql::Flag;
use super::{Result, tokens};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use sqlx::any::AnyRow;
use sqlx::{Any, Transaction};
use std::collections::{BTreeMap, BTreeSet};

/// Type of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RowOf {
    /// A token, except when it was last used.
    Token,
    /// A powder.
    Powder,
    /// A measurement of an angle of repose.
    Measurement,
    /// An observation other than the angle.
    Observation,
    /// A check of the bench.
    Check,
    /// A latch of the bench: whether it is open.
    Latch,
    /// A hold of the bench: whether it is open.
    Hold,
    /// The current version of the simulator.
    Simulator,
    /// A calibrated set, whose id derives from its values.
    ParameterSet,
    /// A spoonful that was imported.
    Spoonful,
    /// Up to when shakes of a powder are forgotten.
    Forgotten,
    /// The name, note and tags of something, and whether it is archived.
    Label,
    /// That a measurement or an observation no longer counts.
    Withdrawal,
    /// The mark that a stock-taking of rows without a record was done, and when.
    Stock,
}

impl RowOf {
    /// Its name, as in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Token => "token",
            Self::Powder => "powder",
            Self::Measurement => "measurement",
            Self::Observation => "observation",
            Self::Check => "check",
            Self::Latch => "latch",
            Self::Hold => "hold",
            Self::Simulator => "simulator",
            Self::ParameterSet => "parameter_set",
            Self::Spoonful => "spoonful",
            Self::Forgotten => "forgotten",
            Self::Label => "label",
            Self::Withdrawal => "withdrawal",
            Self::Stock => "stock",
        }
    }
}

/// A row that does not match the record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChangedOther {
    /// Its type.
    pub what: RowOf,
    /// Its id.
    pub id: String,
    /// Position of the record that contradicts it; absent if there is none.
    pub seq: Option<i64>,
    /// What differs.
    pub why: String,
}

/// A row as stored in a record of kind `rows`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    pub what: RowOf,
    pub id: String,
    pub row: Map<String, Value>,
}

impl Row {
    /// A row with the fields that callers see.
    pub fn of(what: RowOf, id: &str, row: &impl Serialize) -> Self {
        let row = match serde_json::to_value(row) {
            Ok(Value::Object(fields)) => fields,
            _ => Map::new(),
        };
        Self { what, id: id.to_owned(), row }
    }
}

/// Everything recorded so far.
#[derive(Debug, Default)]
pub(super) struct Said {
    rows: BTreeMap<(RowOf, String), (i64, Map<String, Value>)>,
}

/// All types with a table to compare with, and the table.
const TABLES: [(RowOf, &str); 14] = [
    (RowOf::Token, "SELECT * FROM token ORDER BY seq"),
    (RowOf::Powder, "SELECT * FROM powder ORDER BY seq"),
    (RowOf::Measurement, "SELECT * FROM measurement ORDER BY seq"),
    (RowOf::Observation, "SELECT * FROM observation ORDER BY seq"),
    (RowOf::Check, "SELECT * FROM bench_check ORDER BY seq"),
    (RowOf::Latch, "SELECT * FROM latch ORDER BY seq"),
    (RowOf::Hold, "SELECT * FROM bench_hold ORDER BY seq"),
    (RowOf::Simulator, "SELECT * FROM current_simulator ORDER BY seq DESC LIMIT 1"),
    (RowOf::ParameterSet, "SELECT * FROM parameter_set ORDER BY seq"),
    (RowOf::Spoonful, "SELECT * FROM spoonful ORDER BY seq"),
    (RowOf::Forgotten, "SELECT * FROM forgotten ORDER BY seq"),
    (RowOf::Label, "SELECT * FROM label ORDER BY seq"),
    (RowOf::Withdrawal, "SELECT * FROM withdrawal ORDER BY seq"),
    (RowOf::Stock, "SELECT * FROM stock"),
];

impl Said {
    /// Note the state of a row given by a record, if any.
    pub(super) fn hear(&mut self, record: &Written) {
        if !matches!(record.kind.as_str(), "person" | "rows" | "check" | "latch" | "hold" | "stock")
        {
            return;
        }
        let Ok(body) = serde_json::from_str::<Value>(&record.body) else { return };
        match record.kind.as_str() {
            "rows" => self.hear_rows(record.seq, &body),
            "check" => {
                let id = at_bench(check_id(&body["check"], record.at), body["bench_name"].as_str());
                self.say(
                    RowOf::Check,
                    id,
                    record.seq,
                    &json!({ "check": body["check"], "found": body["found"] }),
                );
            }
            "latch" => self.say_open(RowOf::Latch, record.seq, &body, ""),
            "hold" => self.say_open(RowOf::Hold, record.seq, &body, ""),
            "stock" => self.say(RowOf::Stock, TAKEN.to_owned(), record.seq, &stock_taken(&body)),
            _ => self.hear_deed(record.seq, &body),
        }
    }

    fn hear_deed(&mut self, seq: i64, body: &Value) {
        let named = |field: &str| body[field]["id"].as_str().unwrap_or_default().to_owned();
        match body["action"].as_str().unwrap_or_default() {
            "new token" => self.say(RowOf::Token, named("token"), seq, &body["token"]),
            // For all others the first record counts.
            "revoke token" => {
                let ended = json!({ "revoked_at": body["token"]["revoked_at"] });
                self.say(RowOf::Token, named("token"), seq, &ended);
            }
            "new powder" => {
                self.say(RowOf::Powder, named("powder"), seq, &body["powder"]);
                self.say(RowOf::Measurement, named("measurement"), seq, &body["measurement"]);
            }
            "new measurement" | "correct measurement" | "withdraw measurement" => {
                self.say(RowOf::Measurement, named("measurement"), seq, &body["measurement"]);
                self.say(RowOf::Withdrawal, named("withdrawal"), seq, &body["withdrawal"]);
            }
            "new observation" | "correct observation" | "withdraw observation" => {
                self.say(RowOf::Observation, named("observation"), seq, &body["observation"]);
                self.say(RowOf::Withdrawal, named("withdrawal"), seq, &body["withdrawal"]);
            }
            "label" => {
                let of = |field: &str| body["label"][field].as_str().unwrap_or_default();
                self.say(RowOf::Label, format!("{} {}", of("kind"), of("id")), seq, &body["label"]);
                self.say(RowOf::Powder, named("powder"), seq, &body["powder"]);
            }
            "forget shakes" => {
                self.say(RowOf::Forgotten, named("forgotten"), seq, &body["forgotten"])
            }
            "choose simulator" => {
                let chosen = json!({ "version": body["simulator"]["version"] });
                self.say(RowOf::Simulator, CHOSEN.to_owned(), seq, &chosen);
            }
            "clear" if body["latch"].is_object() => self.say_open(RowOf::Latch, seq, body, "latch"),
            "resume" => self.say_open(RowOf::Hold, seq, body, "held"),
            _ => {}
        }
    }

    /// Rows found by the stock-taking fill in fields not recorded before, and change none.
    fn hear_rows(&mut self, seq: i64, body: &Value) {
        let rows = body["rows"].as_array().into_iter().flatten();
        for Row { what, id, row } in rows.filter_map(|row| Row::deserialize(row).ok()) {
            let (_, said) = self.rows.entry((what, id)).or_insert_with(|| (seq, Map::new()));
            for (field, value) in row {
                said.entry(field).or_insert(value);
            }
        }
    }

    fn say(&mut self, what: RowOf, id: String, seq: i64, row: &Value) {
        // A different kind of action with the same name does not concern a row.
        if id.is_empty() {
            return;
        }
        let (last, said) = self.rows.entry((what, id)).or_default();
        *last = seq;
        said.extend(row.as_object().cloned().unwrap_or_default());
        said.remove("last_used_at");
    }

    fn say_open(&mut self, what: RowOf, seq: i64, body: &Value, field: &str) {
        let name = body["bench_name"].as_str();
        // Its record is the row itself, that of its end has it in a field.
        let (mut row, is_open) = match field {
            "" => (body.clone(), true),
            field => (body[field].clone(), false),
        };
        row["open"] = is_open.into();
        let id = row["at"].as_str().unwrap_or_default().to_owned();
        self.say(what, at_bench(id, name), seq, &row);
    }

    /// The fields of a row that no record has mentioned, if any.
    pub(super) fn unsaid(&self, what: RowOf, id: &str, row: Map<String, Value>) -> Option<Row> {
        let said = self.rows.get(&(what, id.to_owned())).map(|(_, said)| said);
        let is_new = |name: &String| said.is_none_or(|said| !said.contains_key(name));
        let row: Map<String, Value> = row.into_iter().filter(|(name, _)| is_new(name)).collect();
        (!row.is_empty() && what != RowOf::ParameterSet).then(|| Row {
            what,
            id: id.to_owned(),
            row,
        })
    }

    /// Rows that do not match the record, ordered by type.
    pub(super) async fn compare(
        &self,
        tx: &mut Transaction<'_, Any>,
        most: usize,
    ) -> Result<Vec<ChangedOther>> {
        let (mut changed, mut seen) = (Vec::new(), BTreeSet::new());
        for (what, id, row) in every_row(tx).await? {
            let said = self.rows.get(&(what, id.clone()));
            let why = match (&row, said) {
                (Err(why), _) => Some(why.clone()),
                (Ok(_), None) if what == RowOf::ParameterSet => None,
                (Ok(_), None) => Some("the record knows nothing of it".to_owned()),
                (Ok(row), Some((_, said))) => differs(row, said),
            };
            let seq = said.map(|(seq, _)| *seq);
            changed.extend(why.map(|why| ChangedOther { what, id: id.clone(), seq, why }));
            seen.insert((what, id));
        }
        for ((what, id), (seq, _)) in self.rows.iter().filter(|(key, _)| !seen.contains(key)) {
            let (seq, why) = (Some(*seq), "its row is gone".to_owned());
            changed.push(ChangedOther { what: *what, id: id.clone(), seq, why });
        }
        changed.truncate(most);
        Ok(changed)
    }
}

/// Id of the current choice.
const CHOSEN: &str = "current";
/// Id of the only mark.
const TAKEN: &str = "taken";

/// The mark as given by the record of the stock-taking: older ones do not state when it was made.
fn stock_taken(body: &Value) -> Value {
    body.get("at").map_or_else(|| json!({}), |at| json!({ "at": at }))
}

/// Type, id, and the fields or why they cannot be read.
type Found = (RowOf, String, std::result::Result<Map<String, Value>, String>);

/// Every row that is compared.
pub(super) async fn every_row(tx: &mut Transaction<'_, Any>) -> Result<Vec<Found>> {
    let mut found = Vec::new();
    for (what, sql) in TABLES {
        for row in sqlx::query(sql).fetch_all(&mut **tx).await? {
            let id = id_of(what, &row)?;
            let said = row_says(what, &row)
                .map_err(|error| format!("its row does not read as one: {error}"));
            let said = said.map(|said| match said {
                Value::Object(fields) => fields,
                _ => Map::new(),
            });
            found.push((what, id, said.and_then(|said| named_by_content(what, said))));
        }
    }
    Ok(found)
}

fn id_of(what: RowOf, row: &AnyRow) -> Result<String> {
    let name: Option<String> = row.maybe_plain("bench_name");
    let of_bench = |id| at_bench(id, name.as_deref());
    match what {
        RowOf::Check => {
            Ok(of_bench(check_id(&row.plain::<String>("kind")?.into(), row.plain("at")?)))
        }
        RowOf::Latch | RowOf::Hold => Ok(of_bench(row.time("at")?.to_string())),
        RowOf::Simulator => Ok(CHOSEN.to_owned()),
        RowOf::Stock => Ok(TAKEN.to_owned()),
        RowOf::Label => {
            Ok(format!("{} {}", row.plain::<String>("kind")?, row.plain::<String>("id")?))
        }
        _ => row.plain("id"),
    }
}

/// The id of a row of a bench: two benches may be stopped in the same millisecond.
fn at_bench(id: String, name: Option<&str>) -> String {
    match name {
        Some(name) if name != DEFAULT_BENCH => format!("{id} at {name}"),
        _ => id,
    }
}

fn check_id(kind: &Value, at_ms: i64) -> String {
    let at = flip_core::domain::timestamp::Timestamp::from_unix_ms(at_ms);
    format!("{} of {at}", kind.as_str().unwrap_or_default())
}

/// The fields of a row, by the names used in records.
fn row_says(what: RowOf, row: &AnyRow) -> Result<Value> {
    let text = |column: &str| row.plain::<Option<String>>(column);
    Ok(match what {
        RowOf::Token => tokens::says(row)?,
        RowOf::Powder => {
            let mut says = json!({ "id": text("id")?, "name": text("name")?, "created_at": row.time("created_at")? });
            if let Some(Flag(soluble)) = row.plain::<Option<Flag>>("soluble")? {
                says["soluble"] = soluble.into();
            }
            says
        }
        RowOf::Measurement => {
            json!({ "id": text("id")?, "powder": text("powder")?, "method": text("method")?,
            "repose_deg": row.plain::<f64>("repose_deg")?, "sd_deg": row.plain::<f64>("sd_deg")?, "n": row.count("n")?,
            "source": text("source")?, "created_at": row.time("created_at")? })
        }
        RowOf::Observation => {
            let body: Value = row.json("body")?;
            json!({ "id": text("id")?, "powder": text("powder")?, "observable": body["observable"], "mean": body["mean"],
                "sd": body["sd"], "n": body["n"], "source": text("source")?, "created_at": row.time("created_at")? })
        }
        RowOf::Check => json!({ "check": text("kind")?, "found": row.json::<Value>("body")? }),
        RowOf::Latch => {
            json!({ "at": row.time("at")?, "reason": text("reason")?, "weighing": text("weighing")?,
            "open": row.maybe_time("cleared_at")?.is_none() })
        }
        RowOf::Hold => {
            json!({ "at": row.time("at")?, "reason": text("reason")?, "by": text("held_by")?,
            "open": row.maybe_time("resumed_at")?.is_none() })
        }
        RowOf::Simulator => json!({ "version": text("version")? }),
        RowOf::ParameterSet => {
            json!({ "id": text("id")?, "parameters": row.json::<Value>("parameters")? })
        }
        RowOf::Spoonful => {
            let mut says: Value = row.json("body")?;
            // The columns beside it say the same of powder and lot, and must.
            says["powder"] = text("powder")?.into();
            if let Some(lot) = text("lot")? {
                says["lot"] = lot.into();
            }
            says["id"] = text("id")?.into();
            says["source"] = text("source")?.into();
            says["created_at"] = json!(row.time("created_at")?);
            says
        }
        RowOf::Forgotten => {
            let mut says =
                json!({ "id": text("id")?, "powder": text("powder")?, "at": row.time("at")? });
            if let Some(lot) = text("lot")? {
                says["lot"] = lot.into();
            }
            says
        }
        RowOf::Label => {
            json!({ "name": text("name")?, "note": text("note")?, "tags": row.json::<Value>("tags")?,
                "archived_at": row.maybe_time("archived_at")? })
        }
        RowOf::Withdrawal => {
            json!({ "id": text("id")?, "reason": text("reason")?, "replaced_by": text("replaced_by")?,
                "at": row.time("at")? })
        }
        RowOf::Stock => json!({ "at": row.time("at")? }),
    })
}

/// A set's id derives from its values, so changes show without a record.
fn named_by_content(
    what: RowOf,
    said: Map<String, Value>,
) -> std::result::Result<Map<String, Value>, String> {
    use flip_core::domain::parameters::ParameterSet;
    let values = said.get("parameters").filter(|_| what == RowOf::ParameterSet);
    let made = values.map(|values| ParameterSet::deserialize(values).map(|set| set.id()));
    match made {
        Some(Ok(id)) if said.get("id").and_then(Value::as_str) != Some(&id) => {
            Err(format!("its values were changed outside FLIP: they make the id {id}"))
        }
        Some(Err(error)) => Err(format!("its values do not read as a set: {error}")),
        _ => Ok(said),
    }
}

/// The names of differing fields, with both values; a field that no record mentions is not
/// compared.
fn differs(row: &Map<String, Value>, said: &Map<String, Value>) -> Option<String> {
    let one = |(name, now): (&String, &Value)| {
        let said = said.get(name)?;
        (said != now).then(|| format!("{name} is {now}, {said} was recorded"))
    };
    let found: Vec<String> = row.iter().filter_map(one).collect();
    (!found.is_empty()).then(|| format!("its row was changed outside FLIP: {}", found.join("; ")))
}
