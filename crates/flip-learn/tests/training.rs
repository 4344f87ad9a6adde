//! Training from the outside: it learns, it is reproducible, it survives interruption.

use flip_core::domain::bench::PitchLimits;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_learn::train::environment::{Filling, play};
use flip_learn::train::formula::Formula;
use flip_learn::train::{
    EpisodeRecord, Event, FineTuning, Level, Network, Order, Preset, Replayed, Settings, Start,
    TrainError, Trained, train_on,
};
use flip_policy::{Actor, Controller, Episode, Observation, decode};
use flip_sim::balance;
use safetensors::tensor::{SafeTensors, TensorView};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicU32, Ordering};

const FORMULA: Formula = Formula { pitch: PitchLimits::WIDE };

/// Three formula powders, given out of order; they differ in friction.
fn levels() -> Vec<Level> {
    let level = |powder: &str, repose_deg, frictions: [f64; 2]| Level {
        powder: powder.into(),
        repose_deg,
        sets: frictions.map(|f| ParameterSet::default().with("friction", f).unwrap()).to_vec(),
    };
    vec![
        level("salt", 36.0, [0.65, 0.7]),
        level("sand", 28.6, [0.3, 0.35]),
        level("sugar", 31.4, [0.45, 0.5]),
    ]
}

/// Small and quick: the tested properties do not depend on the size.
fn small(order: Order) -> Settings {
    Settings {
        episodes: 26,
        warmup_episodes: 4,
        rounds_per_checkpoint: 2,
        hidden: 16,
        batch: 16,
        updates_per_step: 0.7,
        box_share: 0.0,
        ..Settings::of(Preset::Flip, order, 3)
    }
}

/// The same with the recurrent network.
fn small_recurrent(replayed: Replayed) -> Settings {
    let relabel_share = if replayed == Replayed::Episodes { 0.5 } else { 0.0 };
    Settings {
        network: Network::Recurrent { replayed },
        batch: 4,
        relabel_share,
        ..small(Order::Curriculum)
    }
}

/// Every kind of training that must be reproducible.
fn kinds() -> [Settings; 6] {
    let recurrent = [Replayed::StoredState, Replayed::Episodes].map(small_recurrent);
    let [stored, episodes] = recurrent;
    let surrogate = Settings { surrogate_episodes: 10, ..small(Order::Reverse) };
    let box_too = Settings { box_share: 0.5, ..surrogate.clone() };
    [
        small(Order::Curriculum),
        small(Order::DomainRandomisation),
        stored,
        episodes,
        surrogate,
        box_too,
    ]
}

/// Never stops.
const GO_ON: fn() -> ControlFlow<()> = || ControlFlow::Continue(());

fn run(settings: &Settings, resume: Option<&[u8]>) -> (Trained, Vec<EpisodeRecord>, Vec<Vec<u8>>) {
    begin(settings, resume.map_or(Start::Nothing, Start::Checkpoint))
}

fn begin(settings: &Settings, start: Start<'_>) -> (Trained, Vec<EpisodeRecord>, Vec<Vec<u8>>) {
    let (mut episodes, mut checkpoints) = (Vec::new(), Vec::new());
    let trained = train_on(&FORMULA, &levels(), settings, start, &GO_ON, |event| {
        match event {
            Event::Episode(record) => episodes.push(*record),
            Event::Checkpoint(bytes) => checkpoints.push(bytes),
            Event::Kept { .. } => {}
        }
        ControlFlow::Continue(())
    });
    (trained.unwrap(), episodes, checkpoints)
}

fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

/// Mean absolute error of a controller on spoons it never practised on, mg.
fn mean_error_mg(controller: &Controller, settings: &Settings) -> f64 {
    let mut errors = Vec::new();
    for (k, level) in levels().iter().enumerate() {
        for dose in 0..40u64 {
            let set = &level.sets[dose as usize % 2];
            let seed = derive(987_654_321, &[k as u64, dose]);
            let target_mg = 5.0 + (dose % 11) as f64;
            let mut dosing = controller.begin(&settings.rules, 1.0);
            let mut spoon = FORMULA.fill(set, seed);
            let played = play(
                &mut spoon,
                &settings.rules,
                &balance::Settings::default(),
                target_mg,
                seed,
                |seen: &Observation| {
                    let action = dosing.propose(seen);
                    [(action.incline_change_deg / 8.0) as f32, (action.shake_mm / 8.0 - 1.0) as f32]
                },
            );
            errors.push((played.dispensed_mg - target_mg).abs());
        }
    }
    errors.iter().sum::<f64>() / errors.len() as f64
}

