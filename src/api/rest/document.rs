//! The parts of the OpenAPI document not stated by the routes themselves.

use super::extract::{BODY_BYTES_MAX, LARGE_BYTES_MAX};
use super::tables;
use crate::api::problem::{CONTENT_TYPE, Problem};
use crate::api::wire::{Event, Labelled, Powder};
use std::collections::BTreeMap;
use utoipa::openapi::path::{Operation, ParameterBuilder, ParameterIn, PathItem};
use utoipa::openapi::schema::{
    ArrayBuilder, Discriminator, KnownFormat, ObjectBuilder, Schema, SchemaFormat, Type,
};
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{ContentBuilder, OpenApi, Ref, RefOr, Response, ResponseBuilder};
use utoipa::{Modify, OpenApi as _};

const TOKEN: &str = "token";

#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "FLIP",
        description = "Flowability-informed powder weighing. Masses are in mg, angles in degrees, times on the bench in \
            seconds, unless a name says otherwise. Reading needs no token on a loopback address; writing always does. \
            Every refusal is an RFC 9457 problem that names the fields at fault."
    ),
    // Of generic bodies within generic bodies only the outer one is found.
    components(schemas(Problem, Labelled<Powder>, Event)),
    servers((url = "/", description = "Where this document came from")),
    tags(
        (name = "powders", description = "Real powders and their measured flowability"),
        (name = "shakes", description = "What spoons let fall, shake by shake: of weighings, and imported"),
        (name = "parameters", description = "The nine parameters of simulated powders, and calibrated sets of them"),
        (name = "calibrations", description = "From a flowability to parameter sets"),
        (name = "trainings", description = "From parameter sets to a policy"),
        (name = "policies", description = "Trained policies and their files"),
        (name = "evaluations", description = "A policy's errors on the simulated bench"),
        (name = "investigations", description = "What the simulator gets wrong, and why"),
        (name = "weighings", description = "Doses of powder"),
        (name = "bench", description = "The robot, its balance and its spoon: what it does, and whether it may be used"),
        (name = "audit", description = "The record of what was done, by whom, in a chain of hashes"),
        (name = "jobs", description = "Long computations: follow, cancel, start again"),
        (name = "labels", description = "Names, notes and tags of everything, and what lists hide"),
        (name = "films", description = "What the grains of a weighing or a heap did, made again by the simulator"),
        (name = "events", description = "All events, live"),
        (name = "tokens", description = "Keys for programs and people"),
        (name = "webhooks", description = "Addresses that are told when something has ended"),
    ),
    modifiers(&Token),
)]
struct Head;

struct Token;

impl Modify for Token {
    fn modify(&self, document: &mut OpenApi) {
        let scheme =
            HttpBuilder::new().scheme(HttpAuthScheme::Bearer).bearer_format("flip_…").build();
        let components = document.components.get_or_insert_default();
        components.add_security_scheme(TOKEN, SecurityScheme::Http(scheme));
    }
}

/// Title, tags and the token scheme.
pub fn head() -> OpenApi {
    Head::openapi()
}

/// Completes the document with what follows from the shape of each operation: who may call it and
/// which errors it returns. Bodies of paths that are `large` may hold images or tables.
pub fn complete(mut document: OpenApi, large: impl Fn(&str) -> bool) -> OpenApi {
    for (path, item) in &mut document.paths.paths {
        let (has_id, follows) = (path.contains('{'), path.ends_with("/events"));
        for (safe, operation) in operations(item) {
            operation.security = Some(security(safe));
            let has_body = operation.request_body.is_some();
            type_bodies(operation);
            let refuse = |operation: &mut Operation, status: &str, meaning: &str| {
                operation
                    .responses
                    .responses
                    .entry(status.to_owned())
                    .or_insert_with(|| RefOr::T(problem(meaning)));
            };
            refuse(operation, "400", "The request is not valid; `errors` names the fields");
            refuse(operation, "401", "A valid token is needed");
            refuse(
                operation,
                "403",
                "The token's role is not sufficient, or the request is from another origin",
            );
            if has_id {
                refuse(operation, "404", "Not found");
            }
            if follows {
                refuse(
                    operation,
                    "429",
                    "This connection or address already follows too many streams",
                );
            }
            if has_body {
                let bytes_max = if large(path) { LARGE_BYTES_MAX } else { BODY_BYTES_MAX };
                refuse(operation, "408", "The body did not arrive in time");
                refuse(
                    operation,
                    "413",
                    &format!("The body is larger than {} MiB", bytes_max / (1024 * 1024)),
                );
                refuse(operation, "415", "The body is not JSON");
            }
            refuse(operation, "500", "Server error; the log has the cause under `instance`");
            refuse(operation, "503", "Temporarily unavailable, e.g. while shutting down");
        }
    }
    name_items(&mut document);
    name_variants(&mut document);
    offer_tables(&mut document);
    document
}

