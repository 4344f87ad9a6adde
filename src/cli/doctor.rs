//! `flip doctor`: can FLIP run on this machine? Reports each problem and its remedy.

use super::Common;
use super::failure::Failure;
use super::health;
use super::session::runtime;
use super::table::table;
use crate::app::{App, Disagreement, OpenError, Storage, Timestamp, local_cards};
use serde::Serialize;
use std::net::{SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// Fewer descriptors than this are too few for a service: two for each of its connections, and its
/// own open files.
const DESCRIPTORS_MIN: u64 = 4096;
/// Memory that a calibration on all cores may use, bytes.
const MEMORY_MIN: u64 = 1 << 30;
/// Space for a data folder to grow, bytes: about six thousand doses.
const ROOM_MIN: u64 = 1 << 30;
/// How many artifacts are named in one sentence; `--json` has all.
const SHOWN_MAX: usize = 3;
/// A clock before 2026 is not set: this many seconds after 1970.
const CLOCK_MIN: u64 = 1_767_225_600;

/// Arguments of `flip doctor`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Address that the service listens on, or is to listen on.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// Bench file to read; to test its devices, use `flip bench check`.
    #[arg(long, value_name = "FILE")]
    bench: Option<PathBuf>,
    /// Read every artifact, too, and compare it with its name: as long as a backup takes.
    #[arg(long)]
    thorough: bool,
}

/// Status of one check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Verdict {
    Ok,
    /// It works, but may not be as intended.
    Warning,
    Failed,
}

/// Result of one check.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct Finding {
    what: &'static str,
    verdict: Verdict,
    /// What was found and, if something is wrong, what to do.
    found: String,
    /// Of the artifacts: those that no row names, and the rows whose artifact is missing.
    #[serde(skip_serializing_if = "Option::is_none")]
    artifacts: Option<Disagreement>,
}

impl Finding {
    fn new(what: &'static str, verdict: Verdict, found: impl Into<String>) -> Self {
        Self { what, verdict, found: found.into(), artifacts: None }
    }
}

fn ok(what: &'static str, found: impl Into<String>) -> Finding {
    Finding::new(what, Verdict::Ok, found)
}

fn warning(what: &'static str, found: impl Into<String>) -> Finding {
    Finding::new(what, Verdict::Warning, found)
}

fn failed(what: &'static str, found: impl Into<String>) -> Finding {
    Finding::new(what, Verdict::Failed, found)
}

/// Runs all checks; exit status 1 if one fails.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let mut findings = vec![processor(), graphics_card(), memory(), clock(), descriptors()];
    findings.extend(storage(&common.storage()?, arguments.thorough)?);
    findings.push(port(arguments.listen));
    findings.extend(arguments.bench.as_deref().map(bench));
    common.print(&findings, || text(&findings))?;
    let failures = findings.iter().filter(|it| it.verdict == Verdict::Failed).count();
    if failures > 0 {
        Err(Failure::Found(format!("{failures} of {} failed", findings.len())))
    } else {
        Ok(())
    }
}

fn text(findings: &[Finding]) -> String {
    let word = |verdict| match verdict {
        Verdict::Ok => "ok",
        Verdict::Warning => "warning",
        Verdict::Failed => "FAILED",
    };
    let rows = findings
        .iter()
        .map(|it| vec![it.what.to_owned(), word(it.verdict).to_owned(), it.found.clone()]);
    table(&["what", "is", "found"], &rows.collect::<Vec<_>>())
}

fn processor() -> Finding {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let vectors = vectors();
    let found = format!("{cores} cores, {vectors}");
    if cores < 2 {
        return warning(
            "processor",
            format!("{found}: calibrations and trainings take hours on one core"),
        );
    }
    ok("processor", found)
}

/// Nothing needs one: `--device cuda` asks for it.
fn graphics_card() -> Finding {
    let found = local_cards().unwrap_or_else(|why| format!("none that FLIP can use: {why}"));
    ok("graphics card", found)
}

/// The widest vectors that the simulator computes with on this machine.
fn vectors() -> &'static str {
    match flip_sim::column::path() {
        "avx512" => "AVX-512",
        "avx2" => "AVX2: the simulator takes some 1.6 times as long as with AVX-512",
        _ => "neither AVX-512 nor AVX2: the simulator takes several times as long",
    }
}

fn memory() -> Finding {
    let told = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = told.lines().find_map(|line| line.strip_prefix("MemAvailable:"));
    let kib = line.and_then(|rest| rest.split_whitespace().next()?.parse::<u64>().ok());
    match kib.map(|kib| kib << 10) {
        None => warning("memory", "how much is free is not known"),
        Some(bytes) if bytes < MEMORY_MIN => warning(
            "memory",
            format!("{} free, and a calibration may take {}", mib(bytes), mib(MEMORY_MIN)),
        ),
        Some(bytes) => ok("memory", format!("{} free", mib(bytes))),
    }
}

