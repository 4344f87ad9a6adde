//! The settings file that complements the flags, and `flip config check`.
//!
//! ```toml
//! data_dir = "/var/lib/flip"      # every command's
//! [serve]                         # that of `flip serve`
//! listen = "127.0.0.1:8080"
//! bench = "/etc/flip/bench.toml"
//! ```
//!
//! A table is a command, a key is one of its long options, with dashes or underscores. Settings
//! from the file are appended to the typed arguments if these omit them. Precedence: command line,
//! environment, file, default in `--help`; typed options also override settings in the file that
//! conflict with them. `server` applies to the commands that can ask one, and puts aside what it has
//! itself, such as `data_dir`. A file with an error sets nothing. A person's confirmations for the moment,
//! that the bench was checked or which vial is in, cannot be set in a file.

use super::failure::Failure;
use super::{Cli, Common, reach};
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Command, CommandFactory};
use flip_core::domain::FieldError;
use serde::Serialize;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Environment variable that gives the file if `--settings` does not.
pub(super) const VARIABLE: &str = "FLIP_SETTINGS";
/// Options that a person gives each time: name, what was checked, what is to be given up.
const SAID: [&str; 10] = [
    "by",
    "note",
    "looked",
    "vial-ready",
    "vial",
    "resume",
    "spoon-empty",
    "funnel-empty",
    "keep-tokens",
    "idempotency-key",
];
/// Minimum similarity (Jaro-Winkler) of names suggested for an unknown one.
const SIMILAR: f64 = 0.8;

/// Arguments of `flip config`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Read a settings file and report what it sets, or every mistake in it.
    Check {
        /// Settings file.
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
}

/// One setting in a file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct Setting {
    /// Command, in words; empty for every command.
    command: String,
    /// Long option, without dashes.
    option: String,
    /// Values as on the command line; only one, unless the option can be repeated.
    values: Vec<String>,
    /// Whether it takes no value.
    #[serde(skip)]
    is_switch: bool,
}

/// Checks a file.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let What::Check { file } = &arguments.what;
    let settings = read(file)?;
    common.print(&settings, || text(&settings))
}

fn text(settings: &[Setting]) -> String {
    let line =
        |it: &Setting| format!("flip {} --{} {}", it.command, it.option, it.values.join(" "));
    let lines: Vec<String> = settings.iter().map(|it| line(it).replace("  ", " ")).collect();
    if lines.is_empty() { "nothing is set".to_owned() } else { lines.join("\n") }
}

/// The arguments, followed by settings for the same command that they omit, from the file given by
/// them or the environment.
///
/// # Errors
/// A file that cannot be read or contains an error.
pub(super) fn completed(arguments: Vec<OsString>) -> Result<Vec<OsString>, Failure> {
    match named(&arguments) {
        Some(file) => Ok(with(&read(&file)?, arguments)),
        None => Ok(arguments),
    }
}

fn with(settings: &[Setting], mut arguments: Vec<OsString>) -> Vec<OsString> {
    // Help and version output need no settings.
    let Ok(typed) = Cli::command().ignore_errors(true).try_get_matches_from(&arguments) else {
        return arguments;
    };
    let mut command = Cli::command();
    command.build();
    let wanted: Vec<_> = settings.iter().filter(|it| it.is_wanted(&command, &typed)).collect();
    let is_server = |it: &&Setting| it.option == "server" && reach::fits("server", &typed, false);
    let asks_server = wanted.iter().any(is_server);
    let added = wanted.iter().filter(|it| reach::fits(&it.option, &typed, asks_server));
    let added: Vec<OsString> = added.flat_map(|it| it.typed()).map(OsString::from).collect();
    let end = arguments.iter().position(|it| it == "--").unwrap_or(arguments.len());
    arguments.splice(end..end, added);
    arguments
}

/// Whether this option was given, on the command line or in the environment.
pub(super) fn is_given(typed: &ArgMatches, id: &str) -> bool {
    let source = typed.try_contains_id(id).is_ok().then(|| typed.value_source(id)).flatten();
    matches!(source, Some(ValueSource::CommandLine | ValueSource::EnvVariable))
}

/// The file given in the arguments or the environment.
fn named(arguments: &[OsString]) -> Option<PathBuf> {
    let mut arguments = arguments.iter().take_while(|it| *it != "--");
    while let Some(argument) = arguments.next() {
        if argument == "--settings" {
            return arguments.next().map(PathBuf::from);
        }
        if let Some(file) = argument.to_str().and_then(|it| it.strip_prefix("--settings=")) {
            return Some(file.into());
        }
    }
    std::env::var_os(VARIABLE).filter(|it| !it.is_empty()).map(PathBuf::from)
}

