//! Checks the map of `src/ARCHITECTURE.md`: who may import whom, which crate is used where, and
//! what no file may contain.

use std::fs;
use std::path::{Path, PathBuf};

/// Room, and the rooms it may name; a room may always name itself. A crate of one room is not here: its manifest says what it may name.
const ARROWS: [(&str, &[&str]); 26] = [
    ("domain", &[]),
    ("stats", &[]),
    ("card", &["domain", "stats"]),
    ("learner", &[]),
    ("hardware", &["domain"]),
    ("emulate", &["domain", "stats", "sim", "hardware"]),
    ("pile", &["domain", "stats", "hardware"]),
    ("weigh", &["domain", "stats", "hardware", "policy"]),
    ("rig", &["domain", "sim", "policy", "hardware", "emulate", "weigh"]),
    ("calibrate", &["domain", "stats"]),
    ("train", &["domain", "learner", "sim", "policy", "stats"]),
    (
        "jobs",
        &[
            "domain",
            "stats",
            "sim",
            "policy",
            "hardware",
            "emulate",
            "pile",
            "calibrate",
            "discover",
            "train",
            "weigh",
            "rig",
            "store",
            // Jobs that ask for a graphics card; nobody else may depend on there being one.
            "cuda",
        ],
    ),
    (
        "app",
        &[
            "domain", "stats", "card", "store", "jobs", "policy", "discover", "emulate",
            "hardware", "pile", "rig",
        ],
    ),
    ("api", &["domain", "app"]),
    ("cli", &["domain", "sim", "hardware", "emulate", "rig", "app", "api", "telemetry"]),
    ("telemetry", &[]),
    // The rooms of flip-discover, in the order in which they may name each other.
    ("thresholds", &[]),
    ("data", &["domain", "stats", "thresholds"]),
    ("report", &["domain", "stats", "thresholds", "data"]),
    ("causes", &["domain", "stats", "thresholds", "data", "report"]),
    ("judge", &["domain", "stats", "thresholds", "data", "report", "causes"]),
    ("worth", &["domain", "stats", "thresholds", "data", "report", "causes", "judge"]),
    ("extend", &["domain", "stats", "thresholds", "data", "report", "causes", "judge"]),
    ("traces", &["domain", "stats", "thresholds", "report", "judge"]),
    ("spoon", &["domain", "stats", "thresholds", "report", "judge", "extend"]),
    (
        "investigate",
        &["domain", "stats", "thresholds", "data", "report", "causes", "judge", "worth", "traces"],
    ),
];

/// Crates that are one room.
const ALONE: [&str; 6] = ["cuda", "discover", "grains", "policy", "sim", "store"];

/// Crates of several rooms.
const HOUSES: [&str; 3] = ["flip-bench", "flip-core", "flip-learn"];

/// Crates of several rooms that are one room to every other crate.
const CLOSED_HOUSES: [&str; 1] = ["flip-discover"];

/// File or folder, and what it may name beyond its room's arrows.
const EXCEPTIONS: [(&str, &[&str]); 2] = [
    // The contract of REST names each type that an answer is made from.
    (
        "src/api/wire/",
        &["store", "discover", "sim", "hardware", "pile", "rig", "calibrate", "train"],
    ),
    // The simulated bench is the one driver whose device is the simulator.
    ("crates/flip-bench/src/hardware/simulated.rs", &["sim"]),
];

