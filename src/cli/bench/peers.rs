//! Other simulators on the released column: one process each, timed window by window in turn with
//! this simulator.

use super::clock::{Spread, rss_mb};
use super::ours::Windows;
use super::{Failure, read_bed, settle, write_bed};
use crate::telemetry;
use flip_core::domain::FieldError;
use flip_sim as sim;
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

/// Names known to `run.sh one`.
const PEERS: [&str; 5] =
    ["lammps-hooke", "lammps-soft", "lammps-full", "newton-xpbd", "taichi-pbd"];
/// Location of the scripts in a clone.
const SCRIPTS: &str = "benches/peers";

/// One simulator on one bed.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub(super) enum Row {
    Measured {
        #[serde(flatten)]
        report: Report,
        /// Core-seconds per simulated second relative to this simulator's, median over median.
        ratio: f64,
    },
    NotMeasured {
        peer: String,
        particles: usize,
        not_measured: String,
    },
}

/// Summary printed by a peer at its end, and made by this simulator likewise.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Report {
    pub peer: String,
    pub version: String,
    pub particles: usize,
    pub dt_s: f64,
    /// Solver iterations per time step.
    pub iterations: u32,
    pub windows: u32,
    pub core_s_per_sim_s: Spread,
    pub particle_steps_per_core_s: f64,
    /// Mean overlap of overlapping pairs, in diameters.
    pub overlap_mean: f64,
    /// Peak memory of the process, MiB.
    pub rss_mb: Option<f64>,
}

/// Source of scripts and beds.
pub(super) struct Peers {
    /// `run.sh` and its scripts; none if no peers are to run.
    scripts: Option<PathBuf>,
    /// Beds `bed_N.csv` made elsewhere.
    beds: Option<PathBuf>,
}

impl Peers {
    /// `folder` holds the scripts, or beds in `data`, or both; if it has no scripts, those of this
    /// clone are used.
    ///
    /// # Errors
    /// Names the flag if there are no scripts.
    pub(super) fn new(folder: Option<&Path>) -> Result<Self, FieldError> {
        let Some(folder) = folder else { return Ok(Self { scripts: None, beds: None }) };
        let has_scripts = |folder: &&Path| {
            folder.join("scene.py").is_file() && folder.join("newton_xpbd.py").is_file()
        };
        let scripts =
            [folder, Path::new(SCRIPTS)].into_iter().find(has_scripts).ok_or_else(|| {
                let message = format!(
                    "no scripts in {} nor in {SCRIPTS}: run from the root of the clone",
                    folder.display()
                );
                FieldError::new("peers", message)
            })?;
        let beds = Some(folder.join("data")).filter(|data| data.is_dir());
        Ok(Self { scripts: Some(scripts.to_owned()), beds })
    }

    /// The bed of `particles` grains: the given one, else one made by the simulator itself; and
    /// which of the two it is.
    pub(super) fn bed(&self, particles: u32) -> Result<(Vec<[f64; 3]>, &'static str), Failure> {
        let given = self.beds.as_ref().map(|beds| beds.join(format!("bed_{particles}.csv")));
        match given.filter(|file| file.is_file()) {
            Some(file) => Ok((read_bed(&file)?, "given")),
            None => Ok((settle(particles)?, "own")),
        }
    }

    /// Times every simulator on a bed, window by window in turn. The first row is this simulator's.
    pub(super) fn compare(
        &self,
        centres_m: &[[f64; 3]],
        windows: u32,
    ) -> Result<(Windows, Vec<Row>), Failure> {
        let mut ours = Windows::flowing(centres_m);
        let folder = std::env::temp_dir().join(format!("flip-bench-{}", std::process::id()));
        std::fs::create_dir_all(&folder)?;
        let bed = folder.join("bed.csv");
        write_bed(&bed, centres_m)?;
        let names: &[&str] = if self.scripts.is_some() { &PEERS } else { &[] };
        let start = |name: &&str| {
            telemetry::say(format_args!("flip: {name} on {} grains starts", centres_m.len()));
            self.scripts
                .as_deref()
                .map_or_else(|| Err(String::new()), |scripts| Peer::start(scripts, name, &bed))
        };
        let mut peers: Vec<Result<Peer, String>> = names.iter().map(start).collect();
        for _ in 0..windows {
            ours.time_next();
            for peer in &mut peers {
                if let Ok(running) = peer
                    && let Err(cause) = running.window()
                {
                    *peer = Err(cause);
                }
            }
        }
        let reports: Vec<_> = peers.into_iter().map(|peer| peer.and_then(Peer::finish)).collect();
        // Leftovers in a temporary folder are no reason to lose the measurement.
        let _ = std::fs::remove_dir_all(&folder);
        let flip = of_flip(&ours, centres_m.len());
        let ratio = |report: &Report| report.core_s_per_sim_s.median / flip.core_s_per_sim_s.median;
        let mut rows = vec![Row::Measured { ratio: 1.0, report: flip.clone() }];
        rows.extend(names.iter().zip(reports).map(|(name, report)| match report {
            Ok(report) => Row::Measured { ratio: ratio(&report), report },
            Err(not_measured) => Row::NotMeasured {
                peer: (*name).to_owned(),
                particles: centres_m.len(),
                not_measured,
            },
        }));
        Ok((ours, rows))
    }
}

fn of_flip(ours: &Windows, particles: usize) -> Report {
    Report {
        peer: "flip".to_owned(),
        version: sim::VERSION.to_owned(),
        particles,
        dt_s: sim::law::SUBSTEP_S,
        iterations: 1,
        windows: ours.costs.len() as u32,
        core_s_per_sim_s: ours.cost(),
        particle_steps_per_core_s: particles as f64 / sim::law::SUBSTEP_S / ours.cost().median,
        overlap_mean: ours.overlap_mean(),
        rss_mb: rss_mb(),
    }
}

