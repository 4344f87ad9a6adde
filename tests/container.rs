//! The image's build, without Docker: the Dockerfile must copy everything that cargo and the
//! program need.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");
/// Printed by the compiler's stand-in once cargo has got past its manifest and begins to compile.
const REACHED: &str = "cargo began to compile";

/// Sources of the `COPY` lines of the stage that builds the program, excluding those from other
/// stages.
fn copied() -> Vec<String> {
    let dockerfile = fs::read_to_string(Path::new(ROOT).join("Dockerfile")).unwrap();
    let stage = dockerfile
        .split("\nFROM ")
        .find(|stage| stage.contains("cargo build"))
        .expect("a stage that builds");
    let lines = stage
        .lines()
        .filter_map(|line| line.strip_prefix("COPY "))
        .filter(|line| !line.starts_with("--from"));
    lines.flat_map(|line| line.rsplit_once(' ').unwrap().0.split(' ').map(str::to_owned)).collect()
}

/// Whether `.dockerignore` lets a path through. It excludes everything, re-includes top-level paths
/// by name, and excludes some paths below them: the last line that names a path or one above it
/// counts.
fn is_let_through(name: &str) -> bool {
    let ignore = fs::read_to_string(Path::new(ROOT).join(".dockerignore")).unwrap();
    let names = |line: &str| Path::new(name).starts_with(line.trim_start_matches('!'));
    ignore.lines().rfind(|line| names(line)).is_some_and(|line| line.starts_with('!'))
}

fn copy(from: &Path, to: &Path) {
    if from.is_dir() {
        fs::create_dir_all(to).unwrap();
        for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
            copy(&entry.path(), &to.join(entry.file_name()));
        }
    } else {
        fs::copy(from, to).unwrap();
    }
}

/// The folder in which the image builds the program.
fn context() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in copied() {
        assert!(
            is_let_through(&name),
            "the Dockerfile copies `{name}`, which .dockerignore keeps out"
        );
        let to = folder.path().join(&name);
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        copy(&Path::new(ROOT).join(&name), &to);
    }
    folder
}

/// A stand-in for the compiler that answers cargo's queries before compilation and exits at the
/// first unit.
fn stand_in(folder: &Path) -> PathBuf {
    use std::os::unix::fs::PermissionsExt;
    let path = folder.join("rustc-stand-in");
    let script = format!(
        "#!/bin/sh\ncase \" $* \" in *\" --crate-name ___ \"*|*\" -vV \"*) exec \"$@\";; esac\necho {REACHED} >&2\nexit 1\n"
    );
    fs::write(&path, script).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    path
}

/// Without them no webhook, bucket or database behind TLS is reached, and the base image has none.
#[test]
fn the_image_has_certificates_of_the_public_authorities() {
    let dockerfile = fs::read_to_string(Path::new(ROOT).join("Dockerfile")).unwrap();
    let image = dockerfile.rsplit("\nFROM ").next().unwrap();
    let mut installed = image.split("apt-get install").skip(1).flat_map(str::split_whitespace);
    assert!(installed.any(|word| word == "ca-certificates"), "{image}");
}

#[test]
fn the_images_build_context_gets_past_cargos_manifest() {
    let folder = context();
    let built = Command::new(env!("CARGO"))
        .args(["build", "--release", "--locked", "--offline", "--bin", "flip"])
        .current_dir(folder.path())
        .env("CARGO_TARGET_DIR", folder.path().join("target"))
        .env("RUSTC_WRAPPER", stand_in(folder.path()))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&built.stderr);
    assert!(said.contains(REACHED), "{said}");
}

/// Files that the program's sources, tests excepted, include.
fn included() -> Vec<(PathBuf, PathBuf)> {
    let source = Path::new(ROOT).join("src");
    let (mut waiting, mut found) = (vec![source.clone()], Vec::new());
    while let Some(path) = waiting.pop() {
        if path.is_dir() {
            waiting.extend(fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().path()));
        } else if path.extension().is_some_and(|it| it == "rs")
            && !path.strip_prefix(&source).unwrap().to_str().unwrap().contains("test")
        {
            let text = fs::read_to_string(&path).unwrap();
            let program = text.split("#[cfg(test)]").next().unwrap_or_default();
            for pattern in ["include_str!(\"", "include_bytes!(\""] {
                let names = program
                    .split(pattern)
                    .skip(1)
                    .filter_map(|rest| rest.split_once('"'))
                    .map(|it| it.0);
                found.extend(names.map(|name| (path.clone(), path.parent().unwrap().join(name))));
            }
        }
    }
    found
}

#[test]
fn every_file_that_the_program_includes_is_in_the_images_build_context() {
    let (root, names) = (Path::new(ROOT).canonicalize().unwrap(), copied());
    let included = included();
    assert!(!included.is_empty());
    for (source, file) in included {
        let file =
            file.canonicalize().unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        let inside = file.strip_prefix(&root).unwrap();
        let top = inside.iter().next().unwrap().to_str().unwrap();
        let lacks = format!(
            "{} includes {}, which the image's build lacks",
            source.display(),
            inside.display()
        );
        assert!(names.iter().any(|name| name == top), "{lacks}");
    }
}
