//! Processes of FLIP that share a database.

use super::clocks::Clocks;
use anyhow::{Context, Result, bail, ensure};
use serde_json::Value;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// How long something that must happen may take, and how often it is looked for.
const PATIENCE: Duration = Duration::from_secs(60);
pub(super) const LOOK: Duration = Duration::from_millis(500);
/// Lines that are told of what a process said.
const LINES: usize = 20;

/// The program with this database.
#[derive(Clone)]
pub(super) struct Flip {
    pub program: PathBuf,
    pub files: PathBuf,
    pub url: String,
    /// Where artifacts are, if not among the files.
    pub artifacts: Option<PathBuf>,
    /// The clocks of machines, if they are not this one's.
    pub clocks: Option<Clocks>,
}

impl Flip {
    fn command(&self, words: &[&str]) -> Command {
        let mut command = Command::new(&self.program);
        command.args(words).args(["--json", "--database-url", &self.url, "--data-dir"]);
        command.arg(&self.files).stdin(Stdio::null());
        if let Some(artifacts) = &self.artifacts {
            command.arg("--artifacts").arg(artifacts);
        }
        command
    }

    /// A process on a machine of its own.
    fn on(&self, machine: &str, mut command: Command) -> Result<Process> {
        if let Some(clocks) = &self.clocks {
            clocks.give(machine, &mut command)?;
        }
        let said = self.said();
        fs::create_dir_all(&said)?;
        let said = File::options().create(true).append(true).open(said.join(machine))?;
        let mut process = Self::started(command.stderr(said))?;
        machine.clone_into(&mut process.machine);
        Ok(process)
    }

    /// Where the processes on machines say what they do, each in a file of its name.
    fn said(&self) -> PathBuf {
        self.files.with_file_name("said")
    }

    /// The last of what each of these machines said.
    pub fn last_said(&self, machines: &[&str]) -> String {
        let last = |machine: &&str| {
            let text = fs::read_to_string(self.said().join(machine)).unwrap_or_default();
            let lines: Vec<&str> = text.lines().collect();
            format!("{machine}:\n{}\n", lines[lines.len().saturating_sub(LINES)..].join("\n"))
        };
        machines.iter().map(last).collect()
    }

    fn started(command: &mut Command) -> Result<Process> {
        let child = command.stdout(Stdio::piped()).spawn();
        let child = child.with_context(|| format!("{command:?}"))?;
        Ok(Process { child, machine: String::new() })
    }

    pub fn demonstrate(&self, arguments: &[String]) -> Result<Process> {
        let mut command = self.command(&["demo", "--exit", "--bench", "emulated"]);
        command.args(["--listen", "127.0.0.1:0"]).args(arguments);
        Self::started(command.stderr(Stdio::null()))
    }

    pub fn server(&self, bench: &str) -> Result<Process> {
        let words = ["serve", "--bench", "emulated", "--bench-name", bench];
        let mut command = self.command(&words);
        command.args(["--listen", "127.0.0.1:0"]);
        self.on(bench, command)
    }

    pub fn worker(&self, name: &str) -> Result<Process> {
        self.on(name, self.command(&["worker", "--threads", "1", "--name", name]))
    }

    /// What a command prints; none if it fails, as every command does before there is a schema.
    pub fn asked(&self, words: &[&str]) -> Result<Option<Value>> {
        let output = self.command(words).stderr(Stdio::null()).output()?;
        match output.status.success() {
            true => Ok(Some(serde_json::from_slice(&output.stdout)?)),
            false => Ok(None),
        }
    }

    pub fn bench(&self, name: &str) -> Result<Value> {
        let benches = self.asked(&["bench", "list"])?.context("no list of benches")?;
        let mut all = benches.as_array().cloned().unwrap_or_default().into_iter();
        all.find(|it| it["name"] == name).with_context(|| format!("no bench {name}"))
    }

    /// A server alone with a data folder.
    pub fn alone_server(&self, folder: &Path) -> Result<Process> {
        let mut command = Command::new(&self.program);
        command.args(["serve", "--json", "--listen", "127.0.0.1:0", "--data-dir"]).arg(folder);
        Self::started(command.stderr(Stdio::null()))
    }

    /// The demonstration in one process with a data folder.
    pub fn alone(&self, folder: &Path, arguments: &[String]) -> Result<Value> {
        let mut command = Command::new(&self.program);
        command.args(["demo", "--exit", "--bench", "emulated", "--listen", "127.0.0.1:0"]);
        command.args(["--json", "--data-dir"]).arg(folder.join("alone")).args(arguments);
        let mut process = Self::started(command.stderr(Stdio::null()))?;
        let document = process.said()?;
        ensure!(process.child.wait()?.success(), "the demonstration alone failed");
        Ok(document)
    }
}

/// A process, killed when dropped.
pub(super) struct Process {
    pub child: Child,
    /// The machine that it is on, if it is on one of its own.
    pub machine: String,
}

impl Process {
    /// What it says until it ends, as one document.
    pub fn said(&mut self) -> Result<Value> {
        let out = self.child.stdout.take().context("its output was read before")?;
        Ok(serde_json::from_reader(out)?)
    }

    pub fn kill(&mut self) -> Result<()> {
        self.child.kill()?;
        self.child.wait()?;
        Ok(())
    }

    pub fn signal(&self, name: &str) -> Result<()> {
        let id = self.child.id().to_string();
        let sent = Command::new("kill").args([format!("-{name}"), id]).status()?;
        ensure!(sent.success(), "kill -{name}");
        Ok(())
    }

    /// Asks it to end, as a service manager does.
    pub fn end(&mut self) -> Result<()> {
        self.signal("TERM")?;
        until(|| Ok(self.child.try_wait()?.is_some()), "a process to end")
    }
}

/// A server, and what it says when it listens: its address, and the token of the first start.
pub(super) struct Server {
    process: Process,
    said: Arc<OnceLock<Value>>,
}

impl Server {
    pub fn of(mut process: Process) -> Self {
        let said = Arc::<OnceLock<Value>>::default();
        if let Some(out) = process.child.stdout.take() {
            let told = said.clone();
            // It ends with the process.
            std::thread::spawn(move || {
                let first = serde_json::Deserializer::from_reader(out).into_iter().next();
                if let Some(Ok(document)) = first {
                    let _ = told.set(document);
                }
            });
        }
        Self { process, said }
    }

    /// What it said, once it listens.
    pub fn said(&self) -> Option<&Value> {
        self.said.get()
    }

    pub fn has_ended(&mut self) -> Result<bool> {
        Ok(self.process.child.try_wait()?.is_some())
    }

    pub fn kill(&mut self) -> Result<()> {
        self.process.kill()
    }

    pub fn end(&mut self) -> Result<()> {
        self.process.end()
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

pub(super) fn until(mut done: impl FnMut() -> Result<bool>, what: &str) -> Result<()> {
    let began = Instant::now();
    while !done()? {
        if began.elapsed() > PATIENCE {
            bail!("{what}: not within {} s", PATIENCE.as_secs());
        }
        std::thread::sleep(LOOK);
    }
    Ok(())
}