/// The settings in a file, in order.
fn read(file: &Path) -> Result<Vec<Setting>, Failure> {
    let refuse = |message: String| Failure::from(FieldError::new("config", message));
    let text =
        std::fs::read_to_string(file).map_err(|e| refuse(format!("{}: {e}", file.display())))?;
    let table: toml::Table =
        toml::from_str(&text).map_err(|e| refuse(format!("{}: {e}", file.display())))?;
    let mut command = Cli::command();
    command.build();
    let mut found = Found::default();
    found.table(&command, &[], &table);
    found.together();
    if found.mistakes.is_empty() {
        Ok(found.settings)
    } else {
        Err(Failure::BadInput(found.mistakes))
    }
}

impl Setting {
    /// Whether it belongs to the called command and nothing given prevents it: the option itself,
    /// or a conflicting one.
    fn is_wanted(&self, mut command: &Command, mut typed: &ArgMatches) -> bool {
        let is_everybodys = self.command.is_empty();
        let mut words = self.command.split_whitespace();
        while let Some((name, matches)) = typed.subcommand() {
            if !is_everybodys && words.next() != Some(name) {
                return false;
            }
            let Some(inner) = command.find_subcommand(name) else { return false };
            (command, typed) = (inner, matches);
        }
        let Some(option) = option(command, &self.option).filter(|_| words.next().is_none()) else {
            return false;
        };
        let refuses = |a: &Arg, b: &Arg| {
            command.get_arg_conflicts_with(a).iter().any(|it| it.get_id() == b.get_id())
        };
        let mut given = command.get_arguments().filter(|it| is_given(typed, it.get_id().as_str()));
        !given
            .any(|it| it.get_id() == option.get_id() || refuses(option, it) || refuses(it, option))
    }

    /// As it would be typed.
    fn typed(&self) -> Vec<String> {
        let one = |value: &String| format!("--{}={value}", self.option);
        if self.is_switch {
            vec![format!("--{}", self.option)]
        } else {
            self.values.iter().map(one).collect()
        }
    }
}

/// Clap's complaint about missing or conflicting options.
fn complaint(words: Vec<String>) -> Vec<String> {
    let Err(error) = Cli::command().try_get_matches_from(words) else { return Vec::new() };
    let is_ours =
        matches!(error.kind(), ErrorKind::MissingRequiredArgument | ErrorKind::ArgumentConflict);
    let told = [ContextKind::InvalidArg, ContextKind::PriorArg].map(|kind| match error.get(kind) {
        Some(ContextValue::Strings(all)) => all.clone(),
        Some(ContextValue::String(one)) => vec![one.clone()],
        _ => Vec::new(),
    });
    if is_ours { told.concat() } else { Vec::new() }
}

#[derive(Debug, Default)]
struct Found {
    settings: Vec<Setting>,
    mistakes: Vec<FieldError>,
}

impl Found {
    /// `path`: the words of the command.
    fn table(&mut self, command: &Command, path: &[&str], table: &toml::Table) {
        for (key, value) in table {
            let name = key.replace('_', "-");
            let field = [path, &[key.as_str()]].concat().join(".");
            match (value, command.find_subcommand(&name), option(command, &name)) {
                (toml::Value::Table(inner), Some(sub), _) => {
                    self.table(sub, &[path, &[sub.get_name()]].concat(), inner)
                }
                (toml::Value::Table(_), None, _) => {
                    let commands = command.get_subcommands().map(Command::get_name);
                    self.refuse(
                        field,
                        format!("there is no command `{name}`{}", nearest(&name, commands)),
                    );
                }
                (_, _, Some(_)) if SAID.contains(&name.as_str()) => {
                    self.refuse(
                        field,
                        format!("`--{name}` is said by a person each time, and no file can say it"),
                    );
                }
                (_, _, Some(option)) => self.option(field, path, option, value),
                (..) => {
                    let options = command.get_arguments().filter_map(Arg::get_long);
                    self.refuse(
                        field,
                        format!("there is no option `--{name}`{}", nearest(&name, options)),
                    );
                }
            }
        }
    }