/// A peer's process. It waits for a line before each window.
struct Peer {
    process: Child,
    windows: ChildStdin,
    answers: BufReader<ChildStdout>,
    errors: PathBuf,
}

impl Peer {
    /// Starts one and waits until it has reached the first window.
    fn start(scripts: &Path, name: &str, bed: &Path) -> Result<Self, String> {
        let errors = bed.with_file_name(format!("{name}.stderr"));
        let stderr = std::fs::File::create(&errors).map_err(|e| e.to_string())?;
        let mut process = Command::new("bash")
            .arg(scripts.join("run.sh"))
            .args(["one", name])
            .arg(bed)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(stderr)
            .spawn()
            .map_err(|e| format!("bash: {e}"))?;
        let (Some(windows), Some(answers)) = (process.stdin.take(), process.stdout.take()) else {
            return Err("the process has no pipes".to_owned());
        };
        let mut peer = Self { process, windows, answers: BufReader::new(answers), errors };
        peer.wait_for(|line| line == "ready")?;
        Ok(peer)
    }

    fn window(&mut self) -> Result<(), String> {
        let asked = self.windows.write_all(b"\n").and_then(|()| self.windows.flush());
        // A process that has exited gives the reason on stderr.
        if asked.is_err() {
            return Err(self.last_words());
        }
        self.wait_for(|line| line == "window").map(drop)
    }

    fn finish(self) -> Result<Report, String> {
        let Self { process, windows, answers, errors } = self;
        drop(windows);
        let report = answers.lines().map_while(Result::ok).find(|line| line.starts_with('{'));
        let ended = process.wait_with_output();
        let line = report.ok_or_else(|| last_line(&errors))?;
        ended.map_err(|e| e.to_string())?;
        serde_json::from_str(&line).map_err(|e| format!("its report: {e}"))
    }

    /// Reads lines up to one that is `wanted`.
    fn wait_for(&mut self, wanted: impl Fn(&str) -> bool) -> Result<String, String> {
        let mut line = String::new();
        loop {
            line.clear();
            match self.answers.read_line(&mut line) {
                Ok(0) => return Err(self.last_words()),
                Ok(_) if wanted(line.trim_end()) => return Ok(line),
                Ok(_) => {}
                Err(error) => return Err(error.to_string()),
            }
        }
    }

    fn last_words(&mut self) -> String {
        // It has closed its pipe: it has ended, or is about to.
        let _ = self.process.wait();
        last_line(&self.errors)
    }
}

/// The last line that mentions an error, else the last.
fn last_line(errors: &Path) -> String {
    let text = std::fs::read_to_string(errors).unwrap_or_default();
    let names_it = |line: &&str| line.contains("rror");
    text.lines()
        .rfind(names_it)
        .or(text.lines().last())
        .unwrap_or("ended without a word")
        .trim()
        .to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Scripts whose `run.sh` has the content `body`.
    fn scripts(body: &str) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("run.sh"), body).unwrap();
        std::fs::write(folder.path().join("scene.py"), "").unwrap();
        std::fs::write(folder.path().join("newton_xpbd.py"), "").unwrap();
        folder
    }

    #[test]
    fn a_peer_takes_turns_and_reports_and_one_that_fails_says_why() {
        let folder = scripts(
            r#"case $2 in
            taichi-pbd) echo noise; echo ready; n=0; while read -r _; do n=$((n + 1)); echo window; done
              echo '{"peer": "toy", "version": "1", "particles": 150, "dt_s": 1e-4, "iterations": 4, "windows": '$n',
                "core_s_per_sim_s": {"median": 1e9, "min": 1, "max": 2e9}, "particle_steps_per_core_s": 1,
                "overlap_mean": 0.1, "rss_mb": 1}' | tr -d '\n'; echo ;;
            newton-xpbd) echo ready; read -r _; echo "broke in a window" >&2 ;;
            *) echo "not installed here" >&2; exit 3 ;;
            esac"#,
        );
        let peers = Peers::new(Some(folder.path())).unwrap();
        let (bed, source) = peers.bed(150).unwrap();
        assert_eq!((bed.len(), source), (150, "own"));
        let (_, rows) = peers.compare(&bed, 2).unwrap();
        let said = |wanted: &str| {
            rows.iter().find_map(|row| match row {
                Row::NotMeasured { peer, not_measured, .. } if peer == wanted => {
                    Some(not_measured.as_str())
                }
                _ => None,
            })
        };
        assert_eq!(said("lammps-full"), Some("not installed here"));
        assert_eq!(said("newton-xpbd"), Some("broke in a window"));
        let Some(Row::Measured { report, ratio }) = rows.last() else { panic!("{rows:?}") };
        assert!(report.peer == "toy" && report.windows == 2 && *ratio > 1e3, "{report:?}");
    }

    #[test]
    fn a_given_bed_is_taken_and_a_folder_without_scripts_falls_back_on_those_of_the_clone() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("data")).unwrap();
        std::fs::write(folder.path().join("data/bed_2.csv"), "0,0,0.001\n0,0,0.002\n").unwrap();
        let peers = Peers::new(Some(folder.path())).unwrap();
        assert_eq!(peers.scripts.as_deref(), Some(Path::new(SCRIPTS)));
        assert_eq!(peers.bed(2).unwrap(), (vec![[0.0, 0.0, 0.001], [0.0, 0.0, 0.002]], "given"));
    }
}
