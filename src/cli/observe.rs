//! `flip observe`: experiments other than the heap, repeated over seeds in parallel.

use super::calibrate::{mean, spread};
use super::device::DeviceArguments;
use super::failure::Failure;
use super::table::table;
use super::{Common, parameters};
use crate::app::local_engine;
use flip_core::domain::FieldError;
use flip_core::domain::observable::{Observable, Observation};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_sim::batch::Failed;
use flip_sim::repose::Refusal;
use flip_sim::{self as sim, observe};
use rayon::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};

/// Maximum number of repeats; more give no new information.
const REPEATS_MAX: u32 = 1000;

/// Arguments of `flip observe`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Experiments: `flow_time:mass_g=50,orifice_mm=2.54`, `shake_mass:pitch_deg=30,shake_mm=4`,
    /// `drained_angle`, `pile_height:base_diameter_mm=40,fall_mm=5`.
    #[arg(required = true, value_name = "KIND:SETTING=VALUE,...")]
    experiments: Vec<String>,
    /// Simulations per experiment, each with its own seed.
    #[arg(long, value_name = "N", default_value_t = 8, allow_negative_numbers = true)]
    repeats: u32,
    #[command(flatten)]
    parameters: parameters::Flags,
    #[command(flatten)]
    device: DeviceArguments,
}

/// The document of `flip observe`.
#[derive(Debug, Serialize)]
struct Document {
    parameters: ParameterSet,
    seed: u64,
    simulator: &'static str,
    /// The card, if one simulated.
    #[serde(skip_serializing_if = "Option::is_none")]
    card: Option<String>,
    observed: Vec<Observed>,
}

#[derive(Debug, Serialize)]
struct Observed {
    observable: Observable,
    unit: &'static str,
    /// Mean and standard deviation over the simulations.
    mean: Option<f64>,
    sd: Option<f64>,
    /// Value of each simulation; `null` for a powder that did not flow.
    values: Vec<Option<f64>>,
    /// Simulations without a value, and why.
    refusals: Vec<String>,
}

/// Simulates the requested experiments and prints the results.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let set = arguments.parameters.set()?;
    if !(1..=REPEATS_MAX).contains(&arguments.repeats) {
        let message =
            format!("must be from 1 to {REPEATS_MAX} simulations, got {}", arguments.repeats);
        return Err(FieldError::new("repeats", message).into());
    }
    let experiments: Vec<Observable> =
        arguments.experiments.iter().map(|text| observable(text)).collect::<Result<_, _>>()?;
    let device = arguments.device.device();
    let off = experiments.iter().find(|it| !device.is_cpu() && !observe::is_on_engines(it));
    if let Some(off) = off {
        let advice = format!(
            "`cuda` cannot simulate `{}`, only `shake_mass` and `pile_height`: leave it or `device` out",
            off.kind()
        );
        return Err(FieldError::new("experiments", advice).into());
    }
    let engine = local_engine(device)?;
    let seeds: Vec<u64> =
        (0..u64::from(arguments.repeats)).map(|repeat| derive(common.seed, &[repeat])).collect();
    let simulated = |observable: &Observable| -> Result<Observed, Failure> {
        let outcomes = match &engine {
            None => {
                seeds.par_iter().map(|seed| observe::observe(observable, &set, *seed)).collect()
            }
            Some(engine) => observe::observe_on(&**engine, observable, &set, &seeds)
                .map_err(|Failed(why)| anyhow::anyhow!(why))?,
        };
        Ok(summed_up(observable, &set, outcomes))
    };
    let observed = experiments.iter().map(simulated).collect::<Result<_, _>>()?;
    let card = engine.as_ref().map(|engine| engine.name());
    let document =
        Document { parameters: set, seed: common.seed, simulator: sim::VERSION, card, observed };
    common.print(&document, || text(&document))
}

fn summed_up(
    observable: &Observable,
    set: &ParameterSet,
    outcomes: Vec<Result<f64, Refusal>>,
) -> Observed {
    let mut refusals = Vec::new();
    let mut values = Vec::new();
    for outcome in outcomes {
        match outcome {
            Ok(reduced) => {
                let value = observe::value(observable, set, reduced);
                values.push(value.is_finite().then_some(value));
            }
            Err(refusal) => refusals.push(refusal.to_string()),
        }
    }
    let finite: Vec<f64> = values.iter().copied().flatten().collect();
    let (mean, sd) = (mean(&finite), spread(&finite));
    Observed { observable: *observable, unit: observable.unit(), mean, sd, values, refusals }
}