/// Types what is not JSON as clients' generators expect it: files as binary, streams as text.
fn type_bodies(operation: &mut Operation) {
    let responses = operation.responses.responses.values_mut().filter_map(|it| match it {
        RefOr::T(response) => Some(&mut response.content),
        RefOr::Ref(_) => None,
    });
    let request = operation.request_body.iter_mut().filter_map(|it| match it {
        RefOr::T(body) => Some(&mut body.content),
        RefOr::Ref(_) => None,
    });
    let responses = responses.flat_map(|content| content.iter_mut());
    for (kind, content) in responses.chain(request.flat_map(|content| content.iter_mut())) {
        let RefOr::T(content) = content else { continue };
        let format = match kind.as_str() {
            "application/octet-stream" => Some(SchemaFormat::KnownFormat(KnownFormat::Binary)),
            "text/event-stream" => None,
            _ => continue,
        };
        let text = ObjectBuilder::new().schema_type(Type::String).format(format).build();
        content.schema = Some(RefOr::T(Schema::Object(text)));
    }
}

/// Gives each variant of a union, which utoipa would inline, a schema under its title, and tells
/// which property tells them apart.
fn name_variants(document: &mut OpenApi) {
    let schemas = &mut document.components.get_or_insert_default().schemas;
    let mut named = Vec::new();
    for schema in schemas.values_mut() {
        let RefOr::T(Schema::OneOf(union)) = schema else { continue };
        let mut mapping = BTreeMap::new();
        let mut tag = None;
        for item in &mut union.items {
            let RefOr::T(Schema::Object(variant)) = item else { continue };
            let Some(title) = variant.title.clone() else { continue };
            let tagged = variant.properties.iter().find_map(|(property, schema)| match schema {
                RefOr::T(Schema::Object(values)) => {
                    let only = values.enum_values.as_deref()?;
                    let [serde_json::Value::String(value)] = only else { return None };
                    Some((property.clone(), value.clone()))
                }
                _ => None,
            });
            let Some((property, value)) = tagged else { continue };
            let reference = Ref::from_schema_name(&title);
            mapping.insert(value, reference.ref_location.clone());
            tag = Some(property);
            named.push((title, std::mem::replace(item, RefOr::Ref(reference))));
        }
        union.discriminator = tag.map(|tag| Discriminator::with_mapping(tag, mapping));
    }
    schemas.extend(named);
}

/// Says of each list that it can be a table.
fn offer_tables(document: &mut OpenApi) {
    let Ok(written) = serde_json::to_value(&*document) else { return };
    for (path, item) in &mut document.paths.paths {
        if let (Some(operation), true) = (&mut item.get, tables::is_list(&written, path)) {
            let format = ParameterBuilder::new()
                .name("format")
                .parameter_in(ParameterIn::Query)
                .description(Some(
                    "`csv` or `arrow`: all pages as one table, or the page that `limit` and `after` name; default `json`. \
                     Also by `Accept: text/csv` or `application/vnd.apache.arrow.file`.",
                ))
                .schema(Some(
                    ObjectBuilder::new()
                        .schema_type(Type::String)
                        .enum_values(Some(["json", "csv", "arrow"])),
                ));
            operation.parameters.get_or_insert_default().push(format.build().into());
        }
    }
}

/// Makes a page's schema refer to the schema of its items, where utoipa would inline it.
fn name_items(document: &mut OpenApi) {
    for (name, schema) in &mut document.components.get_or_insert_default().schemas {
        if let (Some(item), RefOr::T(Schema::Object(page))) = (name.strip_prefix("Page_"), schema) {
            let items = ArrayBuilder::new().items(Ref::from_schema_name(item)).build();
            page.properties.insert("items".to_owned(), RefOr::T(Schema::Array(items)));
        }
    }
}

/// The operations of a path, each with whether it is read-only.
fn operations(item: &mut PathItem) -> impl Iterator<Item = (bool, &mut Operation)> {
    let reads = item.get.iter_mut().map(|operation| (true, operation));
    let writes = [&mut item.post, &mut item.put, &mut item.patch, &mut item.delete];
    reads.chain(writes.into_iter().flatten().map(|operation| (false, operation)))
}

/// An empty requirement means that no token is needed (on a loopback address).
fn security(safe: bool) -> Vec<SecurityRequirement> {
    let token = SecurityRequirement::new(TOKEN, Vec::<String>::new());
    if safe { vec![SecurityRequirement::default(), token] } else { vec![token] }
}

fn problem(meaning: &str) -> Response {
    let body = ContentBuilder::new().schema(Some(Ref::from_schema_name("Problem"))).build();
    ResponseBuilder::new().description(meaning).content(CONTENT_TYPE, body).build()
}