/// Names allowed in some modules only: crates that talk to the world, and words that mark
/// asynchronous code.
const CONFINED: [(&str, &[&str]); 41] = [
    ("sqlx::", &["store", "testing"]),
    ("object_store::", &["store"]),
    ("axum::", &["api"]),
    ("utoipa::", &["api"]),
    ("ToSchema", &["api"]),
    ("hyper_util::", &["api", "hardware", "emulate"]),
    ("http_body::", &["api"]),
    ("tokio_rustls::", &["api"]),
    // The arm's driver is a gRPC server, emulated or not.
    ("tonic::", &["api", "hardware", "emulate"]),
    ("prost::", &["api"]),
    ("rcgen::", &["api"]),
    ("mdns_sd::", &["api"]),
    ("if_addrs::", &["api"]),
    ("serialport::", &["hardware"]),
    ("tokio_modbus::", &["hardware"]),
    ("tokio_serial::", &["hardware"]),
    ("toml::", &["hardware", "cli"]),
    ("png::", &["hardware", "emulate"]),
    ("tower_http::", &["api"]),
    ("tch::", &["train"]),
    ("csv::", &["app", "api"]),
    ("arrow_array::", &["api"]),
    ("arrow_ipc::", &["api"]),
    ("arrow_schema::", &["api"]),
    ("zip::", &["api"]),
    ("jsonwebtoken::", &["app"]),
    ("ureq::", &["app", "cli"]),
    ("maud::", &["app"]),
    // The simulator's are its batches of spoons.
    (
        "rayon::",
        &["calibrate", "judge", "investigate", "traces", "train", "jobs", "cli", "python", "sim"],
    ),
    ("clap::", &["cli"]),
    ("indicatif::", &["cli"]),
    ("rustix::", &["api", "cli", "emulate", "hardware", "jobs", "store", "testing"]),
    ("anyhow::", &["cli"]),
    // Drivers and emulators are synchronous outside; their own runtimes wait for remote calls.
    ("tokio::", &["store", "jobs", "app", "api", "cli", "hardware", "emulate"]),
    ("async fn", &["store", "jobs", "app", "api", "cli", "hardware", "emulate", "testing"]),
    ("std::fs", &["store", "api", "cli", "emulate", "testing"]),
    ("std::net", &["api", "cli", "hardware", "emulate", "testing"]),
    (
        "Instant",
        &[
            "hardware", "emulate", "rig", "jobs", "store", "app", "api", "cli", "train", "python",
            "cuda",
        ],
    ),
    ("cudarc::", &["cuda"]),
    ("pyo3::", &["python"]),
    ("numpy::", &["python"]),
];

/// What the bodies of jobs consist of: they run wherever somebody implements `JobHost`.
const BODIES: [&str; 10] = [
    "calibrate",
    "evaluate",
    "heaps",
    "host",
    "investigate",
    "observe",
    "replays",
    "repose",
    "runner",
    "train",
];

/// Words that such a file may not hold.
const DATABASE: [&str; 7] = ["Store", "Tx", "Lease", "Artifacts", "sqlx::", "tokio::", "async"];

/// Names that say nothing about what a file holds.
const BANNED_NAMES: [&str; 8] =
    ["utils", "util", "helpers", "helper", "common", "manager", "misc", "model"];

/// Maximum lines of a file, at 100 columns; files are reviewed from 450.
const LINES_MAX: usize = 500;

/// One source file: its path below the root, its room, its text, and that text without comments and unit tests.
struct Source {
    path: String,
    room: String,
    text: String,
    code: String,
}

/// The room of a file: its folder below the service's `src` or below that of a crate of several rooms; else its crate's name.
fn room(path: &str) -> &str {
    match path.strip_prefix("crates/").and_then(|rest| rest.split_once("/src/")) {
        Some((house, inside)) if HOUSES.contains(&house) || CLOSED_HOUSES.contains(&house) => {
            inside.split('/').next().unwrap_or_default()
        }
        Some((house, _)) => house.trim_start_matches("flip-"),
        None => path.trim_start_matches("src/").split('/').next().unwrap_or_default(),
    }
    .trim_end_matches(".rs")
}

fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => files(&path, found),
            false => found.push(path),
        }
    }
}

fn sources() -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut paths = Vec::new();
    files(&root.join("src"), &mut paths);
    for entry in fs::read_dir(root.join("crates")).unwrap() {
        files(&entry.unwrap().path().join("src"), &mut paths);
    }
    paths.retain(|path| path.extension().is_some_and(|e| e == "rs"));
    paths.sort();
    let read = |path: PathBuf| {
        let text = fs::read_to_string(&path).unwrap();
        // Unit tests may cross the map, in their file or in one of their own.
        let product = match path.to_string_lossy().ends_with("tests.rs") {
            true => "",
            false => text.split("\n#[cfg(test)]\nmod ").next().unwrap_or_default(),
        };
        let uncommented = product.lines().filter(|line| !line.trim_start().starts_with("//"));
        let code = uncommented.collect::<Vec<_>>().join("\n");
        let path = path.strip_prefix(root).unwrap().display().to_string();
        Source { room: room(&path).to_owned(), path, code, text }
    };
    paths.into_iter().map(read).collect()
}