fn clock() -> Finding {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    if now < Duration::from_secs(CLOCK_MIN) {
        return failed(
            "clock",
            "before 2026, and every record carries its time: set it, or start a time service",
        );
    }
    ok("clock", Timestamp::from_unix_ms(now.as_millis() as i64).to_string())
}

fn descriptors() -> Finding {
    let most = rustix::process::getrlimit(rustix::process::Resource::Nofile).maximum;
    match most {
        Some(most) if most < DESCRIPTORS_MIN => warning(
            "descriptors",
            format!(
                "at most {most}, so fewer clients are served: LimitNOFILE=65536 in a unit, `ulimit -Hn` in a shell"
            ),
        ),
        most => {
            ok("descriptors", most.map_or("no limit".to_owned(), |most| format!("up to {most}")))
        }
    }
}

/// The folder, its disk, the database, and the artifacts.
fn storage(storage: &Storage, thorough: bool) -> Result<Vec<Finding>, Failure> {
    let folder = storage.folder();
    let there = folder.is_dir();
    let here = Path::new(".");
    let is_there = |it: &&Path| !it.as_os_str().is_empty() && it.exists();
    let on = folder.ancestors().find(is_there).unwrap_or(here);
    let mut findings = vec![room(on), writable(folder, on)];
    if there || storage.is_on_server() || storage.has_artifacts_elsewhere() {
        findings.extend(runtime()?.block_on(database(storage, thorough)));
    }
    Ok(findings)
}

fn room(on: &Path) -> Finding {
    match rustix::fs::statvfs(on) {
        Err(error) => failed("disk", format!("{}: {error}", on.display())),
        Ok(disk) => {
            let free = disk.f_bavail * disk.f_frsize;
            let found = format!("{} free at {}", mib(free), on.display());
            if free < ROOM_MIN {
                warning("disk", format!("{found}: make room, or choose another --data-dir"))
            } else {
                ok("disk", found)
            }
        }
    }
}

fn writable(folder: &Path, on: &Path) -> Finding {
    let name = folder.display();
    if folder.is_symlink() && !folder.exists() {
        return failed(
            "data folder",
            format!("{name} is a link to nothing; mend it, or choose another with --data-dir"),
        );
    }
    if !on.is_dir() {
        return failed(
            "data folder",
            format!("{name}: {} is no folder; choose another with --data-dir", on.display()),
        );
    }
    match rustix::fs::access(on, rustix::fs::Access::WRITE_OK | rustix::fs::Access::EXEC_OK) {
        Err(error) => failed(
            "data folder",
            format!("{name}: {error}; choose another with --data-dir, or give it to this user"),
        ),
        Ok(()) if on == folder => ok("data folder", format!("{name} can be written")),
        Ok(()) => ok("data folder", format!("{name} is not there yet and can be made")),
    }
}

/// The database, if there is one, and the artifacts that it names.
async fn database(storage: &Storage, thorough: bool) -> Vec<Finding> {
    // Read-only: a doctor changes nothing, and a server may hold it.
    match App::look_into(storage).await {
        Err(OpenError::Held(why)) => vec![warning("database", why)],
        Err(error) => vec![failed("database", error.to_string())],
        Ok(None) => {
            let empty = || {
                ok(
                    "database",
                    format!("{storage} can be reached, and is empty or of an older FLIP"),
                )
            };
            let mut findings = Vec::from_iter(storage.is_on_server().then(empty));
            if storage.has_artifacts_elsewhere() {
                findings.push(reachable(storage).await);
            }
            findings
        }
        Ok(Some(app)) => {
            let audit = app.verify_audit(None).await;
            let artifacts = app.check_artifacts(thorough).await;
            let _ = app.shutdown().await;
            let audit = match audit {
                Ok(audit) if audit.broken.is_none() => {
                    ok("database", format!("{} records, as they were written", audit.records))
                }
                Ok(_) => failed(
                    "database",
                    "the record is not as it was written: `flip audit verify` says where",
                ),
                Err(error) => failed("database", error.to_string()),
            };
            let artifacts = match artifacts {
                Ok(found) => compared(found, &storage.artifacts().to_string(), thorough),
                Err(error) => failed("artifacts", error.to_string()),
            };
            vec![audit, artifacts]
        }
    }
}

/// Artifacts that no database names yet.
async fn reachable(storage: &Storage) -> Finding {
    let artifacts = storage.artifacts();
    match artifacts.check_reachable().await {
        Ok(()) => ok("artifacts", format!("{artifacts} can be reached")),
        Err(error) => failed("artifacts", error.to_string()),
    }
}

