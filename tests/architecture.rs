//! Checks the map of `src/ARCHITECTURE.md`: who may import whom, which crate is used where, and
//! what no file may contain.

use std::fs;
use std::path::{Path, PathBuf};

/// Module, and the modules it may name. A module may always name itself.
const ARROWS: [(&str, &[&str]); 17] = [
    ("domain", &[]),
    ("stats", &[]),
    ("sim", &["domain"]),
    ("policy", &["domain", "stats"]),
    ("hardware", &["domain"]),
    ("emulate", &["domain", "stats", "sim", "hardware"]),
    ("pile", &["domain", "stats", "hardware"]),
    ("calibrate", &["domain", "stats"]),
    ("discover", &["domain", "stats"]),
    ("train", &["domain", "sim", "policy", "stats"]),
    ("weigh", &["domain", "stats", "hardware", "policy"]),
    ("store", &["domain"]),
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
            "store",
        ],
    ),
    ("app", &["domain", "store", "jobs", "policy", "discover", "emulate", "hardware", "pile"]),
    ("api", &["domain", "app"]),
    ("cli", &["domain", "sim", "hardware", "emulate", "app", "api", "telemetry"]),
    ("telemetry", &[]),
];

/// File, and what it may name beyond its module's arrows.
const EXCEPTIONS: [(&str, &[&str]); 1] = [
    // The simulated bench is the one driver whose device is the simulator.
    ("hardware/simulated.rs", &["sim"]),
];

/// Names allowed in some modules only: crates that talk to the world, and words that mark
/// asynchronous code.
const CONFINED: [(&str, &[&str]); 27] = [
    ("sqlx::", &["store", "jobs"]),
    ("apalis::", &["jobs"]),
    ("apalis_", &["jobs"]),
    ("axum::", &["api"]),
    ("hyper_util::", &["api", "hardware", "emulate"]),
    ("http_body::", &["api"]),
    ("tokio_rustls::", &["api"]),
    // The arm's driver is a gRPC server, emulated or not.
    ("tonic::", &["api", "hardware", "emulate"]),
    ("prost::", &["api"]),
    ("serialport::", &["hardware"]),
    ("tokio_modbus::", &["hardware"]),
    ("tokio_serial::", &["hardware"]),
    ("toml::", &["hardware", "cli"]),
    ("png::", &["hardware", "emulate"]),
    ("tower_http::", &["api"]),
    ("tch::", &["train"]),
    ("csv::", &["app"]),
    ("rayon::", &["calibrate", "discover", "train", "jobs", "cli"]),
    ("clap::", &["cli"]),
    ("indicatif::", &["cli"]),
    ("rustix::", &["api", "cli", "emulate", "hardware", "jobs", "store"]),
    ("anyhow::", &["cli"]),
    // Drivers and emulators are synchronous outside; their own runtimes wait for remote calls.
    ("tokio::", &["store", "jobs", "app", "api", "cli", "hardware", "emulate"]),
    ("async fn", &["store", "jobs", "app", "api", "cli", "hardware", "emulate"]),
    ("std::fs", &["store", "api", "cli", "emulate"]),
    ("std::net", &["api", "cli", "hardware", "emulate"]),
    ("Instant", &["hardware", "emulate", "jobs", "store", "app", "api", "cli", "train"]),
];

/// Names that say nothing about what a file holds.
const BANNED_NAMES: [&str; 8] = ["utils", "util", "helpers", "helper", "common", "manager", "misc", "model"];

/// Maximum lines of a file; files are reviewed from 400.
const LINES_MAX: usize = 500;

/// One source file: its path below `src/`, its text, and that text without comments and unit tests.
struct Source {
    path: String,
    text: String,
    code: String,
}

impl Source {
    fn module(&self) -> &str {
        self.path.split('/').next().unwrap_or_default().trim_end_matches(".rs")
    }
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
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut paths = Vec::new();
    files(&root, &mut paths);
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
        Source { path: path.strip_prefix(&root).unwrap().display().to_string(), code, text }
    };
    paths.into_iter().map(read).collect()
}

/// Every module named by a `crate::module` path in `code`.
fn named_modules(code: &str) -> Vec<&str> {
    let end = |rest: &str| rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
    code.split("crate::").skip(1).map(|rest| &rest[..end(rest)]).collect()
}

