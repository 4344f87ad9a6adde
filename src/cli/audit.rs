//! `flip audit`: the record of everything that happened on the bench, even while a server runs.

use super::Common;
use super::failure::Failure;
use super::session::{beside, with_reader};
use crate::app::{
    AUDIT_CSV_HEADER, Archived, AuditAsked, AuditVerification, AuditWanted, ChangedOther,
    ChangedRow, LostArchive, audit_csv,
};
use clap::ValueEnum;
use serde::Serialize;
use std::path::PathBuf;

/// Arguments of `flip audit`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Check the whole hash chain: is every record as it was written?
    Verify {
        /// Hash kept elsewhere, as printed on a certificate: check that it is still in the chain.
        #[arg(long, value_name = "HASH")]
        hash: Option<String>,
    },
    /// Export the records that match, oldest first; without a filter all of them.
    Export {
        #[command(flatten)]
        which: Which,
        /// Output format.
        #[arg(long, value_enum, default_value_t = Format::Json)]
        format: Format,
        /// File to write.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
    /// Move the records of old weighings from the database to files in the data folder; works while
    /// a server runs.
    ///
    /// Readings, messages, decisions and phases are written to `audit/….jsonl.gz`, read back, and
    /// referenced in the record by file and hash. Intents, outcomes and people's actions stay.
    /// Certificates, lists, exports and `verify` read the files, and `flip backup` copies them.
    Archive {
        /// Archive weighings that ended before this day (from its start, UTC) or point in time.
        #[arg(long, value_name = "DATE")]
        before: String,
    },
    /// Write a weighing's certificate, an HTML page to print.
    Certificate {
        /// Weighing id.
        #[arg(long, value_name = "ID")]
        weighing: String,
        /// Name of the laboratory, at its head.
        #[arg(long, value_name = "NAME")]
        laboratory: Option<String>,
        /// File to write.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
}

/// Which records.
#[derive(Debug, Clone, clap::Args)]
struct Which {
    /// Only records of this weighing.
    #[arg(long, value_name = "ID")]
    weighing: Option<String>,
    /// Only of this kind, e.g. person, outcome, reading.
    #[arg(long, value_name = "KIND")]
    kind: Option<String>,
    /// Only with these words in the name of the person who acted, signed or is the operator.
    #[arg(long, value_name = "WORDS")]
    person: Option<String>,
    /// Only on this day (UTC) or later, or from this time on.
    #[arg(long, value_name = "DATE")]
    since: Option<String>,
    /// Only on this day (UTC) or earlier, or before this time.
    #[arg(long, value_name = "DATE")]
    until: Option<String>,
    /// Only with these words in the weighing, the kind or the contents.
    #[arg(long, value_name = "WORDS")]
    q: Option<String>,
}

impl Which {
    fn asked(&self) -> AuditAsked {
        let Self { weighing, kind, person, since, until, q: text } = self.clone();
        let wanted = AuditWanted { weighing, kind, person, text, ..AuditWanted::default() };
        AuditAsked { wanted, since, until }
    }
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Format {
    Json,
    Csv,
}

/// The document of a written file.
#[derive(Debug, Serialize)]
struct Written {
    file: PathBuf,
    records: usize,
}

/// Runs the chosen subcommand.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.what {
        What::Verify { hash } => verify(common, hash.as_deref()),
        What::Export { which, format, out } => export(common, which, *format, out.clone()),
        What::Archive { before } => {
            let done = beside(common, async |lab| Ok(lab.here()?.archive_audit(before).await?))?;
            common.print(&done, || archived(&done))
        }
        What::Certificate { weighing, laboratory, out } => {
            let laboratory = laboratory.as_deref();
            let page =
                with_reader(common, async |lab| Ok(lab.certificate(weighing, laboratory).await?))?;
            std::fs::write(out, page)?;
            let written = Written { file: out.clone(), records: 1 };
            common.print(&written, || format!("{} holds the certificate", written.file.display()))
        }
    }
}

fn verify(common: &Common, hash: Option<&str>) -> Result<(), Failure> {
    let found = with_reader(common, async |lab| Ok(lab.verify_audit(hash).await?))?;
    common.print(&found, || text(&found))?;
    match is_intact(&found) {
        true => Ok(()),
        false => Err(Failure::Failed(anyhow::anyhow!("the audit trail is not what was written"))),
    }
}

fn archived(done: &Archived) -> String {
    let Archived { weighings, records, files, bytes, .. } = done;
    match files.is_empty() {
        true => "nothing to archive: no weighing that ended before has records here".to_owned(),
        false => format!(
            "{records} records of {weighings} weighings in {} files, {bytes} bytes:\n  {}",
            files.len(),
            files.join("\n  ")
        ),
    }
}

fn is_intact(found: &AuditVerification) -> bool {
    found.broken.is_none() && found.holds_hash != Some(false)
}

fn text(found: &AuditVerification) -> String {
    let rows = differences(found);
    let state = match (&found.broken, found.holds_hash) {
        (Some(broken), _) if rows.is_empty() => {
            format!("broken at record {}: {}", broken.seq, broken.why)
        }
        (Some(_), _) if found.changed.is_empty() && found.others.is_empty() => {
            format!("intact except for what is lost:{rows}")
        }
        (Some(_), _) => format!("intact, but results or other rows differ from it:{rows}"),
        (None, Some(false)) => {
            "intact, but it does not hold that hash: records were cut off".to_owned()
        }
        (None, _) => "intact".to_owned(),
    };
    format!("{} records, {state}\nlast hash {}", found.records, found.last_hash)
}

/// Lost and differing records, one per line.
fn differences(found: &AuditVerification) -> String {
    let archive = |it: &LostArchive| {
        format!("\n  archive {} (records {} to {}): {}", it.file, it.first, it.last, it.why)
    };
    let row = |it: &ChangedRow| format!("\n  weighing {}: {}", it.weighing, it.why);
    let other = |it: &ChangedOther| {
        format!("\n  {} {}: {}", it.what.name().replace('_', " "), it.id, it.why)
    };
    let lines = found
        .archives
        .iter()
        .map(archive)
        .chain(found.changed.iter().map(row))
        .chain(found.others.iter().map(other));
    lines.collect()
}

fn export(common: &Common, which: &Which, format: Format, out: PathBuf) -> Result<(), Failure> {
    let (text, records) = with_reader(common, async |lab| {
        let all = lab.audit_records(which.asked()).await?;
        let text = match format {
            Format::Json => serde_json::to_string_pretty(&all)?,
            Format::Csv => {
                AUDIT_CSV_HEADER.to_owned() + &all.iter().map(audit_csv).collect::<String>()
            }
        };
        Ok((text, all.len()))
    })?;
    std::fs::write(&out, text)?;
    let written = Written { file: out, records };
    common.print(&written, || format!("{} records in {}", written.records, written.file.display()))
}