    fn option(&mut self, field: String, path: &[&str], option: &Arg, value: &toml::Value) {
        let values = match value {
            toml::Value::Array(values) => values.iter().map(plain).collect(),
            // A switch that is off keeps its default.
            toml::Value::Boolean(false) if matches!(option.get_action(), ArgAction::SetTrue) => {
                return;
            }
            value => vec![plain(value)],
        };
        match accepts(option, &values) {
            Ok(()) => self.settings.push(Setting {
                command: path.join(" "),
                option: option.get_long().unwrap_or_default().to_owned(),
                values,
                is_switch: matches!(option.get_action(), ArgAction::SetTrue),
            }),
            Err(why) => self.refuse(field, why),
        }
    }

    /// Checks that the options of each command can be given together.
    fn together(&mut self) {
        let mut commands: Vec<String> = self.settings.iter().map(|it| it.command.clone()).collect();
        commands.dedup();
        for command in commands {
            let of = |it: &&Setting| it.command == command || it.command.is_empty();
            let typed = self.settings.iter().filter(of).flat_map(Setting::typed);
            let words: Vec<String> =
                ["flip"].into_iter().chain(command.split_whitespace()).map(str::to_owned).collect();
            let (alone, all) =
                (complaint(words.clone()), complaint(words.into_iter().chain(typed).collect()));
            let new: Vec<String> = all.iter().filter(|it| !alone.contains(it)).cloned().collect();
            if !new.is_empty() {
                let field =
                    if command.is_empty() { "flip".to_owned() } else { command.replace(' ', ".") };
                self.refuse(
                    field,
                    format!("what is set here does not go together: {}", new.join(", ")),
                );
            }
        }
    }

    fn refuse(&mut self, field: String, why: String) {
        self.mistakes.push(FieldError::new(field, why));
    }
}

/// An option that a file may set.
fn option<'a>(command: &'a Command, name: &str) -> Option<&'a Arg> {
    let unusual = ["settings", "help", "version"];
    command.get_arguments().find(|it| it.get_long() == Some(name) && !unusual.contains(&name))
}

