//! `flip film`: the grains of a weighing's spoonful, of a heap of a parameter set, or of a dose with
//! the network of a training's episode, made by the simulator, as a file.

use super::Common;
use super::failure::Failure;
use super::lab::Lab;
use super::labels::LabelArguments;
use super::session::with_app;
use super::table::table;
use super::watch::Watch;
use crate::app::{Film, FilmHead, FilmRequest, FilmResult, HeapHead, StepSeen};
use flip_core::domain::FieldError;
use flip_core::domain::bench::BenchKind;
use serde::Serialize;
use std::path::PathBuf;

/// Arguments of `flip film`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Weighing id [default: the newest].
    #[arg(long, value_name = "ID")]
    weighing: Option<String>,
    /// Which spoonful of it, from 1 [default: 1].
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    spoonful: Option<u32>,
    /// Parameter set id: films a heap of it, with the seed of `--seed`.
    #[arg(long, value_name = "ID")]
    set: Option<String>,
    /// Training id: films a dose with the network of `--episode`.
    #[arg(long, value_name = "ID")]
    training: Option<String>,
    /// Which episode of it, one whose network is kept: 1, 10, 100, 1000 and the last.
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    episode: Option<u32>,
    /// File to write, at most 16 MiB; without it only the numbers are printed.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    labels: LabelArguments,
}

/// The document of `flip film`.
#[derive(Debug, Serialize)]
struct Document {
    film: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    weighing: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    spoonful: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bench: Option<BenchKind>,
    #[serde(skip_serializing_if = "Option::is_none")]
    set: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    seed: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    training: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    episode: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    target_mg: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    out: Option<PathBuf>,
    #[serde(flatten)]
    result: FilmResult,
}

/// Makes the film, unless it is made already, and writes it.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let Arguments { weighing, spoonful, set, training, episode, out, labels } = arguments;
    let labels = labels.all()?;
    let (film, bytes) = with_app(common, async |lab| {
        let weighing = match (weighing, set, training) {
            (None, None, None) => Some(newest(lab).await?),
            (weighing, ..) => weighing.clone(),
        };
        let request = FilmRequest {
            weighing,
            spoonful: *spoonful,
            set: set.clone(),
            seed: set.as_ref().map(|_| common.seed),
            training: training.clone(),
            episode: *episode,
            labels,
        };
        let (job, _) = lab.start_film(request).await?;
        Watch::new().job(lab, &job.id, "film").await?;
        Ok((lab.film(&job.id).await?, lab.film_file(&job.id).await?))
    })?;
    if let Some(out) = out {
        std::fs::write(out, &bytes).map_err(|error| {
            FieldError::new("out", format!("cannot write {}: {error}", out.display()))
        })?;
    }
    let Film { job, weighing, spoonful, bench, set, seed, training, episode, target_mg, result } =
        film;
    let result = result.ok_or_else(|| anyhow::anyhow!("film {} has no result", job.id))?;
    let (film, out) = (job.id, out.clone());
    let document = Document {
        film,
        weighing,
        spoonful,
        bench,
        set,
        seed,
        training,
        episode,
        target_mg,
        out,
        result,
    };
    common.print(&document, || text(&document))
}

async fn newest(lab: &Lab) -> Result<String, Failure> {
    let newest = lab.newest_weighing().await?;
    let advice = "there is none yet: `flip weigh` makes one";
    Ok(newest.ok_or_else(|| FieldError::new("weighing", advice))?.id)
}

fn text(document: &Document) -> String {
    let FilmResult { size_bytes, head, heap, .. } = &document.result;
    let mut text = match (head, heap) {
        (Some(head), _) => spoonful_text(document, head),
        (None, Some(heap)) => heap_text(document, heap),
        (None, None) => String::new(),
    };
    if let Some(out) = &document.out {
        text.push_str(&format!("\nwritten to {}, {size_bytes} bytes", out.display()));
    }
    text
}

fn heap_text(document: &Document, heap: &HeapHead) -> String {
    let HeapHead { grains, on_base, tip_deg, cone_deg, height_mm, base_radius_mm, .. } = heap;
    format!(
        "heap of {}, seed {}: {on_base} of {grains} grains stayed on a base of {:.2} mm\napex {height_mm:.2} mm high: angle of repose {tip_deg:.2} deg; by the cone through {} rings {cone_deg:.2} deg",
        document.set.as_deref().unwrap_or_default(),
        document.seed.unwrap_or_default(),
        2.0 * base_radius_mm,
        heap.rings.len(),
    )
}

fn spoonful_text(document: &Document, head: &FilmHead) -> String {
    let FilmHead { steps, filled_mg, vial_mg, spilled_mg, duration_s, .. } = head;
    let row = |(k, step): (usize, &StepSeen)| {
        let is_level = k + 1 == steps.len();
        vec![
            if is_level { "level".to_owned() } else { (k + 1).to_string() },
            format!("{:.2}", step.begins_s),
            format!("{:.1}", step.pitch_deg),
            format!("{:.1}", step.shake_mm),
            step.strokes.to_string(),
            format!("{:.2}", step.fell_mg),
            format!("{:.2}", step.spoon_mg),
            format!("{:.2}", step.vial_mg),
        ]
    };
    let header =
        ["step", "s", "pitch deg", "shake mm", "strokes", "fell mg", "spoon mg", "vial mg"];
    let rows: Vec<_> = steps.iter().enumerate().map(row).collect();
    let of = match (&document.training, document.bench) {
        (Some(training), _) => format!(
            "network of episode {} of training {training}, target {:.2} mg",
            document.episode.unwrap_or_default(),
            document.target_mg.unwrap_or_default(),
        ),
        (None, bench) => format!(
            "spoonful {} of weighing {}, {}",
            document.spoonful.unwrap_or_default(),
            document.weighing.as_deref().unwrap_or_default(),
            match bench {
                Some(BenchKind::Devices) => "simulated with the same moves",
                _ => "made again",
            },
        ),
    };
    format!(
        "{}\n{of}: {vial_mg:.2} of {filled_mg:.2} mg fell into the vial and {spilled_mg:.2} mg beside it, in {duration_s:.2} s",
        table(&header, &rows),
    )
}