#[test]
fn a_trained_policy_errs_less_than_half_as_much_as_an_untrained_one() {
    let ours = Settings::of(Preset::Flip, Order::Curriculum, 1);
    let settings = Settings { episodes: 120, learning_rate: 1e-3, updates_per_step: 4.0, ..ours };
    let (trained, ..) = run(&settings, None);
    let policy = decode(&trained.artifact).unwrap();
    let ours = mean_error_mg(&policy.controller, &settings);
    let untrained =
        (0..5).map(|seed| mean_error_mg(&Controller::untrained(seed), &settings)).sum::<f64>()
            / 5.0;
    println!("trained {ours:.2} mg, untrained {untrained:.2} mg");
    assert!(ours < untrained / 2.0, "trained {ours}, untrained {untrained}");
    assert!(ours < 3.0, "{ours}");
}

/// The network inside a policy's bytes.
fn network(artifact: &[u8]) -> Actor {
    match decode(artifact).unwrap().controller {
        Controller::Learned(actor) => actor,
        other => panic!("not learnt: {other:?}"),
    }
}

#[test]
fn a_training_goes_on_from_a_policy_and_holds_it_while_its_critics_form() {
    let begun = network(&run(&small(Order::Curriculum), None).0.artifact);
    let with = |held_updates: u32| {
        let settings = small(Order::Random).going_on_from("p-0123".into());
        let from = settings.from.clone().map(|from| FineTuning { held_updates, ..from });
        Settings { from, episodes: 26, surrogate_episodes: 10, ..settings }
    };
    let (held, ..) = begin(&with(1_000_000), Start::Policy(&begun));
    assert_eq!(network(&held.artifact), begun);
    let settings = with(5);
    let (unbroken, _, checkpoints) = begin(&settings, Start::Policy(&begun));
    assert_ne!(network(&unbroken.artifact), begun);
    assert!(unbroken.manifest.settings["from"]["policy"] == "p-0123");
    for checkpoint in checkpoints {
        assert_eq!(run(&settings, Some(&checkpoint)).0, unbroken);
    }
    // Stopped before its first episode, it still has the policy.
    let stopped = train_on(
        &FORMULA,
        &levels(),
        &settings,
        Start::Policy(&begun),
        &|| ControlFlow::Break(()),
        |_| panic!("there is nothing to tell"),
    );
    let Err(TrainError::Stopped { checkpoint }) = stopped else { panic!("{stopped:?}") };
    assert_eq!(run(&settings, Some(&checkpoint)).0, unbroken);
    let other = Settings { hidden: 8, ..settings };
    let refused = train_on(&FORMULA, &levels(), &other, Start::Policy(&begun), &GO_ON, |_| {
        ControlFlow::Continue(())
    });
    let Err(TrainError::Invalid(error)) = refused else { panic!("{refused:?}") };
    assert_eq!(error.field, "from");
}

#[test]
fn the_first_episodes_are_played_on_the_surrogate_and_the_others_are_not() {
    let of =
        |surrogate_episodes| run(&Settings { surrogate_episodes, ..small(Order::Random) }, None).1;
    let (none, some, all) = (of(0), of(10), of(26));
    // Rounds of four, except the third: no round has both.
    assert_eq!(some[..8], all[..8]);
    let dispensed =
        |episodes: &[EpisodeRecord]| episodes.iter().map(|e| e.dispensed_mg).collect::<Vec<_>>();
    assert_eq!(dispensed(&some[8..10]), dispensed(&all[8..10]));
    assert_ne!(dispensed(&some[..4]), dispensed(&none[..4]));
    assert_ne!(dispensed(&some[10..12]), dispensed(&all[10..12]));
    assert!(
        some.iter().zip(&none).all(|(a, b)| a.target_mg == b.target_mg),
        "the same doses are asked for"
    );
}