/// A value as it would be typed.
fn plain(value: &toml::Value) -> String {
    match value {
        toml::Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

/// Checks these values with the option's own parser.
fn accepts(option: &Arg, values: &[String]) -> Result<(), String> {
    let name = option.get_long().unwrap_or_default();
    if matches!(option.get_action(), ArgAction::SetTrue) {
        return if values == ["true"] {
            Ok(())
        } else {
            Err("is a switch: write true or false".to_owned())
        };
    }
    let is_repeated = matches!(option.get_action(), ArgAction::Append);
    let one = Arg::new("it").long(name.to_owned()).value_parser(option.get_value_parser().clone());
    let one = one.action(option.get_action().clone()).allow_negative_numbers(true);
    let one = one.value_delimiter(option.get_value_delimiter());
    if values.len() != 1 && !is_repeated && option.get_value_delimiter().is_none() {
        return Err(format!("takes one value, and {} are given", values.len()));
    }
    let typed = values.iter().map(|value| format!("--{name}={value}"));
    let typed: Vec<String> =
        if is_repeated { typed.collect() } else { vec![format!("--{name}={}", values.join(","))] };
    let words = std::iter::once("flip".to_owned()).chain(typed);
    let parsed = Command::new("flip").arg(one).try_get_matches_from(words);
    parsed.map(drop).map_err(|error| {
        let told = error.render().to_string();
        told.lines().next().unwrap_or_default().trim_start_matches("error: ").to_owned()
    })
}

/// `, did you mean …`, or a list of all.
fn nearest<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> String {
    let known: Vec<&str> = known.collect();
    let like = |it: &&&str| strsim::jaro_winkler(name, it);
    match known.iter().max_by(|a, b| like(a).total_cmp(&like(b))).filter(|it| like(it) >= SIMILAR) {
        Some(best) => format!(", did you mean `{best}`?"),
        None => format!(": there are {}", known.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    fn settings(text: &str) -> Result<Vec<Setting>, Vec<String>> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("flip.toml");
        std::fs::write(&file, text).unwrap();
        read(&file).map_err(|failure| match failure {
            Failure::BadInput(errors) => errors.iter().map(ToString::to_string).collect(),
            other => panic!("{other:?}"),
        })
    }

    fn parsed(text: &str, words: &[&str]) -> Cli {
        let words = with(&settings(text).unwrap(), words.iter().map(OsString::from).collect());
        Cli::try_parse_from(words).unwrap()
    }

    #[test]
    fn a_file_sets_what_the_command_line_leaves_out() {
        let file = "data_dir = \"/tmp/one\"\nseed = 7\n[serve]\nlisten = \"127.0.0.1:1\"\ninsecure-lan = true\n";
        let cli = parsed(file, &["flip", "serve"]);
        assert_eq!((cli.common.data_dir.to_str(), cli.common.seed), (Some("/tmp/one"), 7));
        let told = format!("{:?}", cli.command);
        assert!(told.contains("127.0.0.1:1") && told.contains("insecure_lan: true"), "{told}");
        let cli = parsed(file, &["flip", "--seed", "8", "serve", "--listen", "127.0.0.1:2"]);
        assert_eq!(cli.common.seed, 8);
        assert!(format!("{:?}", cli.command).contains("127.0.0.1:2"));
        // Another command gets only the options common to all.
        assert_eq!(parsed(file, &["flip", "jobs"]).common.seed, 7);
    }

    #[test]
    fn every_mistake_is_named_with_its_place_and_nothing_is_set() {
        let errors = settings(
            "sede = 3\n[serv]\nlisten = \"x\"\n[serve]\nlisten = \"everywhere\"\ninsecure_lan = 3\n[weigh]\nhelp = true\n",
        );
        let errors = errors.unwrap_err();
        for part in [
            "sede",
            "did you mean `seed`",
            "serv:",
            "did you mean `serve`",
            "serve.listen",
            "everywhere",
            "serve.insecure_lan",
            "true or false",
            "weigh.help",
        ] {
            assert!(errors.iter().any(|it| it.contains(part)), "{part} is not in {errors:?}");
        }
        assert_eq!(errors.len(), 5, "{errors:?}");
    }

    #[test]
    fn the_file_is_named_by_the_option_in_either_form() {
        let words = |words: &[&str]| named(&words.iter().map(OsString::from).collect::<Vec<_>>());
        assert_eq!(words(&["flip", "serve", "--settings", "a"]), Some("a".into()));
        assert_eq!(words(&["flip", "--settings=b", "serve"]), Some("b".into()));
        assert_eq!(words(&["flip", "weigh", "--", "--settings=b"]), None);
        // The bench file of `flip bench check` is a different one.
        assert_eq!(words(&["flip", "bench", "check", "--config", "bench.toml"]), None);
    }

    #[test]
    fn what_is_typed_puts_aside_what_it_cannot_stand_beside() {
        let told = |words: &[&str]| {
            format!("{:?}", parsed("[calibrate]\npowder = \"salt\"\n", words).command)
        };
        let typed = told(&["flip", "calibrate", "--repose-deg", "30"]);
        assert!(typed.contains("30.0") && !typed.contains("salt"), "{typed}");
        assert!(told(&["flip", "calibrate"]).contains("salt"));
        assert!(told(&["flip", "calibrate", "--powder", "sand"]).contains("sand"));
        // Settings of a command do not apply to its subcommands.
        let below = parsed("[discover]\nbudget_runs = 3\n", &["flip", "discover", "versions"]);
        assert!(matches!(below.command, super::super::Command::Discover(_)));
    }

    #[test]
    fn what_does_not_go_together_is_named_and_what_a_person_says_no_file_says() {
        let refused = |text: &str| settings(text).unwrap_err().join("; ");
        let both = refused("[calibrate]\npowder = \"salt\"\nrepose_deg = 30\n");
        assert!(both.contains("calibrate") && both.contains("--repose-deg"), "{both}");
        let half = refused("[serve]\ntls_cert = \"c.pem\"\n");
        assert!(half.contains("serve") && half.contains("--tls-key"), "{half}");
        for said in ["by = \"a robot\"", "looked = true", "vial_ready = true", "resume = true"] {
            let why = refused(&format!("[bench.clear]\n{said}\n"));
            assert!(why.contains("a person"), "{why}");
        }
        let devices = "[bench.check]\nconfig = \"bench.toml\"\n";
        assert_eq!(settings(devices).unwrap().len(), 1, "the bench file may be set");
    }

    #[test]
    fn every_option_with_a_default_can_stand_in_a_file() {
        let mut command = Cli::command();
        command.build();
        let mut options = 0;
        for sub in command.get_subcommands() {
            for arg in sub.get_arguments() {
                let Some(option) = arg.get_long().and_then(|name| option(sub, name)) else {
                    continue;
                };
                let values: Vec<String> = option
                    .get_default_values()
                    .iter()
                    .map(|it| it.to_string_lossy().into_owned())
                    .collect();
                let is_switch = matches!(option.get_action(), ArgAction::SetTrue);
                if values.is_empty() || is_switch {
                    continue;
                }
                assert_eq!(
                    accepts(option, &values),
                    Ok(()),
                    "{} --{:?}",
                    sub.get_name(),
                    option.get_long()
                );
                options += 1;
            }
        }
        assert!(options > 20, "{options}");
    }
}
