//! Several benches on one database, each of its own process.

use crate::bench::{clear, code, resume};
use crate::harness::{PATIENCE, ToyRig, calibrated, functions, mg, until};
use crate::weighing::{Gate, done};
use flip::app::{App, Error, Functions, LoadRequest, OpenError, Options, Storage, WeighingRequest};
use flip_bench::rig::{OnEvent, Poured, Pouring};
use flip_bench::weigh::Event;
use flip_core::domain::bench::{Action, BenchKind, Reading, Tick};
use flip_core::domain::weighing::{Outcome, WeighingState};
use sqlx::{Connection, PgConnection};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// The address of this folder's database, whatever the other tests run on; `None`, and why, where
/// there is no server.
async fn address(folder: &Path) -> Option<String> {
    let cluster = flip_testing::cluster().inspect_err(|why| println!("skipped: {why}")).ok()?;
    Some(cluster.database_of(folder).await)
}

async fn serve(folder: &Path, bench: &str, functions: Functions) -> Result<App, OpenError> {
    let storage = Storage::on_server(&address(folder).await.unwrap(), folder).unwrap();
    App::open(storage.with_bench(bench), Options { functions, ..Options::default() }).await
}

/// Two processes with a bench each, whose doses wait for their gates.
struct Two {
    folder: TempDir,
    first: App,
    second: App,
    gates: [Arc<Gate>; 2],
}

async fn two() -> Option<Two> {
    let folder = tempfile::tempdir().unwrap();
    address(folder.path()).await?;
    let gates = [Arc::new(Gate::default()), Arc::new(Gate::default())];
    let first = serve(folder.path(), "bench", gates[0].functions()).await.unwrap();
    let second = serve(folder.path(), "hall-2", gates[1].functions()).await.unwrap();
    calibrated(&first, "sand").await;
    Some(Two { folder, first, second, gates })
}

fn at(bench: &str, value: f64) -> WeighingRequest {
    WeighingRequest { bench_name: Some(bench.into()), ..mg("sand", value) }
}

fn pours(gate: &Gate) -> usize {
    gate.pours.load(Ordering::SeqCst)
}

