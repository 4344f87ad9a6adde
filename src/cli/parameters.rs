//! The nine parameters as flags, generated from their table so that help, bounds and defaults
//! cannot drift from it.

use clap::{Arg, ArgMatches, Args, Command, FromArgMatches};
use flip_core::domain::FieldError;
use flip_core::domain::parameters::{COUNT, PARAMETERS, Parameter, ParameterSet};
use flip_sim::mechanisms::Extensions;
use std::collections::BTreeMap;

/// The nine values as typed by the caller, not yet checked against their bounds.
#[derive(Debug, Clone, Copy)]
pub(super) struct Flags([f64; COUNT]);

impl Flags {
    /// The parameter set described by these flags.
    ///
    /// # Errors
    /// The first value that is not finite or outside its published bounds, by key.
    pub(super) fn set(&self) -> Result<ParameterSet, FieldError> {
        ParameterSet::new(self.0)
    }
}

impl FromArgMatches for Flags {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        Ok(Self(PARAMETERS.map(|p| *matches.get_one::<f64>(p.key).unwrap_or(&p.default))))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Args for Flags {
    fn augment_args(command: Command) -> Command {
        command.next_help_heading("Parameters of the powder").args(PARAMETERS.iter().map(flag))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

fn flag(parameter: &Parameter) -> Arg {
    // clap keeps names for the lifetime of the program; nine short strings are leaked once.
    let long: &'static str = Box::leak(parameter.key.replace('_', "-").into_boxed_str());
    let unit =
        if parameter.unit.is_empty() { String::new() } else { format!(" {}", parameter.unit) };
    let Parameter { lower, upper, default, meaning, .. } = parameter;
    Arg::new(parameter.key)
        .long(long)
        .value_name("X")
        .value_parser(clap::value_parser!(f64))
        .allow_negative_numbers(true)
        .help(format!("{meaning}; {lower} to {upper}{unit} [default: {default}]"))
}

/// The mechanisms given in flags.
pub(super) fn extensions(flags: &[String]) -> Result<Extensions, FieldError> {
    let amplitudes = amplitudes(flags)?;
    amplitudes.iter().try_fold(Extensions::default(), |extensions, (name, amplitude)| {
        extensions.with(name, *amplitude)
    })
}

/// Names of mechanisms and their amplitudes as given in flags, not yet checked; for a repeated name
/// the last one counts.
pub(super) fn amplitudes(flags: &[String]) -> Result<BTreeMap<String, f64>, FieldError> {
    numbers("extension", "rotation=1", flags)
}

/// Parameters to hold at a value as given in flags, not yet checked; for a repeated name the last
/// one counts.
pub(super) fn fixed(flags: &[String]) -> Result<BTreeMap<String, f64>, FieldError> {
    numbers("fix", "gravity_scale=1", flags)
}

/// Names and numbers, as in `example`.
fn numbers(
    field: &str,
    example: &str,
    flags: &[String],
) -> Result<BTreeMap<String, f64>, FieldError> {
    let number = |flag: &String| {
        let parts =
            flag.split_once('=').and_then(|(name, number)| Some((name, number.parse().ok()?)));
        parts.map(|(name, number)| (name.to_owned(), number)).ok_or_else(|| {
            let message = format!(
                "must be a name, an equals sign and a number, as in `{example}`, got `{flag}`"
            );
            FieldError::new(field, message)
        })
    };
    flags.iter().map(number).collect()
}
