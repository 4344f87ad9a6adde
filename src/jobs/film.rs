//! Films a spoonful of a weighing, whose record makes the same grains fall again, or a heap, which its
//! parameter set and its seed make again.
//!
//! An attempt begins anew: a film takes seconds.

use super::host::{Finished, JobError, JobHost, Result, go_on};
use super::spec::{FilmSpec, HeapFilmSpec};
use super::spoon::measured;
use flip_core::domain::FieldError;
use flip_core::domain::bench::BenchKind;
use flip_core::domain::conditions::Patch;
use flip_core::domain::job::Progress;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_core::domain::shake::Spoonful;
use flip_core::domain::spoon::Spoon;
use flip_sim::dispense::Settings;
use flip_sim::film::{Film, Moves, NoFilm, film};
pub use flip_sim::film::{Head as FilmHead, Scene, StepSeen};
use flip_sim::heap_film;
pub use flip_sim::heap_film::{Head as HeapHead, Ring as HeapRing, Scene as HeapScene};
use flip_sim::replay::{Replay, Step};
use flip_sim::repose::Settings as HeapSettings;
use serde::{Deserialize, Serialize};

/// A film that was made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FilmResult {
    /// SHA-256 of the file.
    pub sha256: String,
    /// Size of the file, bytes.
    pub size_bytes: u64,
    /// What it says in numbers; absent of a heap.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub head: Option<FilmHead>,
    /// What a film of a heap says in numbers; absent of a spoonful.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub heap: Option<HeapHead>,
}

/// What a dose was made with.
#[derive(Debug, Clone, Copy)]
pub struct Dose<'a> {
    /// The simulated powder, before its conditions.
    pub set: &'a ParameterSet,
    /// What its conditions change.
    pub patch: &'a Patch,
    /// Seed of the simulated bench.
    pub seed: u64,
    /// The bench that shook it.
    pub bench: BenchKind,
    /// The spoon of the present bench; counts only on devices.
    pub spoon: &'a Spoon,
}

/// The spoonful of a dose, to be made again: with the spoon, moves and seed of the bench where its
/// powder was simulated, and with as many grains as it weighed where it was not.
///
/// # Errors
/// The spoon of the devices cannot be simulated, or a mechanism of the patch is unknown.
pub fn scene(of: &Dose<'_>, spoonful: &Spoonful) -> std::result::Result<Scene, FieldError> {
    let usual = Settings::default();
    let usual = if of.bench == BenchKind::Devices { measured(of.spoon, usual)? } else { usual };
    let settings = Settings { extensions: usual.extensions.patched(of.patch)?, ..usual };
    let set = of.patch.powder(of.set);
    // Each filling of a simulated spoon has its own seed.
    let seed = derive(of.seed, &[u64::from(spoonful.spoonful) - 1]);
    let replay = match of.bench {
        BenchKind::Devices => Replay::of(&set, &settings, spoonful, seed),
        BenchKind::Simulated | BenchKind::Emulated => {
            Replay { set, settings, steps: spoonful.shakes.iter().map(Step::from).collect(), seed }
        }
    };
    let moves = match of.bench {
        BenchKind::Simulated => Moves::AtOnce,
        BenchKind::Emulated | BenchKind::Devices => Moves::InTurn,
    };
    Ok(Scene { replay, moves })
}

/// A heap of a set, poured as usual.
pub fn heap_scene(set: &ParameterSet, seed: u64) -> HeapScene {
    HeapScene { set: *set, settings: HeapSettings::default(), seed }
}

pub(super) fn perform(host: &dyn JobHost, spec: &FilmSpec) -> Result<()> {
    let mut unsaved = None;
    let filmed = film(&spec.scene, &mut |done, all| {
        let message = match done {
            0 => "fills the spoon".to_owned(),
            step if step + 1 < all => format!("step {} of {}", step + 1, all - 1),
            _ => "levels the spoon".to_owned(),
        };
        // The filling takes about as long as a step.
        let fraction = done as f64 / all as f64;
        go_on(host, host.report(&Progress { fraction, message }), &mut unsaved)
    });
    if let Some(error) = unsaved {
        return Err(error);
    }
    finish(host, filmed)
}

/// Ends the job of a film of a spoonful.
pub(super) fn finish(host: &dyn JobHost, filmed: std::result::Result<Film, NoFilm>) -> Result<()> {
    let (sha256, size_bytes, head) = kept(host, filmed)?;
    let result = FilmResult { sha256, size_bytes, head: Some(head), heap: None };
    host.finish(&Finished::Film { result: &result })
}

pub(super) fn perform_heap(host: &dyn JobHost, spec: &HeapFilmSpec) -> Result<()> {
    let mut unsaved = None;
    let filmed = heap_film::film(&spec.scene, &mut |fraction| {
        let message = "pours the heap".to_owned();
        go_on(host, host.report(&Progress { fraction, message }), &mut unsaved)
    });
    if let Some(error) = unsaved {
        return Err(error);
    }
    let (sha256, size_bytes, head) = kept(host, filmed)?;
    let result = FilmResult { sha256, size_bytes, head: None, heap: Some(head) };
    host.finish(&Finished::Film { result: &result })
}

/// Stores the file of a film; its SHA-256, its size and the film's head.
fn kept<H: Serialize>(
    host: &dyn JobHost,
    filmed: std::result::Result<Film<H>, NoFilm>,
) -> Result<(String, u64, H)> {
    let film = filmed.map_err(|error| match error {
        NoFilm::Stopped => JobError::Stopped,
        NoFilm::Diverged(refusal) => JobError::Fail(refusal.to_string()),
    })?;
    let bytes = film.to_bytes();
    Ok((host.put(&bytes)?, bytes.len() as u64, film.head))
}
