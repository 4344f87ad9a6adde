//! Films: of a spoonful, of a heap, and of a training's episode.

use crate::jobs::episode_film::EpisodeScene;
use flip_core::domain::bench::BenchKind;
use flip_sim::film::Scene;
use flip_sim::heap_film::Scene as HeapScene;
use serde::{Deserialize, Serialize};

/// A film to make.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FilmSpec {
    /// Weighing id.
    pub weighing: String,
    /// Which spoonful of it, from 1.
    pub spoonful: u32,
    /// The bench that shook it.
    pub bench: BenchKind,
    /// What is made again.
    pub scene: Scene,
    /// Version of the simulator: [`SIMULATOR`](super::SIMULATOR).
    pub simulator: String,
}

/// A film of a heap to make.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HeapFilmSpec {
    /// Parameter set id.
    pub set: String,
    /// What is poured again.
    pub scene: HeapScene,
    /// Version of the simulator: [`SIMULATOR`](super::SIMULATOR).
    pub simulator: String,
}

/// A film to make of a dose with the network of a training's episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeFilmSpec {
    /// Training id.
    pub training: String,
    /// Number of the episode, from 1.
    pub episode: u32,
    /// The network that was kept, by its policy id.
    pub policy: String,
    /// Id of the parameter set, before its conditions.
    pub set: String,
    /// What is dosed with it.
    pub scene: EpisodeScene,
    /// Version of the simulator: [`SIMULATOR`](super::SIMULATOR).
    pub simulator: String,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::spec::{JobSpec, SIMULATOR};
    use flip_core::domain::job::JobKind;
    use flip_core::domain::parameters::ParameterSet;

    #[test]
    fn a_film_is_of_version_3_and_reads_as_it_was_written() {
        let replay = flip_sim::replay::Replay {
            set: ParameterSet::default(),
            settings: flip_sim::dispense::Settings::default(),
            steps: vec![flip_sim::replay::Step {
                pitch_deg: 0.1 + 0.2,
                shake_mm: 4.0,
                strokes: 1,
                acceleration_m_s2: Some(4.6),
            }],
            seed: u64::MAX,
        };
        let spec = JobSpec::Film(FilmSpec {
            weighing: "w".to_owned(),
            spoonful: 1,
            bench: BenchKind::Simulated,
            scene: Scene { replay, moves: flip_sim::film::Moves::AtOnce },
            simulator: SIMULATOR.to_owned(),
        });
        let (text, _) = spec.canonical();
        assert!(text.starts_with("{\"version\":3,\"film\":{"), "{text}");
        assert_eq!(JobSpec::read(&text).unwrap(), spec);
    }

    #[test]
    fn a_film_of_a_heap_is_of_version_4_and_reads_as_it_was_written() {
        let scene = HeapScene {
            set: ParameterSet::default(),
            settings: flip_sim::repose::Settings::with_particles(700),
            seed: u64::MAX,
        };
        let (set, simulator) = ("ps-1".to_owned(), SIMULATOR.to_owned());
        let spec = JobSpec::HeapFilm(HeapFilmSpec { set, scene, simulator });
        let (text, _) = spec.canonical();
        assert!(text.starts_with("{\"version\":4,\"heap_film\":{"), "{text}");
        assert_eq!((JobSpec::read(&text).unwrap(), spec.kind()), (spec, JobKind::Film));
    }

    #[test]
    fn a_film_of_an_episode_is_of_version_5_and_reads_as_it_was_written() {
        let scene = EpisodeScene {
            set: ParameterSet::default(),
            settings: flip_sim::dispense::Settings::default(),
            balance: flip_sim::balance::Settings::default(),
            rules: flip_policy::Rules::FLIP,
            target_mg: 10.0,
            repose_deg: Some(0.1 + 0.2),
            seed: u64::MAX,
        };
        let [training, policy, set] = ["t", "p-1", "ps-1"].map(str::to_owned);
        let simulator = SIMULATOR.to_owned();
        let spec = EpisodeFilmSpec { training, episode: 100, policy, set, scene, simulator };
        let spec = JobSpec::EpisodeFilm(spec);
        let (text, _) = spec.canonical();
        assert!(text.starts_with("{\"version\":5,\"episode_film\":{"), "{text}");
        assert_eq!((JobSpec::read(&text).unwrap(), spec.kind()), (spec, JobKind::Film));
    }
}
