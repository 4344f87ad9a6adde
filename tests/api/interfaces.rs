//! One name for one thing: what REST, gRPC and the command line can do stands in one table, and what
//! one of them lacks has a reason. `UPDATE=1` writes the table into docs/interfaces.md.

use crate::document::operations;
use flip::api::grpc::DESCRIPTORS;
use flip::api::grpc::access::methods;
use prost::Message;
use prost_types::FileDescriptorSet;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// REST operation, gRPC method, command, and why one of them is missing; `-` where it is.
const OPERATIONS: &[[&str; 4]] = &include!("interfaces_table.rs");

/// Messages of both interfaces whose fields differ, with the fields of REST alone and of gRPC alone,
/// and why.
const FIELDS: &[(&str, &[&str], &[&str], &str)] = &include!("interfaces_fields.rs");

fn column(k: usize) -> Vec<&'static str> {
    OPERATIONS.iter().map(|row| row[k]).filter(|name| *name != "-").collect()
}

fn assert_same(what: &str, table: &[&str], code: &BTreeSet<String>) {
    let told: BTreeSet<String> = table.iter().map(|name| (*name).to_owned()).collect();
    let missing: Vec<_> = code.difference(&told).collect();
    let gone: Vec<_> = told.difference(code).collect();
    assert!(
        missing.is_empty() && gone.is_empty(),
        "{what}: not in the table: {missing:?}; only in the table: {gone:?}"
    );
}

#[test]
fn every_operation_is_in_the_table_and_what_is_missing_has_a_reason() {
    let rest =
        operations().into_iter().map(|(_, _, it)| it["operationId"].as_str().unwrap().to_owned());
    assert_same("REST", &column(0), &rest.collect());
    let grpc = methods().map(|path| path.trim_start_matches("/flip.v1.").to_owned());
    assert_same("gRPC", &column(1), &grpc.collect());
    assert_same("command line", &column(2), &commands());
    for row in OPERATIONS {
        let complete = row[..3].iter().all(|name| *name != "-");
        assert!(complete || !row[3].is_empty(), "{row:?} lacks something for no reason");
    }
}

/// Every command that does something, as `bench clear`.
fn commands() -> BTreeSet<String> {
    fn leaves(command: &clap::Command, name: &str, into: &mut BTreeSet<String>) {
        let below =
            command.get_subcommands().filter(|it| it.get_name() != "help" && !it.is_hide_set());
        let below: Vec<_> = below.collect();
        if below.is_empty() || !command.is_subcommand_required_set() && !name.is_empty() {
            into.insert(name.to_owned());
        }
        for command in below {
            let name = format!("{name} {}", command.get_name()).trim().to_owned();
            leaves(command, &name, into);
        }
    }
    let mut all = BTreeSet::new();
    leaves(&flip::cli::command(), "", &mut all);
    all
}

#[test]
fn the_fields_of_both_interfaces_are_the_same_or_have_a_reason() {
    let document = serde_json::to_value(flip::api::rest::openapi()).unwrap();
    let schemas = document["components"]["schemas"].as_object().unwrap();
    let mut differences = BTreeMap::new();
    for (name, fields) in messages() {
        let Some(schema) = schemas.get(&name) else { continue };
        let rest = properties(&document, schema);
        if rest.is_empty() {
            continue;
        }
        // Names, notes and tags are beside what they are of in REST, in a field of it in gRPC.
        let grpc: BTreeSet<_> = fields.into_iter().filter(|field| field != "label").collect();
        let of_rest: Vec<_> = rest.difference(&grpc).cloned().collect();
        let of_grpc: Vec<_> = grpc.difference(&rest).cloned().collect();
        if !of_rest.is_empty() || !of_grpc.is_empty() {
            differences.insert(name, (of_rest, of_grpc));
        }
    }
    let words = |all: &[&str]| all.iter().map(|it| (*it).to_owned()).collect::<Vec<_>>();
    let told: BTreeMap<_, _> = FIELDS
        .iter()
        .map(|(name, rest, grpc, why)| {
            assert!(!why.is_empty(), "{name}");
            ((*name).to_owned(), (words(rest), words(grpc)))
        })
        .collect();
    assert_eq!(differences, told);
}

fn messages() -> BTreeMap<String, BTreeSet<String>> {
    let files = FileDescriptorSet::decode(DESCRIPTORS).unwrap().file;
    let own = files.into_iter().filter(|file| file.package() == "flip.v1");
    own.flat_map(|file| file.message_type)
        .map(|message| {
            let fields = message.field.iter().map(|field| field.name().to_owned()).collect();
            (message.name().to_owned(), fields)
        })
        .collect()
}

fn properties(document: &Value, schema: &Value) -> BTreeSet<String> {
    if let Some(pointer) = schema["$ref"].as_str() {
        return properties(document, document.pointer(pointer.trim_start_matches('#')).unwrap());
    }
    let own = schema["properties"].as_object().into_iter().flat_map(|it| it.keys().cloned());
    let parts = schema["allOf"].as_array().into_iter().flatten();
    own.chain(parts.flat_map(|part| properties(document, part))).collect()
}

const BEGIN: &str = "<!-- operations -->\n";
const END: &str = "<!-- end of operations -->\n";

#[test]
fn the_documentation_has_the_table() {
    let mut table = String::from("\n| REST | gRPC | command line | |\n|---|---|---|---|\n");
    for [rest, grpc, command, why] in OPERATIONS {
        let code = |text: &str, before: &str| match text {
            "-" => String::new(),
            name => format!("`{before}{name}`"),
        };
        let (rest, grpc, command) = (code(rest, ""), code(grpc, ""), code(command, "flip "));
        writeln!(table, "| {rest} | {grpc} | {command} | {why} |").unwrap();
    }
    table.push_str("\n| message | REST alone | gRPC alone | |\n|---|---|---|---|\n");
    for (name, rest, grpc, why) in FIELDS {
        let all = |names: &[&str]| {
            names.iter().map(|it| format!("`{it}`")).collect::<Vec<_>>().join(", ")
        };
        writeln!(table, "| `{name}` | {} | {} | {why} |", all(rest), all(grpc)).unwrap();
    }
    table.push('\n');
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/interfaces.md");
    let text = std::fs::read_to_string(path).unwrap();
    let (before, rest) = text.split_once(BEGIN).expect("where it begins");
    let (told, after) = rest.split_once(END).expect("where it ends");
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(path, format!("{before}{BEGIN}{table}{END}{after}")).unwrap();
    } else {
        assert!(told == table, "docs/interfaces.md is older than the interfaces: UPDATE=1");
    }
}