#[test]
fn an_interrupted_training_ends_with_the_same_bytes_as_an_unbroken_one() {
    for settings in kinds() {
        let (unbroken, episodes, checkpoints) = run(&settings, None);
        // Every other round; on the surrogate, where rounds take almost no time, every hundredth.
        assert_eq!(checkpoints.len(), if settings.surrogate_episodes > 0 { 2 } else { 3 });
        for checkpoint in &checkpoints {
            let (resumed, again, _) = run(&settings, Some(checkpoint));
            assert_eq!(resumed, unbroken);
            assert_eq!(
                again,
                episodes[episodes.len() - again.len()..],
                "the same episodes come again"
            );
        }
    }
}

#[test]
fn a_stop_finishes_its_round_and_hands_over_a_checkpoint() {
    let settings = small(Order::Random);
    let (unbroken, episodes, _) = run(&settings, None);
    let mut seen = Vec::new();
    let stopped =
        train_on(&FORMULA, &levels(), &settings, Start::Nothing, &GO_ON, |event| match event {
            Event::Episode(record) => {
                seen.push(*record);
                if seen.len() == 5 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            }
            Event::Checkpoint(_) | Event::Kept { .. } => ControlFlow::Continue(()),
        });
    let Err(TrainError::Stopped { checkpoint }) = stopped else { panic!("{stopped:?}") };
    assert_eq!(seen, episodes[..8], "a round of four is reported whole");
    let (resumed, rest, _) = run(&settings, Some(&checkpoint));
    assert_eq!((resumed, rest), (unbroken, episodes[8..].to_vec()));
}

#[test]
fn a_stop_within_a_round_drops_the_round_and_loses_nothing() {
    let settings = small(Order::Random);
    let (unbroken, episodes, _) = run(&settings, None);
    // Rounds of four, polled before each episode: the tenth poll falls into the third round.
    let asked = AtomicU32::new(0);
    let flow = || match asked.fetch_add(1, Ordering::SeqCst) {
        0..9 => ControlFlow::Continue(()),
        _ => ControlFlow::Break(()),
    };
    let mut seen = Vec::new();
    let stopped = train_on(&FORMULA, &levels(), &settings, Start::Nothing, &flow, |event| {
        if let Event::Episode(record) = event {
            seen.push(*record);
        }
        ControlFlow::Continue(())
    });
    let Err(TrainError::Stopped { checkpoint }) = stopped else { panic!("{stopped:?}") };
    assert_eq!(seen, episodes[..8]);
    let (resumed, rest, _) = run(&settings, Some(&checkpoint));
    assert_eq!((resumed, rest), (unbroken, episodes[8..].to_vec()));
}

/// The networks that a training keeps, by the number of their episode.
fn kept(settings: &Settings, start: Start<'_>) -> Vec<(u32, Vec<u8>)> {
    let mut kept = Vec::new();
    let trained = train_on(&FORMULA, &levels(), settings, start, &GO_ON, |event| {
        if let Event::Kept { episode, policy } = event {
            kept.push((episode, policy));
        }
        ControlFlow::Continue(())
    });
    assert!(trained.is_ok(), "{trained:?}");
    kept
}

#[test]
fn the_networks_of_the_first_and_tenth_episode_are_kept_and_those_of_later_ones_when_resumed() {
    for settings in kinds() {
        let networks = kept(&settings, Start::Nothing);
        assert_eq!(kept(&settings, Start::Nothing), networks, "the same bytes");
        let episodes: Vec<u32> = networks.iter().map(|(episode, _)| *episode).collect();
        assert_eq!(episodes, [1, 10], "100 and 1000 are beyond its 26 episodes");
        let policies: Vec<_> = networks.iter().map(|(_, bytes)| decode(bytes).unwrap()).collect();
        assert!(matches!(policies[0].controller, Controller::Learned(_)));
        // A round of four begins with the ninth episode: the tenth is played with what it knows.
        assert_eq!(policies[0].manifest.episodes, 0);
        assert_eq!(policies[1].manifest.episodes, 8);
        assert_ne!(policies[0].controller, policies[1].controller);
        let (_, _, checkpoints) = run(&settings, None);
        // After 8 episodes on the simulator, or when the surrogate's are over.
        let resumed = kept(&settings, Start::Checkpoint(&checkpoints[0]));
        assert!(networks.ends_with(&resumed) && resumed.len() < 2, "{}", resumed.len());
    }
    // The last is the policy.
    let short = Settings { episodes: 10, ..small(Order::Curriculum) };
    let episodes: Vec<u32> = kept(&short, Start::Nothing).iter().map(|(n, _)| *n).collect();
    assert_eq!(episodes, [1]);
}