fn text(document: &Document) -> String {
    let number =
        |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.4}"));
    let rows = document.observed.iter().map(|observed| {
        let settings = serde_json::to_value(observed.observable).ok();
        let settings = settings.and_then(|value| value.as_object().cloned()).unwrap_or_default();
        let settings: Vec<String> = settings
            .iter()
            .filter(|(key, _)| *key != "kind")
            .map(|(key, value)| format!("{key} {value}"))
            .collect();
        vec![
            observed.observable.kind().to_owned(),
            settings.join(", "),
            number(observed.mean),
            number(observed.sd),
            observed.unit.to_owned(),
            observed.values.iter().flatten().count().to_string(),
        ]
    });
    table(&["experiment", "settings", "mean", "sd", "unit", "runs"], &rows.collect::<Vec<_>>())
}

/// An experiment as typed.
pub(super) fn observable(text: &str) -> Result<Observable, FieldError> {
    let observable: Observable = typed(text, Value::Object(settings(text)?))?;
    // An experiment is validated as part of a measurement.
    let probe = Observation { observable, mean: 10.0, sd: 1.0, n: 2 };
    match probe.checked() {
        Err(error) if error.field != "mean" && error.field != "sd" => Err(error),
        _ => Ok(observable),
    }
}

/// A measurement as typed: the experiment's settings plus `mean`, `sd` and `n`.
pub(super) fn observation(text: &str) -> Result<Observation, FieldError> {
    let mut settings = settings(text)?;
    let mut take = |key: &str| {
        let advice =
            format!("`{text}` lacks `{key}`: write KIND:SETTING=VALUE,...,mean=M,sd=S,n=N");
        settings.remove(key).ok_or_else(|| FieldError::new("observation", advice))
    };
    let (mean, sd, n) = (take("mean")?, take("sd")?, take("n")?);
    let n = n.as_f64().map_or(Value::Null, |n| json!(n as u64));
    typed::<Observation>(text, json!({ "observable": settings, "mean": mean, "sd": sd, "n": n }))?
        .checked()
}

fn settings(text: &str) -> Result<Map<String, Value>, FieldError> {
    let (kind, settings) = text.split_once(':').unwrap_or((text, ""));
    let mut found = Map::new();
    found.insert("kind".to_owned(), json!(kind.trim()));
    for setting in settings.split(',').filter(|setting| !setting.trim().is_empty()) {
        let number = setting
            .split_once('=')
            .and_then(|(key, value)| Some((key.trim(), value.trim().parse::<f64>().ok()?)));
        let Some((key, value)) = number else {
            let advice = format!("`{setting}` must be SETTING=NUMBER, as in `pitch_deg=30`");
            return Err(FieldError::new("observation", advice));
        };
        found.insert(key.to_owned(), json!(value));
    }
    Ok(found)
}

fn typed<T: DeserializeOwned>(text: &str, value: Value) -> Result<T, FieldError> {
    serde_json::from_value(value)
        .map_err(|error| FieldError::new("observation", format!("`{text}`: {error}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn experiments_and_measurements_read_as_typed() {
        let shake = Observable::ShakeMass { pitch_deg: 30.0, shake_mm: 4.0 };
        assert_eq!(observable("shake_mass:pitch_deg=30,shake_mm=4"), Ok(shake));
        assert_eq!(observable("drained_angle"), Ok(Observable::DrainedAngle {}));
        let measured =
            observation("shake_mass:pitch_deg=30,shake_mm=4,mean=1.2,sd=0.4,n=20").unwrap();
        assert_eq!((measured.observable, measured.mean, measured.n), (shake, 1.2, 20));
        for (text, says) in [
            ("shake_mass:pitch_deg=30", "shake_mm"),
            ("shake_mass:pitch_deg=30,shake_mm=400", "shake_mm"),
            ("tap:pitch_deg=30", "tap"),
            ("drained_angle:pitch_deg=30", "pitch_deg"),
            ("drained_angle:pitch_deg", "SETTING=NUMBER"),
        ] {
            let error = observable(text).unwrap_err().to_string();
            assert!(error.contains(says), "{text}: {error}");
        }
        assert!(
            observation("drained_angle:mean=30,sd=1")
                .unwrap_err()
                .to_string()
                .contains("lacks `n`")
        );
    }
}
