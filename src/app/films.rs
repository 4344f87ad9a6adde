//! Films: what the grains of a weighing did, made again by the simulator from its record, how a
//! calibrated powder piles up, and how a training's network doses.

use super::jobs::{corrupt, specification, stored};
use super::shakes::spoonfuls_of;
use super::{App, Error, Result};
use crate::jobs::episode_film::scene as episode_scene;
use crate::jobs::film::{Dose, FilmResult, Scene, heap_scene, scene};
use crate::jobs::train::TrainingResult;
use crate::jobs::{EpisodeFilmSpec, FilmSpec, HeapFilmSpec, JobSpec, SIMULATOR};
use flip_core::domain::FieldError;
use flip_core::domain::bench::BenchKind;
use flip_core::domain::job::{JobKind, JobState};
use flip_core::domain::labels::Labels;
use flip_core::domain::shake::Spoonful;
use flip_store as store;
use flip_store::jobs::{Job, JobRow};
use flip_store::page::{LIST_LIMIT_MAX, Page, PageQuery};
use flip_store::weighings::{Weighing, WeighingRow};
use serde::{Deserialize, Serialize};

/// Seed of a heap if none is named.
const HEAP_SEED: u64 = 1;

/// A film to make: of a spoonful of a weighing, of a heap of a parameter set, or of a dose with the
/// network of a training's episode.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FilmRequest {
    /// Weighing id.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weighing: Option<String>,
    /// Which spoonful of it, from 1; default the first.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spoonful: Option<u32>,
    /// Parameter set id, in place of a weighing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub set: Option<String>,
    /// Seed of its heap. Default 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Training id, in place of a weighing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub training: Option<String>,
    /// Which episode of it, one whose network is kept.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub episode: Option<u32>,
    /// What the caller writes on it, to find it again.
    #[serde(skip_serializing_if = "Labels::is_empty")]
    pub labels: Labels,
}

/// Which films to list; of everything by default.
#[derive(Debug, Clone, Copy, Default)]
pub struct FilmsAsked<'a> {
    /// Only of this weighing, by id.
    pub weighing: Option<&'a str>,
    /// Only of heaps of this parameter set, by id.
    pub set: Option<&'a str>,
    /// Only of this training's episodes, by id.
    pub training: Option<&'a str>,
}

/// A film: its job, what it shows, and its numbers once it has succeeded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Film {
    /// The job; the film has the same id.
    pub job: Job,
    /// Weighing id; absent of a heap and of an episode.
    pub weighing: Option<String>,
    /// Which spoonful of it.
    pub spoonful: Option<u32>,
    /// The bench that shook it. On devices the film is what the simulator makes of the same moves.
    pub bench: Option<BenchKind>,
    /// Parameter set id of a heap or an episode; absent of a weighing.
    pub set: Option<String>,
    /// Seed of the heap or the episode.
    pub seed: Option<u64>,
    /// Training id of an episode.
    pub training: Option<String>,
    /// The episode whose network doses.
    pub episode: Option<u32>,
    /// Target of that dose, mg.
    pub target_mg: Option<f64>,
    /// The film; absent until it has succeeded.
    pub result: Option<FilmResult>,
}

impl App {
    /// Queues a film. `false`: the same one was requested before, and this is its job.
    ///
    /// # Errors
    /// `Invalid`: an unknown weighing, spoonful, set, training or episode, or not one of them; `Conflict`
    /// (`weighing_not_ended`, `no_shakes`, `no_network`); `Lost`: the record of its steps.
    pub async fn start_film(&self, request: FilmRequest) -> Result<(Job, bool)> {
        let labels = request.labels.clone();
        self.queue(self.film_asked(request).await?, labels).await
    }