/// What is wrong with the artifacts at this place.
fn compared(found: Disagreement, place: &str, thorough: bool) -> Finding {
    let mut told = Vec::new();
    for (damaged, what) in [(false, "missing"), (true, "damaged")] {
        let lost = found.lost.iter().filter(|it| it.damaged == damaged);
        let lost = lost.map(|it| format!("{} (named by {})", it.sha256, first(&it.named_by)));
        let lost: Vec<_> = lost.collect();
        if !lost.is_empty() {
            told.push(format!("{} {what}: {}", lost.len(), first(&lost)));
        }
    }
    let verdict = if told.is_empty() { Verdict::Ok } else { Verdict::Failed };
    if told.is_empty() {
        let whole = if thorough { " and whole" } else { "" };
        told.push(format!("all that rows name are there{whole}"));
    } else {
        let folder = "its folder blobs, as AB/ABCD… by the first two digits";
        told.push(format!(
            "copy each to {place} from a backup ({folder}); nothing else is affected"
        ));
    }
    if !found.unnamed.is_empty() {
        told.push(format!(
            "{} that no row names ({}): a start of `flip serve` removes those older than a day, unless they are more than 100",
            found.unnamed.len(),
            first(&found.unnamed)
        ));
    }
    let artifacts = Some(found);
    Finding { artifacts, ..Finding::new("artifacts", verdict, told.join("; ")) }
}

/// The first few of a list.
fn first(list: &[String]) -> String {
    let more = list.len().saturating_sub(SHOWN_MAX);
    let mut shown = list.iter().take(SHOWN_MAX).cloned().collect::<Vec<_>>().join(", ");
    if more > 0 {
        shown += &format!(", and {more} more");
    }
    shown
}

fn port(address: SocketAddr) -> Finding {
    match TcpListener::bind(address) {
        Ok(_) => ok("port", format!("{address} is free")),
        Err(_) if health::is_alive(address) => ok("port", format!("FLIP serves at {address}")),
        Err(error) => failed("port", format!("{address}: {error}; choose another with --listen")),
    }
}

fn bench(file: &Path) -> Finding {
    match super::benches::read("bench", file) {
        Ok(_) => {
            ok("bench file", format!("{}: `flip bench check` asks its devices", file.display()))
        }
        Err(Failure::BadInput(errors)) => failed(
            "bench file",
            errors.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "),
        ),
        Err(_) => failed("bench file", file.display().to_string()),
    }
}

fn mib(bytes: u64) -> String {
    format!("{} MiB", bytes >> 20)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_is_free_taken_or_flips_own() {
        let taken = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = taken.local_addr().unwrap();
        std::thread::spawn(move || drop(taken.accept()));
        let found = port(address);
        assert_eq!(found.verdict, Verdict::Failed);
        assert!(found.found.contains("--listen"), "{}", found.found);
        assert_eq!(port(SocketAddr::from(([127, 0, 0, 1], 0))).verdict, Verdict::Ok);
    }

    #[test]
    fn a_folder_that_cannot_be_made_fails_and_a_fresh_one_does_not() {
        let folder = tempfile::tempdir().unwrap();
        let verdicts = |path: &Path| {
            storage(&path.into(), false).unwrap().iter().map(|it| it.verdict).collect::<Vec<_>>()
        };
        assert!(!verdicts(&folder.path().join("new/deeper")).contains(&Verdict::Failed));
        let file = folder.path().join("file");
        std::fs::write(&file, "x").unwrap();
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(folder.path().join("nowhere"), &link).unwrap();
        for taken in [file.join("deeper"), file, link] {
            assert!(verdicts(&taken).contains(&Verdict::Failed), "{}", taken.display());
        }
    }

    #[test]
    fn a_folder_that_lost_its_database_is_not_taken_for_a_fresh_one() {
        let folder = tempfile::tempdir().unwrap();
        assert!(
            storage(&folder.path().into(), false).unwrap().iter().all(|it| it.what != "database")
        );
        let blobs = folder.path().join("blobs/ab");
        std::fs::create_dir_all(&blobs).unwrap();
        std::fs::write(blobs.join("ab".repeat(32)), b"a trace").unwrap();
        let found = storage(&folder.path().into(), false).unwrap();
        assert!(
            found.iter().any(|it| it.what == "database" && it.verdict == Verdict::Failed),
            "{found:?}"
        );
    }

    #[test]
    fn a_database_that_is_none_is_named() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("flip.db"), "this is a letter").unwrap();
        let found = storage(&folder.path().into(), false).unwrap();
        let database = found.iter().find(|it| it.what == "database").unwrap();
        assert_eq!(database.verdict, Verdict::Failed, "{}", database.found);
        assert_eq!(std::fs::read(folder.path().join("flip.db")).unwrap(), b"this is a letter");
    }
}
