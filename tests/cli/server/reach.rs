//! Every command either asks a server or says why it does not: a new one has to decide.

use super::ask;
use crate::harness::{expect_status, stderr};

/// No server.
const NOWHERE: &str = "http://127.0.0.1:1";

/// Commands that ask a server, with arguments that they accept.
const THERE: [&str; 47] = [
    "calibrate --powder salt",
    "measure --powder salt",
    "measurements import FILE",
    "measurements export",
    "measurements compare",
    "shakes list",
    "shakes export",
    "shakes import FILE",
    "shakes forget --powder salt",
    "compare one other",
    "train",
    "evaluate",
    "policy list",
    "policy show --policy p",
    "policy export --policy p --out x",
    "policy import --file FILE",
    "discover --shakes --out x",
    "discover predict --measurements FILE",
    "discover versions",
    "discover use base",
    "weigh --powder salt --target-mg 8",
    "characterise --powder salt",
    "film",
    "bench status",
    "bench list",
    "bench load --bench-name hall-2",
    "bench stop --bench-name hall-2",
    "bench clear --by Ada --looked --vial-ready",
    "bench resume --by Ada",
    "bench reserve --owner Ada --seconds 9",
    "bench release rs",
    "bench vial-ready w",
    "bench repeatability --readings-mg 1,2",
    "bench read",
    "bench tare",
    "bench zero --reservation rs",
    "export --out x",
    "audit verify",
    "audit export --out x",
    "audit certificate --weighing w --out x",
    "jobs",
    "token create --role viewer",
    "token list",
    "token revoke x",
    "health",
    "jobs --times",
    "characterise --powder salt --show",
];

/// Commands that do not.
const HERE: [&str; 28] = [
    "serve",
    "worker",
    "demo",
    "observe drained",
    "heap",
    "repose",
    "validate",
    "policy infer --policy p --stdin",
    "bench probe --port x",
    "bench check --config x",
    "bench calibrate-shake --config x --by Ada --spoon-empty",
    "bench sim",
    "bench bed x",
    "audit archive --before 2026-01-01",
    "backup x",
    "restore x",
    "migrate --from x --to postgres://x/y",
    "emulate lab --out x",
    "emulate balance",
    "emulate arm",
    "emulate gripper",
    "emulate gate",
    "emulate camera --out x",
    "doctor",
    "config check x",
    "completions bash",
    "man x",
    "serve --listen 127.0.0.1:0",
];

/// The commands that do something, by their words.
fn leaves(command: &clap::Command, words: &str, into: &mut Vec<String>) {
    let subs: Vec<_> = command.get_subcommands().filter(|it| it.get_name() != "help").collect();
    if subs.is_empty() || command.is_subcommand_negates_reqs_set() {
        into.push(words.trim().to_owned());
    }
    for sub in subs {
        leaves(sub, &format!("{words} {}", sub.get_name()), into);
    }
}

#[test]
fn every_command_asks_a_server_or_says_why_not() {
    let mut all = Vec::new();
    leaves(&flip::cli::command(), "", &mut all);
    for leaf in &all {
        let is_it = |line: &&str| *line == leaf || line.starts_with(&format!("{leaf} "));
        assert!(THERE.iter().chain(&HERE).any(is_it), "`flip {leaf}`: here or there?");
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file.csv");
    std::fs::write(&file, "powder,repose_deg\nsalt,36\n").unwrap();
    let run = |line: &str| {
        let words: Vec<&str> = line
            .split(' ')
            .map(|word| if word == "FILE" { file.to_str().unwrap() } else { word })
            .collect();
        ask(NOWHERE, "", &words)
    };
    for line in THERE {
        let output = run(line);
        expect_status(&output, 1);
        assert!(stderr(&output).contains(NOWHERE), "{line}: {}", stderr(&output));
    }
    for line in HERE {
        let output = run(line);
        expect_status(&output, 2);
        let said = stderr(&output);
        assert!(said.contains("server: `flip ") && said.contains("leave --server out"), "{said}");
    }
}