    /// What makes the film that is asked for.
    async fn film_asked(&self, request: FilmRequest) -> Result<JobSpec> {
        let FilmRequest { weighing, spoonful, set, seed, training, episode, labels: _ } = request;
        let refused = |field, advice: &str| Err(FieldError::new(field, advice).into());
        if spoonful.is_some() && weighing.is_none() {
            return refused(
                "spoonful",
                "must be left out without `weighing`: nothing else has spoonfuls",
            );
        }
        if seed.is_some() && set.is_none() {
            return refused(
                "seed",
                "must be left out without `set`: weighings and trainings have their own",
            );
        }
        if episode.is_some() && training.is_none() {
            return refused(
                "episode",
                "must be left out without `training`: nothing else has episodes",
            );
        }
        match (weighing, set, training) {
            (Some(_), Some(_), _) => {
                refused("set", "must be left out with `weighing`: a film is of one of them")
            }
            (Some(_), None, Some(_)) => {
                refused("training", "must be left out with `weighing`: a film is of one of them")
            }
            (None, Some(_), Some(_)) => {
                refused("training", "must be left out with `set`: a film is of one of them")
            }
            (None, None, None) => refused(
                "weighing",
                "must be given, or `set` for the film of a heap, or `training` for that of an episode",
            ),
            (Some(id), None, None) => self.film_dose(id, spoonful).await,
            (None, Some(set), None) => self.film_heap(&set, seed.unwrap_or(HEAP_SEED)).await,
            (None, None, Some(id)) => self.film_episode(id, episode).await,
        }
    }

    /// The film of a dose with the network of a training's episode.
    async fn film_episode(&self, id: String, episode: Option<u32>) -> Result<JobSpec> {
        let row = self.store().job(&id).await?.filter(|row| row.job.kind == JobKind::Training);
        let row = row.ok_or_else(|| unknown("training", "training", "GET /v1/trainings", &id))?;
        let JobSpec::Training(of) = specification(&row)? else {
            return Err(corrupt("a training's specification"));
        };
        let result: Option<TrainingResult> = row.result.as_deref().map(stored).transpose()?;
        let mut kept = self.store().kept_episodes(&[&id]).await?;
        let is_old = row.job.finished_at.is_some() && kept.is_empty() && of.settings.episodes > 1;
        kept.extend(result.map(|result| (id.clone(), result.episodes, result.policy)));
        if kept.is_empty() {
            let advice = if is_old {
                format!(
                    "training {id} has kept no network: films need one that was trained since FLIP keeps them"
                )
            } else {
                format!("training {id} has not played an episode yet: ask for a film when it has")
            };
            return Err(Error::conflict("no_network", advice));
        }
        let all = kept.iter().map(|(_, episode, _)| episode.to_string()).collect::<Vec<_>>();
        let all = all.join(", ");
        let Some(number) = episode else {
            let advice = format!("must be given with `training`; kept are the networks of {all}");
            return Err(FieldError::new("episode", advice).into());
        };
        let found = kept.into_iter().find(|(_, episode, _)| *episode == number);
        let (_, episode, policy) = found.ok_or_else(|| {
            let why = if is_old { ": this training ended before FLIP kept others" } else { "" };
            let advice = format!("must be one whose network is kept, {all}, got {number}{why}");
            FieldError::new("episode", advice)
        })?;
        let (set, scene) = episode_scene(&of.levels, &of.settings)?;
        let (set, simulator) = (set.id(), SIMULATOR.to_owned());
        let spec = EpisodeFilmSpec { training: id, episode, policy, set, scene, simulator };
        Ok(JobSpec::EpisodeFilm(spec))
    }

    /// The film of a heap.
    async fn film_heap(&self, id: &str, seed: u64) -> Result<JobSpec> {
        let set = self
            .store()
            .parameter_set(id)
            .await?
            .ok_or_else(|| unknown("set", "parameter set", "GET /v1/parameter-sets", id))?;
        let scene = heap_scene(&set.parameters, seed);
        let spec = HeapFilmSpec { set: set.id, scene, simulator: SIMULATOR.to_owned() };
        Ok(JobSpec::HeapFilm(spec))
    }

    /// The film of a spoonful.
    async fn film_dose(&self, id: String, spoonful: Option<u32>) -> Result<JobSpec> {
        let WeighingRow { weighing, trace, .. } = self
            .store()
            .weighing(&id)
            .await?
            .ok_or_else(|| unknown("weighing", "weighing", "GET /v1/weighings", &id))?;
        if weighing.outcome.is_none() {
            let advice = format!("weighing {id} has not ended: ask for a film of it when it has");
            return Err(Error::conflict("weighing_not_ended", advice));
        }
        let ticks = match trace {
            Some(trace) => self.stored_ticks(&trace).await?,
            None => Vec::new(),
        };
        let mut spoonfuls = spoonfuls_of(&weighing, &ticks);
        if spoonfuls.is_empty() {
            let advice = format!("no step of weighing {id} is on record: there is nothing to film");
            return Err(Error::conflict("no_shakes", advice));
        }
        let (number, most) = (spoonful.unwrap_or(1), spoonfuls.len());
        let place =
            (number as usize).checked_sub(1).filter(|place| *place < most).ok_or_else(|| {
                FieldError::new("spoonful", format!("must be from 1 to {most}, got {number}"))
            })?;
        let kept = spoonfuls.swap_remove(place);
        let bench = kept.bench.unwrap_or(BenchKind::Simulated);
        let scene = self.scene(&weighing, bench, &kept.spoonful).await?;
        let simulator = SIMULATOR.to_owned();
        let spec = FilmSpec { weighing: id, spoonful: number, bench, scene, simulator };
        Ok(JobSpec::Film(spec))
    }

