//! Defects planted in a copy of the solver's settings: heaps that are wrong because of how they are
//! computed, whatever the powder.
//!
//! The job is the one the command runs, over a file in which nothing is hidden; only the function
//! that simulates a heap is replaced. It pours real heaps, with a quarter of the grains and read
//! once so that a case takes seconds, with the requested settings and one thing wrong:
//!
//! | planted | what is wrong | what has to be said |
//! |---|---|---|
//! | nothing | | nothing: no creep, no dependence |
//! | the published engine's friction | it remembers nothing from one frame to the next: heaps never rest (`sim/physx/mod.rs`) | heaps creep |
//! | a substep of 0.64 ms, eight times the usual | a grain that falls from the opening moves a good part of a diameter in one | angles depend on the substep, or on the grains |

use crate::judge::kept;
use crate::rates::line;
use flip::app::{App, Functions, InvestigationRequest, JobState, Options, Topic, report_html};
use flip::jobs::heaps_on_cores;
use flip_sim::repose::{Compat, Settings, repose};
use futures::StreamExt;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use std::fmt::Write;
use std::path::Path;

/// The planted defect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Defect {
    Nothing,
    Engine,
    LongSubstep,
}

impl Defect {
    pub const ALL: [Self; 3] = [Self::Nothing, Self::Engine, Self::LongSubstep];

    /// The requested settings, for a smaller heap, with the defect.
    fn planted(self, asked: &Settings) -> Settings {
        let of = Settings::with_particles(asked.particles / SMALLER);
        let small = Settings {
            particles: of.particles,
            base_radius_diameters: of.base_radius_diameters,
            readings: 1,
            ..*asked
        };
        match self {
            Self::Nothing => small,
            Self::Engine => Settings { compat: Compat::Physx, ..small },
            Self::LongSubstep => Settings { substep_s: LONGER * small.substep_s, ..small },
        }
    }
}

/// Inverse of the share of grains poured.
const SMALLER: u32 = 4;
/// Factor on the substep.
const LONGER: f64 = 8.0;
/// Heaps the job may pour, the command's default: three of each kind, 24 together.
const BUDGET_RUNS: u32 = 60;

/// The findings about a solver.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Criticised {
    pub planted: Defect,
    pub seed: u64,
    /// The settings that angles were reported to depend on.
    pub depends_on: Vec<String>,
    /// Degrees per decade of settling time, and the 99 % interval.
    pub creep_deg: f64,
    pub creep_ci99: [f64; 2],
    /// Whether the document lists creep as its first cause and the page shows it.
    pub creep_is_told: bool,
    pub heaps: u64,
}

impl Criticised {
    /// Whether creep was found, and reported under its name.
    pub fn is_creep_named(&self) -> bool {
        self.creep_is_told && self.depends_on.iter().any(|it| it == "settling_time")
    }

    fn depends_on(&self, what: &str) -> bool {
        self.depends_on.iter().any(|it| it == what)
    }
}

/// Every defect with every seed.
pub fn wanted(defects: &[Defect], seeds: std::ops::Range<u64>) -> Vec<(Defect, u64)> {
    seeds.flat_map(|seed| defects.iter().map(move |&defect| (defect, seed))).collect()
}

/// Results known from the file in the folder, and the others as they are computed.
pub fn criticised(folder: &Path, wanted: &[(Defect, u64)]) -> Vec<Criticised> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    let one = |&(defect, seed): &(Defect, u64)| runtime.block_on(criticise(defect, seed));
    kept(&folder.join("solvers.jsonl"), wanted, |it: &Criticised| (it.planted, it.seed), one)
}

async fn criticise(planted: Defect, seed: u64) -> Criticised {
    let folder = tempfile::tempdir().unwrap();
    let functions = Functions {
        simulate: heaps_on_cores(move |set, asked, seed| {
            repose(set, &planted.planted(asked), seed)
        }),
        ..Functions::default()
    };
    let app = App::open(folder.path(), Options { functions, ..Options::default() }).await.unwrap();
    let request = InvestigationRequest {
        measurements_csv: Some(nothing_hidden(seed)),
        simulations: Some(99),
        budget_runs: Some(BUDGET_RUNS),
        seed: Some(seed),
        ..InvestigationRequest::default()
    };
    let (job, _) = app.start_investigation(request).await.unwrap();
    let mut events = app.events(Topic::Job(job.id.clone()), 0).await.unwrap();
    while events.next().await.is_some() {}
    let investigation = app.investigation(&job.id).await.unwrap();
    assert_eq!(investigation.job.state, JobState::Succeeded, "{:?}", investigation.job.error);
    app.shutdown().await.unwrap();
    let report = investigation.report.unwrap();
    let page = report_html::html(&report);
    let document = serde_json::to_value(&report).unwrap();
    let dependences = document["numerics"]["dependences"].as_array().expect("heaps were poured");
    let text = |of: &serde_json::Value| of["varied"].as_str().unwrap().to_owned();
    let defects =
        dependences.iter().filter(|it| it["is_defect"].as_bool().unwrap()).map(text).collect();
    let settling = dependences.iter().find(|it| it["varied"] == "settling_time");
    Criticised {
        planted,
        seed,
        depends_on: defects,
        creep_deg: settling.map_or(f64::NAN, |it| it["slope_deg"].as_f64().unwrap()),
        creep_ci99: [0, 1]
            .map(|end| settling.map_or(f64::NAN, |it| it["ci99"][end].as_f64().unwrap())),
        creep_is_told: page.contains("heaps creep")
            && document["causes"][0]["mechanism"] == "creep"
            && document["verdict"] == "cause",
        heaps: dependences.iter().map(|it| it["runs"].as_u64().unwrap()).sum(),
    }
}

/// A campaign of one powder on eight days, with a different angle for each seed, which decides
/// whose heaps are poured.
fn nothing_hidden(seed: u64) -> String {
    let mut rng = Pcg64::seed_from_u64(seed ^ 0x736f_6c76);
    let mean_deg = rng.random_range(29.0..42.0);
    let mut text = String::from("powder,repose_deg,session,relative_humidity_pct\n");
    for day in 0..8 {
        let humidity = rng.random_range(30.0..70.0);
        for _ in 0..3 {
            let noise: f64 = (0..12).map(|_| rng.random_range(-0.5..0.5)).sum();
            writeln!(text, "powder,{:.2},{day},{humidity:.1}", mean_deg + 1.5 * noise).unwrap();
        }
    }
    text
}

/// The solvers' rows of the table.
pub fn table(all: &[Criticised]) -> String {
    let mut text = String::new();
    let mut rate = |name: &str, planted: Defect, is: &dyn Fn(&Criticised) -> bool, target: &str| {
        let of: Vec<_> = all.iter().filter(|it| it.planted == planted).collect();
        if !of.is_empty() {
            text += &line(name, of.iter().filter(|it| is(it)).count(), of.len(), target);
        }
    };
    let any = |it: &Criticised| !it.depends_on.is_empty();
    rate(
        "defect planted in the solver: named creep",
        Defect::Engine,
        &Criticised::is_creep_named,
        ">= 90 %",
    );
    rate("sound solver: said to creep", Defect::Nothing, &Criticised::is_creep_named, "<= 5 %");
    rate("sound solver: said to have any defect", Defect::Nothing, &any, "<= 5 %");
    rate("substep eight times too long: any defect found", Defect::LongSubstep, &any, ">= 90 %");
    rate("   named by the substep", Defect::LongSubstep, &|it| it.depends_on("substep"), "");
    rate("   said to creep", Defect::LongSubstep, &Criticised::is_creep_named, "");
    text
}