/// Every occurrence of `word` in `code` that does not continue an identifier.
fn holds(code: &str, word: &str) -> bool {
    let starts_identifier = |at: usize| !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':');
    code.match_indices(word).any(|(at, _)| starts_identifier(at))
}

fn check(offences: Vec<String>) {
    assert!(offences.is_empty(), "{} offences:\n{}", offences.len(), offences.join("\n"));
}

#[test]
fn modules_import_only_what_the_map_allows() {
    let mut offences = Vec::new();
    for source in sources() {
        let module = source.module();
        // lib.rs and main.rs see everything.
        let Some((_, allowed)) = ARROWS.iter().find(|(name, _)| *name == module) else { continue };
        let more = EXCEPTIONS.iter().find(|(path, _)| *path == source.path).map_or(&[] as &[&str], |(_, more)| *more);
        for name in named_modules(&source.code) {
            if name.is_empty() {
                offences.push(format!("{}: one `use crate::module::…` a line, please", source.path));
            } else if name != module && !allowed.contains(&name) && !more.contains(&name) {
                offences.push(format!("{}: names crate::{name}, which {module} may not", source.path));
            }
        }
    }
    check(offences);
}

#[test]
fn every_folder_of_the_source_is_on_the_map() {
    let unknown = |source: &Source| {
        !ARROWS.iter().any(|(name, _)| *name == source.module()) && !["lib.rs", "main.rs"].contains(&&*source.path)
    };
    check(sources().into_iter().filter(unknown).map(|source| source.path).collect());
}

#[test]
fn crates_and_clocks_stay_where_they_belong() {
    let mut offences = Vec::new();
    for source in sources() {
        for (word, places) in CONFINED {
            if holds(&source.code, word) && !places.contains(&source.module()) {
                offences.push(format!("{}: `{word}` belongs in {}", source.path, places.join(", ")));
            }
        }
    }
    check(offences);
}

#[test]
fn files_are_named_for_what_they_hold_and_are_short_enough_to_read() {
    let mut offences = Vec::new();
    for source in sources() {
        for part in source.path.trim_end_matches(".rs").split('/').filter(|part| BANNED_NAMES.contains(part)) {
            offences.push(format!("{}: `{part}` names nothing", source.path));
        }
        let lines = source.text.lines().count();
        if lines > LINES_MAX {
            offences.push(format!("{}: {lines} lines; split it where its second idea begins", source.path));
        }
    }
    check(offences);
}

#[test]
fn nothing_is_left_unfinished_or_switched_off() {
    let mut offences = Vec::new();
    let mut paths = Vec::new();
    for folder in ["src", "tests", "benches", "examples"] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
        if folder.exists() {
            files(&folder, &mut paths);
        }
    }
    // Split so that this list does not find itself.
    let marks = [concat!("#[ig", "nore"), concat!("to", "do!("), concat!("unimple", "mented!("), concat!("dbg", "!(")];
    for path in paths.iter().filter(|path| path.extension().is_some_and(|e| e == "rs")) {
        let text = fs::read_to_string(path).unwrap();
        for mark in marks.iter().filter(|mark| text.contains(**mark)) {
            offences.push(format!("{}: {mark}", path.display()));
        }
    }
    check(offences);
}

#[test]
fn every_file_that_the_map_names_exists() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let map = fs::read_to_string(root.join("src/ARCHITECTURE.md")).unwrap();
    let is_file = |name: &&str| (name.ends_with(".rs") || name.ends_with(".md")) && !name.contains(char::is_whitespace);
    let names: Vec<&str> = map.split('`').filter(is_file).collect();
    assert!(names.len() > 20, "the map names only {} files", names.len());
    let is_missing = |name: &&&str| !root.join("src").join(name).exists() && !root.join(name).exists();
    check(names.iter().filter(is_missing).map(|name| format!("src/ARCHITECTURE.md: there is no {name}")).collect());
}

#[test]
fn the_checks_see_what_they_should() {
    assert_eq!(named_modules("use crate::domain::seed;\nlet x = crate::sim::VERSION;"), ["domain", "sim"]);
    assert_eq!(named_modules("use crate::{domain, sim};"), [""]);
    assert!(holds("use tokio::fs;", "tokio::") && !holds("my_tokio::fs", "tokio::"));
    assert!(holds("pub async fn go()", "async fn"));
}