#[test]
fn the_number_of_threads_changes_nothing() {
    for settings in kinds() {
        let one = with_threads(1, || run(&settings, None));
        let two = with_threads(2, || run(&settings, None));
        assert!(one == two, "{:?} {:?}", settings.order, settings.network);
    }
}

#[test]
fn a_checkpoint_without_its_stored_states_ends_elsewhere() {
    let settings = small_recurrent(Replayed::StoredState);
    let (unbroken, _, checkpoints) = run(&settings, None);
    let states = |bytes: &[u8]| {
        SafeTensors::deserialize(bytes).unwrap().tensor("replay.states").unwrap().data().to_vec()
    };
    // 8 episodes so far, each with hidden and cell of 16 units.
    assert_eq!(states(&checkpoints[0]).len(), 8 * 2 * 16 * 4);
    let (_, header) = SafeTensors::read_metadata(&checkpoints[0]).unwrap();
    let tensors = SafeTensors::deserialize(&checkpoints[0]).unwrap();
    let zeros = vec![0; states(&checkpoints[0]).len()];
    let lost = tensors.iter().map(|(name, tensor)| {
        let data = if name == "replay.states" { &zeros } else { tensor.data() };
        (name, TensorView::new(tensor.dtype(), tensor.shape().to_vec(), data).unwrap())
    });
    let lost = safetensors::serialize(lost, header.metadata().clone()).unwrap();
    assert_ne!(run(&settings, Some(&lost)).0.artifact, unbroken.artifact);
}

#[test]
fn a_recurrent_policy_learns_and_weighs_by_what_it_remembers() {
    let settings = Settings {
        network: Network::Recurrent { replayed: Replayed::Episodes },
        hidden: 32,
        batch: 16,
        updates_per_step: 1.0,
        episodes: 120,
        box_share: 0.0,
        ..Settings::of(Preset::Flip, Order::Curriculum, 1)
    };
    let (trained, ..) = run(&settings, None);
    let policy = decode(&trained.artifact).unwrap();
    assert_eq!(policy.manifest.kind.name(), "recurrent");
    let ours = mean_error_mg(&policy.controller, &settings);
    let untrained =
        (0..5).map(|seed| mean_error_mg(&Controller::untrained(seed), &settings)).sum::<f64>()
            / 5.0;
    println!("recurrent {ours:.2} mg, untrained {untrained:.2} mg");
    assert!(ours < untrained / 2.0, "recurrent {ours}, untrained {untrained}");
    // The same observation seen a second time within a weighing does not get the same action.
    let seen = Observation { reading_mg: 3.0, target_mg: 10.0, pitch_deg: 12.0 };
    let twice = || {
        let mut dosing = policy.controller.begin(&settings.rules, 1.0);
        [dosing.propose(&seen), dosing.propose(&seen)]
    };
    assert_ne!(twice()[0], twice()[1]);
    assert_eq!(twice(), twice(), "a weighing begins without memories of the one before");
}

#[test]
fn a_checkpoint_of_another_training_or_damaged_is_refused() {
    let settings = small(Order::Curriculum);
    let (.., checkpoints) = run(&settings, None);
    let refusal = |settings: &Settings, bytes: &[u8]| match train_on(
        &FORMULA,
        &levels(),
        settings,
        Start::Checkpoint(bytes),
        &GO_ON,
        |_| ControlFlow::Continue(()),
    ) {
        Err(TrainError::Checkpoint(text)) => text,
        other => panic!("{other:?}"),
    };
    assert!(
        refusal(&Settings { seed: 4, ..settings.clone() }, &checkpoints[0])
            .contains("another training")
    );
    assert!(!refusal(&settings, &checkpoints[0][..checkpoints[0].len() / 2]).is_empty());
    assert!(!refusal(&settings, b"").is_empty());
    let policy = run(&settings, None).0.artifact;
    assert!(refusal(&settings, &policy).contains("no training"));
}