/// Every room named in `code`: by `crate::room`, by `flip_house::room`, or by `flip_room` where a crate is one.
fn named_rooms(code: &str) -> Vec<&str> {
    let end =
        |rest: &str| rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
    let after = |mark: &str| -> Vec<&str> {
        code.split(mark).skip(1).map(|rest| &rest[..end(rest)]).collect()
    };
    let houses = HOUSES.map(|house| format!("{}::", house.replace('-', "_")));
    let alone = |room: &&str| {
        ["::", " as "].iter().any(|tail| code.contains(&format!("flip_{room}{tail}")))
    };
    let within = houses.iter().flat_map(|mark| after(mark));
    after("crate::").into_iter().chain(within).chain(ALONE.into_iter().filter(alone)).collect()
}

/// Every occurrence of `word` in `code` that does not continue an identifier.
fn holds(code: &str, word: &str) -> bool {
    let starts_identifier =
        |at: usize| !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':');
    code.match_indices(word).any(|(at, _)| starts_identifier(at))
}

fn check(offences: Vec<String>) {
    assert!(offences.is_empty(), "{} offences:\n{}", offences.len(), offences.join("\n"));
}

#[test]
fn rooms_import_only_what_the_map_allows() {
    let mut offences = Vec::new();
    for source in sources() {
        let Some((_, allowed)) = ARROWS.iter().find(|(name, _)| *name == source.room) else {
            continue;
        };
        let more = EXCEPTIONS
            .iter()
            .find(|(path, _)| source.path.starts_with(path))
            .map_or(&[] as &[&str], |(_, more)| *more);
        for name in named_rooms(&source.code) {
            if name.is_empty() {
                offences.push(format!("{}: one `use crate::room::…` a line, please", source.path));
            } else if name != source.room && !allowed.contains(&name) && !more.contains(&name) {
                offences
                    .push(format!("{}: names {name}, which {} may not", source.path, source.room));
            }
        }
    }
    check(offences);
}

#[test]
fn every_room_is_on_the_map() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let manifests: Vec<String> = fs::read_dir(root.join("crates"))
        .unwrap()
        .map(|entry| {
            entry.unwrap().file_name().to_string_lossy().trim_start_matches("flip-").to_owned()
        })
        .collect();
    let is_known = |room: &str| {
        ARROWS.iter().any(|(name, _)| *name == room)
            || manifests.iter().any(|name| name == room)
            || ["lib", "main"].contains(&room)
    };
    check(
        sources()
            .into_iter()
            .filter(|source| !is_known(&source.room))
            .map(|source| source.path)
            .collect(),
    );
}

#[test]
fn crates_and_clocks_stay_where_they_belong() {
    let mut offences = Vec::new();
    for source in sources() {
        for (word, places) in CONFINED {
            if holds(&source.code, word) && !places.contains(&&*source.room) {
                offences.push(format!(
                    "{}: `{word}` belongs in {}",
                    source.path,
                    places.join(", ")
                ));
            }
        }
    }
    check(offences);
}

#[test]
fn the_bodies_of_jobs_see_no_database() {
    let mut offences = Vec::new();
    let bodies = BODIES.map(|name| format!("src/jobs/{name}.rs"));
    let sources: Vec<Source> =
        sources().into_iter().filter(|source| bodies.contains(&source.path)).collect();
    assert_eq!(sources.len(), bodies.len());
    for source in sources {
        for word in DATABASE.iter().filter(|word| holds(&source.code, word)) {
            offences.push(format!("{}: `{word}` is the host's business", source.path));
        }
    }
    check(offences);
}

#[test]
fn files_are_named_for_what_they_hold_and_are_short_enough_to_read() {
    let mut offences = Vec::new();
    for source in sources() {
        for part in source
            .path
            .trim_end_matches(".rs")
            .split('/')
            .filter(|part| BANNED_NAMES.contains(part))
        {
            offences.push(format!("{}: `{part}` names nothing", source.path));
        }
        let lines = source.text.lines().count();
        if lines > LINES_MAX {
            offences.push(format!(
                "{}: {lines} lines; split it where its second idea begins",
                source.path
            ));
        }
    }
    check(offences);
}

/// Whether the line leaves a test to a command that takes longer than `make test`.
fn is_left_to_a_longer_run(line: &str) -> bool {
    line.starts_with(concat!("#[ig", "nore = \"takes "))
        && ["laws", "test-long"]
            .iter()
            .any(|it| line.ends_with(&format!("; `make {it}` runs it\"]")))
}

