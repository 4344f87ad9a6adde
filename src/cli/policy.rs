//! `flip policy`: lists policies, shows one, exports and imports one, and gets one's next action.

use super::Common;
use super::failure::Failure;
use super::session::{beside, with_reader};
use super::table::table;
use crate::app::{Done, Driver, Driving, Observation, PageQuery, Policy, Proposal};
use flip_core::domain::FieldError;
use std::io::{BufRead, Write};
use std::path::{Path, PathBuf};

/// Arguments of `flip policy`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    command: PolicyCommand,
}

#[derive(Debug, clap::Subcommand)]
enum PolicyCommand {
    /// List policies, newest first; works while a server runs.
    List {
        /// Maximum number of policies to list, 1 to 200.
        #[arg(long, value_name = "N", default_value_t = 50, allow_negative_numbers = true)]
        limit: u32,
        /// Continue after this cursor, `next` of the previous list.
        #[arg(long, value_name = "CURSOR")]
        after: Option<String>,
    },
    /// Print a policy and its manifest: settings, seed, parameter sets, curriculum history,
    /// versions.
    Show {
        /// Policy id.
        #[arg(long, value_name = "ID")]
        policy: String,
    },
    /// Export a policy as a safetensors file.
    Export {
        /// Policy id.
        #[arg(long, value_name = "ID")]
        policy: String,
        /// File to write.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
    /// Import a policy that was trained elsewhere, to evaluate it and to weigh with it.
    Import {
        /// Policy file: safetensors with a manifest, as `flip policy export` and the Python package
        /// write it.
        #[arg(long, value_name = "FILE")]
        file: PathBuf,
    },
    /// Get a policy's next action, to drive a robot of your own. Nothing moves; libtorch is not
    /// needed.
    Infer(Infer),
}

#[derive(Debug, clap::Args)]
struct Infer {
    /// Policy id, from the data folder.
    #[arg(long, value_name = "ID", required_unless_present = "file")]
    policy: Option<String>,
    /// Policy file instead, exported or downloaded.
    #[arg(long, value_name = "FILE", conflicts_with = "policy")]
    file: Option<PathBuf>,
    /// Balance reading, mg.
    #[arg(
        long,
        value_name = "MG",
        required_unless_present = "stdin",
        allow_negative_numbers = true
    )]
    reading_mg: Option<f64>,
    /// Target mass, mg.
    #[arg(
        long,
        value_name = "MG",
        required_unless_present = "stdin",
        allow_negative_numbers = true
    )]
    target_mg: Option<f64>,
    /// Pitch of the spoon, degrees; positive is tip down.
    #[arg(
        long,
        value_name = "DEG",
        required_unless_present = "stdin",
        allow_negative_numbers = true
    )]
    pitch_deg: Option<f64>,
    /// Readability (display step) of the balance, mg.
    #[arg(long, value_name = "MG", default_value_t = 1.0, allow_negative_numbers = true)]
    readability_mg: f64,
    /// Steps of this weighing so far, a JSON list of {"before", "action", "after"}: observations
    /// {"reading_mg", "target_mg", "pitch_deg"} before and after an action {"incline_change_deg",
    /// "shake_mm"}. Controllers have memory.
    #[arg(long, value_name = "FILE")]
    history: Option<PathBuf>,
    /// Read observations as JSON from stdin, one per line, and answer each at once with a line; one
    /// weighing.
    #[arg(long, conflicts_with_all = ["reading_mg", "target_mg", "pitch_deg"])]
    stdin: bool,
}