#[test]
fn levels_are_met_in_the_order_asked_for() {
    let met = |order| {
        let (trained, episodes, _) = run(&small(order), None);
        let mut powders: Vec<String> = episodes.iter().map(|e| e.powder.clone()).collect();
        powders.dedup();
        (trained, powders)
    };
    let (trained, powders) = met(Order::Curriculum);
    assert_eq!(powders, ["sand", "sugar", "salt"]);
    // 26 episodes over three levels are 9 each; a round of four in progress when the level changes
    // is finished first.
    assert_eq!(trained.levels.iter().map(|l| l.episodes).sum::<u32>(), 26);
    assert_eq!(trained.manifest.switches.len(), 2);
    assert_eq!(met(Order::Reverse).1, ["salt", "sugar", "sand"]);
    assert!(met(Order::Random).1.len() > 6, "a random order keeps changing");
    let (trained, powders) = met(Order::DomainRandomisation);
    assert_eq!((powders, trained.levels.len()), (vec!["randomised".to_owned()], 0));
}

#[test]
fn a_share_of_the_episodes_is_of_powders_from_the_whole_box_and_counts_for_no_level() {
    let (trained, episodes, _) =
        run(&Settings { box_share: 0.5, episodes: 70, ..small(Order::Curriculum) }, None);
    let found = episodes.iter().filter(|e| e.powder == "randomised").count() as u32;
    assert!((20..=50).contains(&found), "{found} of 70");
    assert_eq!(trained.levels.iter().map(|level| level.episodes).sum::<u32>(), 70 - found);
    let known: Vec<String> =
        levels().iter().flat_map(|level| level.sets.iter().map(ParameterSet::id)).collect();
    assert!(
        episodes.iter().all(|e| (e.powder == "randomised") != known.contains(&e.parameter_set))
    );
    assert_eq!(
        trained.manifest.switches.last().map(|switch| switch.to),
        Some(2),
        "the last level is reached"
    );
}

#[test]
fn the_papers_preset_plays_ten_steps_and_never_ends_early() {
    let settings = Settings { episodes: 30, ..Settings::of(Preset::Paper, Order::Curriculum, 2) };
    let (trained, episodes, _) = run(&settings, None);
    assert!(episodes.iter().all(|e| e.steps == 10 && e.ending == Episode::TimedOut));
    let updates = episodes.iter().filter(|e| e.losses.is_some()).count();
    assert_eq!(updates, 10, "updates begin after the 20 random episodes");
    assert_eq!(
        (trained.manifest.preset.as_str(), trained.manifest.kind.name()),
        ("paper", "recurrent")
    );
    assert_eq!(trained.manifest.rules.pitch, PitchLimits::PAPER);
}

#[test]
fn impossible_inputs_are_refused_by_field() {
    let refused = |levels: &[Level], settings: &Settings| match train_on(
        &FORMULA,
        levels,
        settings,
        Start::Nothing,
        &GO_ON,
        |_| ControlFlow::Continue(()),
    ) {
        Err(TrainError::Invalid(error)) => error.field,
        other => panic!("{other:?}"),
    };
    let settings = small(Order::Curriculum);
    assert_eq!(refused(&[], &settings), "levels");
    let empty = Level { powder: "sand".into(), repose_deg: 28.0, sets: vec![] };
    assert_eq!(refused(&[empty], &settings), "levels[0].sets");
    let nan = Level { repose_deg: f64::NAN, ..levels().remove(0) };
    assert_eq!(refused(&[nan], &settings), "levels[0].repose_deg");
    assert_eq!(
        refused(&levels(), &Settings { learning_rate: f64::NAN, ..settings }),
        "learning_rate"
    );
}