    /// What makes a spoonful again.
    async fn scene(
        &self,
        weighing: &Weighing,
        bench: BenchKind,
        spoonful: &Spoonful,
    ) -> Result<Scene> {
        let set = self.store().parameter_set(&weighing.parameter_set).await?;
        let set = set.ok_or_else(|| {
            store::Error::Corrupt("the weighing's parameter set is gone".to_owned())
        })?;
        let spoon = self.jobs_or_refuse()?.bench().spoon();
        let of = Dose {
            set: &set.parameters,
            patch: &weighing.patch,
            seed: weighing.seed,
            bench,
            spoon: &spoon,
        };
        Ok(scene(&of, spoonful)?)
    }

    /// One film.
    ///
    /// # Errors
    /// `NotFound`
    pub async fn film(&self, id: &str) -> Result<Film> {
        let row = self.store().job(id).await?.filter(|row| row.job.kind == JobKind::Film);
        film(row.ok_or_else(|| Error::not_found("film", id))?)
    }

    /// Films, newest first; of one weighing, set or training if given.
    pub async fn films(&self, of: FilmsAsked<'_>, page: PageQuery) -> Result<Page<Film>> {
        let window = page.window(LIST_LIMIT_MAX)?;
        let rows = self.store().films(of.weighing, of.set, of.training, window).await?;
        let items: Result<Vec<Film>> = rows.items.into_iter().map(film).collect();
        Ok(Page { items: items?, next: rows.next })
    }

    /// The file of a film, with its SHA-256; `docs/reference/film.md` describes its layout.
    ///
    /// # Errors
    /// `NotFound`; `Conflict` (`film_missing`) until it has succeeded; `Lost`.
    pub async fn film_file(&self, id: &str) -> Result<(String, Vec<u8>)> {
        let film = self.film(id).await?;
        let Some(result) = film.result else {
            let advice = match film.job.state {
                JobState::Failed | JobState::Cancelled => "was not made: ask for it again",
                _ => "is being made: its job says how far it is",
            };
            return Err(Error::conflict("film_missing", format!("film {id} {advice}")));
        };
        let bytes = self.store().artifacts().get(&result.sha256).await;
        let bytes = bytes.map_err(|error| Error::of_part("the file of this film", error))?;
        Ok((result.sha256, bytes))
    }
}

/// Nothing of this kind has this id.
fn unknown(field: &str, kind: &str, list: &str, id: &str) -> FieldError {
    let id: String = id.chars().filter(|c| !c.is_control()).take(40).collect();
    FieldError::new(field, format!("there is no {kind} `{id}`: {list} lists them"))
}

fn film(row: JobRow) -> Result<Film> {
    let result = row.result.as_deref().map(stored).transpose()?;
    let spec = specification(&row)?;
    let empty = Film {
        job: row.job,
        weighing: None,
        spoonful: None,
        bench: None,
        set: None,
        seed: None,
        training: None,
        episode: None,
        target_mg: None,
        result,
    };
    match spec {
        JobSpec::Film(FilmSpec { weighing, spoonful, bench, .. }) => Ok(Film {
            weighing: Some(weighing),
            spoonful: Some(spoonful),
            bench: Some(bench),
            ..empty
        }),
        JobSpec::HeapFilm(HeapFilmSpec { set, scene, .. }) => {
            Ok(Film { set: Some(set), seed: Some(scene.seed), ..empty })
        }
        JobSpec::EpisodeFilm(EpisodeFilmSpec { training, episode, set, scene, .. }) => Ok(Film {
            training: Some(training),
            episode: Some(episode),
            target_mg: Some(scene.target_mg),
            set: Some(set),
            seed: Some(scene.seed),
            ..empty
        }),
        _ => Err(corrupt("a film's specification")),
    }
}