/// Runs the chosen subcommand.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.command {
        PolicyCommand::List { limit, after } => {
            let page =
                PageQuery { limit: Some(*limit), after: after.clone(), ..PageQuery::default() };
            let policies = with_reader(common, async |lab| Ok(lab.policies(page).await?))?;
            common.print(&policies, || text(&policies.items))
        }
        PolicyCommand::Show { policy } => {
            let policy = with_reader(common, async |lab| Ok(lab.policy(policy).await?))?;
            // JSON for people too: a manifest has no other form.
            common.print(&policy, || serde_json::to_string_pretty(&policy).unwrap_or_default())
        }
        PolicyCommand::Export { policy, out } => {
            let bytes = bytes_of(common, policy)?;
            std::fs::write(out, &bytes).map_err(|error| file_error("out", out, &error))?;
            let document =
                serde_json::json!({ "policy": policy, "out": out, "size_bytes": bytes.len() });
            common.print(&document, || {
                format!("{policy} written to {}, {} bytes", out.display(), bytes.len())
            })
        }
        PolicyCommand::Import { file } => {
            let bytes = std::fs::read(file).map_err(|error| file_error("file", file, &error))?;
            let (policy, is_new) =
                beside(common, async |lab| Ok(lab.import_policy("file", &bytes).await?))?;
            common.print(&policy, || match is_new {
                true => format!("{} imported, {} bytes", policy.id, policy.size_bytes),
                false => format!("{} was known already", policy.id),
            })
        }
        PolicyCommand::Infer(infer) => infer.run(common),
    }
}

impl Infer {
    fn run(&self, common: &Common) -> Result<(), Failure> {
        let driver = match (&self.file, &self.policy) {
            (Some(file), _) => {
                let bytes =
                    std::fs::read(file).map_err(|error| file_error("file", file, &error))?;
                Driver::read("file", &bytes)?
            }
            (None, id) => {
                Driver::read("policy", &bytes_of(common, id.as_deref().unwrap_or_default())?)?
            }
        };
        let mut driving = driver.begin(self.readability_mg)?;
        if let Some(file) = &self.history {
            let text = std::fs::read(file).map_err(|error| file_error("history", file, &error))?;
            let steps: Vec<Done> = serde_json::from_slice(&text)
                .map_err(|error| FieldError::new("history", error.to_string()))?;
            driving.resume(&steps)?;
        }
        if self.stdin {
            return answer_lines(&mut driving);
        }
        let [Some(reading_mg), Some(target_mg), Some(pitch_deg)] =
            [self.reading_mg, self.target_mg, self.pitch_deg]
        else {
            let message = "give it with --target-mg and --pitch-deg, or --stdin";
            return Err(FieldError::new("reading_mg", message).into());
        };
        let proposal = driving.next(&Observation { reading_mg, target_mg, pitch_deg })?;
        common.print(&proposal, || sentence(&proposal))
    }
}

/// Answers each line with one line, flushed, so that a robot can wait for it.
fn answer_lines(driving: &mut Driving<'_>) -> Result<(), Failure> {
    for (k, line) in std::io::stdin().lock().lines().enumerate() {
        let line = line?;
        if line.trim().is_empty() {
            continue;
        }
        let number = k + 1;
        let seen: Observation = serde_json::from_str(&line)
            .map_err(|error| FieldError::new(format!("stdin[{number}]"), error.to_string()))?;
        let proposal = driving.next(&seen)?;
        let mut out = std::io::stdout().lock();
        writeln!(out, "{}", serde_json::to_string(&proposal)?)?;
        out.flush()?;
    }
    Ok(())
}

fn bytes_of(common: &Common, policy: &str) -> Result<Vec<u8>, Failure> {
    with_reader(common, async |lab| Ok(lab.policy_bytes(policy).await?))
}

fn file_error(field: &str, file: &Path, error: &std::io::Error) -> Failure {
    FieldError::new(field, format!("{}: {error}", file.display())).into()
}

fn sentence(proposal: &Proposal) -> String {
    let action = proposal.action;
    format!(
        "incline by {:+.2} deg, shake {:.2} mm",
        action.incline_change_deg,
        action.executed_shake_mm()
    )
}

fn text(policies: &[Policy]) -> String {
    let row = |policy: &Policy| {
        let errors: Vec<f64> = policy.evaluated.iter().map(|powder| powder.mae_mg).collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        vec![
            policy.id.clone(),
            policy.kind.clone(),
            policy.size_bytes.to_string(),
            policy.training.clone().unwrap_or_else(|| "-".to_owned()),
            if errors.is_empty() { "-".to_owned() } else { format!("{mean:.2}") },
        ]
    };
    let header = ["policy", "kind", "bytes", "training", "MAE mg, mean over powders"];
    table(&header, &policies.iter().map(row).collect::<Vec<_>>())
}
