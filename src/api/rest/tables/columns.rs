//! The columns of a list as a table, from its schema in the OpenAPI document.

use serde_json::{Map, Value};

/// A column: where its values stand in an item, and what they are.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// The names of the fields that lead to it, joined by dots.
    pub name: String,
    path: Vec<String>,
    /// What its values are.
    pub kind: Kind,
}

/// What the values of a column are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A number.
    Number,
    /// A whole number.
    Integer,
    /// True or false.
    Truth,
    /// A time, RFC 3339.
    Time,
    /// A text.
    Text,
    /// Something with parts of its own, as JSON.
    Json,
}

impl Kind {
    /// As a word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Number => "number",
            Self::Integer => "integer",
            Self::Truth => "boolean",
            Self::Time => "time",
            Self::Text => "text",
            Self::Json => "json",
        }
    }
}

impl Column {
    /// The column of a field of the item itself.
    pub fn at_top(name: &str, kind: Kind) -> Self {
        Self { name: name.to_owned(), path: vec![name.to_owned()], kind }
    }

    /// The value of an item in this column; `Null` where it has none.
    pub fn of<'a>(&self, item: &'a Value) -> &'a Value {
        self.path.iter().fold(item, |inside, name| &inside[name.as_str()])
    }
}

/// The columns of the list that a path answers with; `None` if it answers with something else.
pub fn columns(document: &Value, path: &str) -> Option<Vec<Column>> {
    let answer = &document["paths"][path]["get"]["responses"]["200"]["content"];
    let schema = resolve(document, &answer["application/json"]["schema"]);
    let items = match schema["type"].as_str() {
        Some("array") => &schema["items"],
        _ => schema["properties"].get("items").filter(|it| it["type"] == "array")?.get("items")?,
    };
    let mut found = Vec::new();
    collect(document, items, &mut Vec::new(), &mut found);
    // An item without fields of its own is no row.
    found.iter().all(|column| !column.path.is_empty()).then_some(found)
}

fn resolve<'a>(document: &'a Value, schema: &'a Value) -> &'a Value {
    match schema["$ref"].as_str().and_then(|it| it.strip_prefix('#')) {
        Some(pointer) => document.pointer(pointer).map_or(schema, |it| resolve(document, it)),
        None => schema,
    }
}

fn collect(document: &Value, schema: &Value, path: &mut Vec<String>, into: &mut Vec<Column>) {
    let schema = resolve(document, schema);
    if let Some(parts) = schema["allOf"].as_array() {
        return parts.iter().for_each(|part| collect(document, part, path, into));
    }
    if let Some(choices) = schema["oneOf"].as_array() {
        let mut choices = choices.iter().filter(|it| it["type"] != "null");
        if let (Some(only), None) = (choices.next(), choices.next()) {
            return collect(document, only, path, into);
        }
    }
    if let Some(fields) = fields(schema) {
        for (name, field) in fields {
            path.push(name.clone());
            collect(document, field, path, into);
            path.pop();
        }
        return;
    }
    into.push(Column { name: path.join("."), path: path.clone(), kind: kind(schema) });
}

/// The fields of an object whose fields are known.
fn fields(schema: &Value) -> Option<&Map<String, Value>> {
    schema["properties"].as_object().filter(|fields| !fields.is_empty())
}

fn kind(schema: &Value) -> Kind {
    let word = |it: &Value| it["type"].as_str() == Some("string");
    let name = match &schema["type"] {
        Value::Array(names) => names.iter().find(|name| *name != "null"),
        name => Some(name),
    };
    match (name.and_then(Value::as_str), schema["format"].as_str()) {
        (Some("number"), _) => Kind::Number,
        (Some("integer"), _) => Kind::Integer,
        (Some("boolean"), _) => Kind::Truth,
        (Some("string"), Some("date-time")) => Kind::Time,
        (Some("string"), _) => Kind::Text,
        _ if schema["oneOf"].as_array().is_some_and(|all| all.iter().all(word)) => Kind::Text,
        _ => Kind::Json,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn every_list_of_the_document_is_a_table() {
        let document = serde_json::to_value(crate::api::rest::openapi()).unwrap();
        let lists = document["paths"].as_object().unwrap().iter().filter(|(_, item)| {
            let schema = &item["get"]["responses"]["200"]["content"]["application/json"]["schema"];
            let schema = resolve(&document, schema);
            schema["type"] == "array" || schema["properties"]["next"].is_object()
        });
        let mut count = 0;
        for (path, _) in lists {
            let columns = columns(&document, path).unwrap_or_else(|| panic!("{path}"));
            let mut names: Vec<_> = columns.iter().map(|column| &column.name).collect();
            assert!(!names.is_empty(), "{path}");
            names.sort();
            names.dedup();
            assert_eq!(names.len(), columns.len(), "{path}: no name twice");
            count += 1;
        }
        assert!(count >= 20, "{count} lists");
    }

    #[test]
    fn the_columns_of_weighings_have_their_kinds() {
        let document = serde_json::to_value(crate::api::rest::openapi()).unwrap();
        let columns = columns(&document, "/v1/weighings").unwrap();
        let kind = |name: &str| columns.iter().find(|it| it.name == name).map(|it| it.kind);
        assert_eq!(kind("target_mg"), Some(Kind::Number));
        assert_eq!(kind("seed"), Some(Kind::Integer));
        assert_eq!(kind("outcome"), Some(Kind::Text));
        assert_eq!(kind("created_at"), Some(Kind::Time));
        assert_eq!(kind("asked.lot"), Some(Kind::Text));
        assert_eq!(kind("measured.proven"), Some(Kind::Truth));
        assert_eq!(kind("label.tags"), Some(Kind::Json));
        let lot = columns.iter().find(|it| it.name == "asked.lot").unwrap();
        assert_eq!(lot.of(&json!({ "asked": { "lot": "L" } })), "L");
        assert_eq!(lot.of(&json!({})), &Value::Null);
    }

    #[test]
    fn what_is_no_list_has_no_columns() {
        let document = serde_json::to_value(crate::api::rest::openapi()).unwrap();
        for path in ["/v1/bench", "/v1/bench/checklist", "/v1/weighings/{id}", "/v1/nothing"] {
            assert_eq!(columns(&document, path), None, "{path}");
        }
    }
}