#[test]
fn nothing_is_left_unfinished_or_switched_off() {
    let mut offences = Vec::new();
    let mut paths = Vec::new();
    for folder in ["src", "crates", "tests", "benches", "examples"] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
        if folder.exists() {
            files(&folder, &mut paths);
        }
    }
    // Split so that this list does not find itself.
    let marks = [
        concat!("#[ig", "nore"),
        concat!("to", "do!("),
        concat!("unimple", "mented!("),
        concat!("dbg", "!("),
    ];
    for path in paths.iter().filter(|path| path.extension().is_some_and(|e| e == "rs")) {
        let text = fs::read_to_string(path).unwrap();
        let here = text.lines().filter(|line| !is_left_to_a_longer_run(line)).collect::<Vec<_>>();
        let text = here.join("\n");
        for mark in marks.iter().filter(|mark| text.contains(**mark)) {
            offences.push(format!("{}: {mark}", path.display()));
        }
    }
    check(offences);
}

/// Whether a doc comment holds a block that would be compiled as an example: one without a language,
/// or of Rust.
fn has_doc_test(text: &str) -> bool {
    let comments = text
        .lines()
        .filter_map(|line| line.trim_start().strip_prefix("//")?.strip_prefix(['/', '!']));
    let mut fences = comments.filter_map(|line| line.trim_start().strip_prefix("```"));
    // Each opening is followed by its end.
    std::iter::from_fn(|| fences.next().inspect(|_| _ = fences.next()))
        .any(|language| ["", "rust", "no_run", "should_panic"].contains(&language.trim()))
}

#[test]
fn no_comment_holds_an_example_that_nobody_runs() {
    // The manifests say `doctest = false`: looking for examples in every crate took three minutes.
    let with = sources().into_iter().filter(|source| has_doc_test(&source.text));
    check(with.map(|source| format!("{}: make it a test, or `text`", source.path)).collect());
}

#[test]
fn every_file_that_the_map_names_exists() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let map = fs::read_to_string(root.join("src/ARCHITECTURE.md")).unwrap();
    let is_file = |name: &&str| {
        (name.ends_with(".rs") || name.ends_with(".md")) && !name.contains(char::is_whitespace)
    };
    let names: Vec<&str> = map.split('`').filter(is_file).collect();
    assert!(names.len() > 20, "the map names only {} files", names.len());
    // `flip-sim/grains.rs` is short for `crates/flip-sim/src/grains.rs`.
    let in_crate = |name: &str| {
        name.split_once('/').map(|(house, inside)| format!("crates/{house}/src/{inside}"))
    };
    let places = |name: &str| [Some(format!("src/{name}")), Some(name.to_owned()), in_crate(name)];
    let is_missing =
        |name: &&&str| !places(name).into_iter().flatten().any(|place| root.join(place).exists());
    check(
        names
            .iter()
            .filter(is_missing)
            .map(|name| format!("src/ARCHITECTURE.md: there is no {name}"))
            .collect(),
    );
}

#[test]
fn the_checks_see_what_they_should() {
    assert_eq!(
        named_rooms(
            "use crate::app::App;\nlet x = flip_sim::VERSION;\nuse flip_core::stats::normal;"
        ),
        ["app", "stats", "sim"]
    );
    assert_eq!(named_rooms("use crate::{app, jobs};"), [""]);
    assert_eq!(room("crates/flip-bench/src/weigh/guard.rs"), "weigh");
    assert_eq!(room("crates/flip-sim/src/walls.rs"), "sim");
    assert_eq!(room("crates/flip-discover/src/judge/screen.rs"), "judge");
    assert_eq!(room("src/main.rs"), "main");
    assert!(holds("use tokio::fs;", "tokio::") && !holds("my_tokio::fs", "tokio::"));
    assert!(holds("pub async fn go()", "async fn"));
    assert!(has_doc_test("/// ```text\n/// ```\n//! ```\n//! run();\n//! ```"));
    assert!(is_left_to_a_longer_run(concat!(
        "#[ig",
        "nore = \"takes hours; `make laws` runs it\"]"
    )));
    assert!(!is_left_to_a_longer_run(concat!("#[ig", "nore = \"fails; `make laws` runs it\"]")));
    assert!(!is_left_to_a_longer_run(concat!("#[ig", "nore = \"takes hours\"]")));
    assert!(!has_doc_test("//! ```toml\n//! ```\nlet text = \"```\";"));
}