fn load(powder: &str) -> LoadRequest {
    LoadRequest { powder: Some(powder.into()), lot: Some("L1".into()) }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_weighing_goes_to_the_bench_it_names_or_to_any_that_holds_its_powder() {
    let Some(Two { first, second, gates, folder }) = two().await else { return };
    gates.iter().for_each(|gate| gate.open());
    let third = serve(folder.path(), "hall-2", functions()).await;
    let Err(OpenError::Held(message)) = third else { panic!("a second owner") };
    assert!(message.contains("bench `hall-2` is served by"), "{message}");

    let (there, replayed) = first.start_weighing(at("hall-2", 5.0), "one").await.unwrap();
    assert_eq!((there.at_bench(), replayed), ("hall-2", false));
    assert_eq!(done(&first, &there.id).await.outcome, Some(Outcome::Within));
    assert_eq!((pours(&gates[0]), pours(&gates[1])), (0, 1));
    for app in [&first, &second] {
        let (same, replayed) = app.start_weighing(at("hall-2", 5.0), "one").await.unwrap();
        assert_eq!((same.id, replayed), (there.id.clone(), true));
    }
    let here = first.start_weighing(mg("sand", 5.0), "two").await.unwrap().0;
    assert_eq!((here.at_bench(), &here.bench_name), ("bench", &None));
    assert_eq!(done(&first, &here.id).await.outcome, Some(Outcome::Within));
    // The owner's own refusal comes back.
    let refused = first.start_weighing(at("hall-2", 1e6), "three").await.unwrap_err();
    assert!(matches!(&refused, Error::Invalid(fields) if fields[0].field == "target.value"));
    let refused = first.start_weighing(at("hall-3", 5.0), "three").await.unwrap_err();
    assert!(matches!(&refused, Error::Invalid(fields) if fields[0].field == "bench_name"));

    first.load_bench("bench", load("salt")).await.unwrap();
    let none = first.start_weighing(at("any", 5.0), "four").await.unwrap_err();
    assert!(none.to_string().contains("`bench` holds `salt` of lot `L1`"), "{none}");
    assert_eq!(code::<()>(Err(none)), "powder_not_loaded");
    first.load_bench("hall-2", load("sand")).await.unwrap();
    let any = first.start_weighing(at("any", 5.0), "four").await.unwrap().0;
    assert_eq!(any.at_bench(), "hall-2");
    assert_eq!(done(&second, &any.id).await.outcome, Some(Outcome::Within));
    assert_eq!((pours(&gates[0]), pours(&gates[1])), (1, 2));
    let found = first.verify_audit(None).await.unwrap();
    assert_eq!((found.broken, found.chains.len()), (None, 1));
    first.shutdown().await.unwrap();
    second.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_from_any_server_reaches_the_bench_that_it_is_for_and_no_other() {
    let Some(Two { first, second, gates, folder: _folder }) = two().await else { return };
    let here = first.start_weighing(mg("sand", 5.0), "one").await.unwrap().0.id;
    let there = first.start_weighing(at("hall-2", 5.0), "two").await.unwrap().0.id;
    let waits = first.start_weighing(at("hall-2", 6.0), "three").await.unwrap().0.id;
    until("both move", async || pours(&gates[0]) == 1 && pours(&gates[1]) == 1).await;
    let begun = Instant::now();
    let stopped = first.stop_bench_named("hall-2").await.unwrap();
    let took = begun.elapsed();
    println!("a stop of another process's bench took {took:?}");
    assert!(took < Duration::from_secs(2), "{took:?}");
    assert!(stopped.held.unwrap().reason.contains(&there));
    assert_eq!(done(&first, &there).await.outcome, Some(Outcome::Stopped));
    let benches = first.benches().await.unwrap();
    let told: Vec<_> = benches.iter().map(|it| (it.name.as_str(), it.waiting, it.served)).collect();
    assert_eq!(told, [("bench", 0, true), ("hall-2", 1, true)]);
    assert_eq!(benches[0].moving.as_deref(), Some(here.as_str()), "it moves on");
    assert!(benches[0].held.is_none() && benches[1].held.is_some());
    // The next dose there waits until somebody resumes, from anywhere.
    gates[1].open();
    assert_eq!(code(second.resume_bench_named("bench", resume()).await), "bench_not_held");
    assert_eq!(first.resume_bench_named("hall-2", resume()).await.unwrap().held, None);
    assert_eq!(done(&first, &waits).await.outcome, Some(Outcome::Within));
    // A weighing is found by its id, wherever it moves.
    let (ended, _) = second.stop_weighing(&here).await.unwrap();
    assert_eq!(ended.id, here);
    assert_eq!(done(&second, &here).await.outcome, Some(Outcome::Stopped));
    assert_eq!(first.verify_audit(None).await.unwrap().broken, None);
    first.shutdown().await.unwrap();
    second.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bench_whose_process_is_lost_is_latched_by_another_and_nothing_is_poured_twice() {
    let Some(Two { first, second, gates, folder }) = two().await else { return };
    gates[0].open();
    let moving = first.start_weighing(at("hall-2", 5.0), "one").await.unwrap().0.id;
    let waits = first.start_weighing(at("hall-2", 6.0), "two").await.unwrap().0.id;
    until("it moves", async || pours(&gates[1]) == 1).await;
    // Its process hangs: its lane still holds the dose, and nobody hears of it.
    drop(second);
    let mut database = PgConnection::connect(&address(folder.path()).await.unwrap()).await.unwrap();
    let silent = "UPDATE bench SET lease_until = 1 WHERE name = 'hall-2'";
    sqlx::query(silent).execute(&mut database).await.unwrap();
    let state = async || first.weighing(&moving).await.unwrap().weighing.state;
    until("somebody notices", async || state().await == WeighingState::Unknown).await;
    let row = first.benches().await.unwrap().remove(1);
    assert!(row.latch.unwrap().contains("not heard of any more") && !row.served);
    let unheard = first.stop_bench_named("hall-2").await.unwrap_err().to_string();
    assert!(unheard.contains("NOT heard") && unheard.contains("wired stop"), "{unheard}");
    assert!(first.clear_bench_named("hall-2", clear(true)).await.is_err());
    // It comes back to life: whatever it did, it can record nothing of it.
    gates[1].open();
    let again = Arc::new(Gate::default());
    again.open();
    let begun = Instant::now();
    let second = loop {
        match serve(folder.path(), "hall-2", again.functions()).await {
            Ok(served) => break served,
            Err(_) => assert!(begun.elapsed() < PATIENCE, "no other process has the bench"),
        }
    };
    let ended = first.weighing(&moving).await.unwrap().weighing;
    assert_eq!((ended.outcome, ended.reading_mg), (Some(Outcome::Unknown), None));
    assert_eq!(pours(&again), 0, "it is latched until somebody has looked");
    // The stop that nobody heard may reach it only now: then it has to be cleared again.
    let cleared = loop {
        match first.clear_bench_named("hall-2", clear(true)).await {
            Ok(cleared) => break cleared,
            Err(Error::Conflict { code: "stopped_meanwhile", .. })
                if begun.elapsed() < PATIENCE => {}
            Err(error) => panic!("{error}"),
        }
    };
    assert_eq!(cleared.latch, None);
    assert_eq!(done(&first, &waits).await.outcome, Some(Outcome::Within));
    assert_eq!((pours(&gates[1]), pours(&again)), (1, 1));
    assert_eq!(first.verify_audit(None).await.unwrap().broken, None);
    first.shutdown().await.unwrap();
    second.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dose_ends_by_itself_when_the_network_to_its_database_goes_away() {
    let folder = tempfile::tempdir().unwrap();
    let Some(url) = address(folder.path()).await else { return };
    let cable = Arc::new(flip_testing::cluster().unwrap().cable());
    let url = cable.address(&url);
    let storage = Storage::on_server(&url, folder.path()).unwrap();
    let (took, network) = (Arc::<Mutex<Vec<Duration>>>::default(), cable.clone());
    let poured = took.clone();
    // A dose without an end of its own, after whose second reading nothing comes through.
    let pour = move |_: &Pouring, on_event: OnEvent<'_>, _: &AtomicBool| {
        for step in 0.. {
            let reading = Reading { mass_mg: f64::from(step), stable: true };
            let (t_s, action) = (f64::from(step), Action::default());
            let tick = Tick { step, t_s, pitch_deg: 10.0, action, reading, spoonful: 1 };
            if step == 2 {
                network.cut();
            }
            let begun = Instant::now();
            if on_event(&Event::Tick(&tick)).is_break() {
                poured.lock().unwrap().push(begun.elapsed());
                break;
            }
        }
        let outcome = Outcome::Aborted;
        let (dispensed_mg, reading_mg, measured, stroke) = (None, None, None, None);
        let (shakes, seconds, ticks, error, must_look) = (3, 3.0, Vec::new(), None, None);
        Poured {
            outcome,
            dispensed_mg,
            reading_mg,
            measured,
            shakes,
            seconds,
            ticks,
            stroke,
            error,
            must_look,
        }
    };
    let rig = ToyRig::of(BenchKind::Emulated, pour);
    let functions = Functions { rig, ..functions() };
    let app = App::open(storage, Options { functions, ..Options::default() }).await.unwrap();
    calibrated(&app, "sand").await;
    let id = app.start_weighing(mg("sand", 5.0), "one").await.unwrap().0.id;
    until("the dose has ended", async || took.lock().unwrap().len() == 1).await;
    let waited = took.lock().unwrap()[0];
    println!("a dose whose record was not answered ended after {waited:?}");
    assert!(waited < Duration::from_secs(14), "{waited:?}");
    assert!(app.bench().await.unwrap().moving.is_none() || waited > Duration::ZERO);
    cable.mend();
    let ended = done(&app, &id).await;
    assert_eq!(ended.outcome, Some(Outcome::Aborted));
    let why = ended.error.unwrap();
    assert!(why.contains("so nothing may move"), "{why}");
    assert_eq!(app.verify_audit(None).await.unwrap().broken, None);
    assert_eq!(took.lock().unwrap().len(), 1, "it was poured once");
    app.shutdown().await.unwrap();
}
