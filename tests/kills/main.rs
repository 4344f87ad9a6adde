//! `flip serve` is killed at random moments of doses on an emulated laboratory that keeps running:
//! nothing is poured twice, nothing continues by itself.
//!
//! The laboratory is a separate process, so its arm, vial and balance see what a real bench would
//! see: the driver's renewals end, and its dead-man levels and retracts the spoon. `FLIP_KILLS`
//! sets the number of kills (`make reliability`: 300).
//!
//! On PostgreSQL (`FLIP_TEST_DATABASE=postgres`) one third of the faults are such kills, one third
//! crashes of the database and one third cuts of the network between the two.

mod laboratory;
mod service;

use laboratory::{Laboratory, Motion};
use service::{Database, Service, calibrate};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Kills in `make test`, on SQLite and on PostgreSQL, where a cut network is waited for.
const KILLS: [u64; 2] = [30, 16];
/// Laboratories for each core whose services are killed in parallel, unless `FLIP_LABORATORIES` says
/// how many a core: a dose is mostly waiting.
const LABORATORIES: u64 = 4;
const TARGET_MG: f64 = 12.0;
const TOLERANCE_MG: f64 = 1.0;
/// Masses that differ by less are equal up to rounding, mg.
const SAME_MG: f64 = 1e-6;
/// Amplitudes that differ by less are equal up to rounding, mm.
const SAME_MM: f64 = 1e-6;
/// Most a dose may leave in its vial, mg.
const LIMIT_MG: f64 = TARGET_MG + TOLERANCE_MG;
/// Most beyond the limit, mg, whatever the cause: the possible error of a dose's own display, four
/// standard deviations of the difference of two readings of a balance that wanders by 0.5 mg, as
/// the emulated one does, and half a step. A dose poured twice has an entire target too much.
const DISPLAY_MG: f64 = 4.0 * std::f64::consts::SQRT_2 * 0.5 + 0.5;
/// A dose that nobody can record ends by itself after 12 s (`RECORD` of the lane); with the way back
/// of the spoon, within so many milliseconds.
const ENDS_WITHIN_MS: u64 = 20_000;
/// Longest dose: near its limits each reading is waited for up to 20 s, as the balance wanders.
const LONGEST: Duration = Duration::from_secs(400);
/// Shakes that may be recorded after a kill: one in progress, and one that had just ended.
const LAST_SHAKES: usize = 2;

/// What happens to a dose before its service is killed.
#[derive(Debug, Clone, Copy)]
enum Fault {
    None,
    /// The database crashes, and is there again a moment later; the service lives so many
    /// milliseconds longer.
    Crash(u64),
    /// The network between service and database is cut for so many milliseconds.
    Cut(u64),
}

impl Fault {
    fn of(number: u64, drawn: u64, database: Option<&Database>) -> Self {
        match (database, number % 3) {
            (None, _) | (_, 0) => Self::None,
            (_, 1) => Self::Crash(drawn % 10_000),
            // 5 to 60 s.
            _ => Self::Cut(5000 + drawn % 55_000),
        }
    }

    async fn inflict(
        self,
        what: &str,
        laboratory: &Laboratory,
        service: &Service,
        (id, first): (&str, usize),
        database: Option<&Database>,
    ) {
        let Some(database) = database else { return };
        match self {
            Self::None => {}
            Self::Crash(later_ms) => {
                database.cluster.crash();
                tokio::time::sleep(Duration::from_millis(later_ms)).await;
            }
            Self::Cut(for_ms) => {
                let before = laboratory.motions().made.len();
                database.cable.cut();
                tokio::time::sleep(Duration::from_millis(for_ms)).await;
                let shakes = laboratory.shakes_since(before);
                assert!(shakes <= LAST_SHAKES, "{what}: {shakes} shakes that nobody could record");
                let is_long = for_ms > ENDS_WITHIN_MS;
                let pitch_deg = laboratory.pitch_deg();
                assert!(!is_long || pitch_deg == 0.0, "{what}: the spoon is at {pitch_deg} deg");
                // One that has not come to its first shake may not have needed a record meanwhile.
                let was_dosing = laboratory.shakes_since(first) > 0;
                database.cable.mend();
                if is_long && was_dosing {
                    let ended = ["done", "aborted", "unknown"];
                    service.wait_for(what, id, &ended).await;
                }
            }
        }
    }
}

/// Mass a dose left in its vial, mg, if each of its shakes was decided on record, in this order,
/// and none began above the limit.
///
/// Anything above the limit therefore began to fall with the last shake, which the guard had
/// decided before the kill: that is the risk it takes with each shake (`Forecast::risk`), and not
/// the effect of a restart.
fn accounted_mg(made: &[Motion], decided_mm: &[f64]) -> Result<f64, String> {
    let (mut fallen_mg, mut decided) = (0.0, decided_mm.iter());
    for motion in made {
        if let Some(shake_mm) = motion.shake_mm() {
            if decided.next().is_none_or(|decided_mm| (shake_mm - decided_mm).abs() > SAME_MM) {
                return Err(format!("a shake of {shake_mm} mm, and on record are {decided_mm:?}"));
            }
            if fallen_mg > LIMIT_MG {
                return Err(format!(
                    "a shake of {shake_mm} mm began with {fallen_mg:.2} mg in the vial"
                ));
            }
        }
        fallen_mg += motion.poured_mg;
    }
    Ok(fallen_mg)
}

/// Outcomes of the killed doses.
#[derive(Default)]
struct Tally {
    /// Doses that had not ended when their fault came.
    hit: u64,
    unknown: u64,
    /// The outcome of each ended dose, and the mass it left in its vial.
    ended: Vec<String>,
    /// Mass that each kill left in its vial, mg.
    poured_mg: Vec<f64>,
    /// Those that left more than the limit.
    over: Vec<String>,
}

/// Kills one laboratory's service in each of these doses.
async fn kill_all(kills: impl Iterator<Item = u64>) -> Tally {
    let folder = TempDir::new().unwrap();
    let laboratory = Laboratory::start(folder.path());
    let database = Database::start(folder.path()).await;
    let mut service = Service::start(folder.path(), &laboratory, database.as_ref(), None);
    calibrate(&service).await;
    let mut tally = Tally::default();
    for kill in kills {
        let first = laboratory.motions().made.len();
        let before_mg = laboratory.vial_mg();
        let key = format!("vial-{kill}");
        let (status, weighing) = service.weigh(&key).await;
        assert_eq!(status, 202, "{weighing}");
        let id = weighing["id"].as_str().unwrap().to_owned();
        service
            .wait_for("the bench does not move", &id, &["armed", "dosing", "settling", "done"])
            .await;
        let drawn = flip_core::domain::seed::derive(20_261_124, &[kill]);
        let share = (drawn % 1000) as f64 / 1000.0;
        // Every third at any time from the start, including before powder falls; the others once
        // that share of the target lies in the vial, and a little later.
        let later_ms = match kill % 3 {
            0 => drawn % 8000,
            _ => {
                let begun = Instant::now();
                while laboratory.vial_mg() - before_mg < share * TARGET_MG
                    && !service.has_ended(&id).await
                {
                    assert!(begun.elapsed() < LONGEST, "fault {kill}: the dose does not end");
                    tokio::time::sleep(Duration::from_millis(15)).await;
                }
                drawn / 1000 % 200
            }
        };
        tokio::time::sleep(Duration::from_millis(later_ms)).await;
        let fault = Fault::of(kill / 3, drawn / 7, database.as_ref());
        let what = format!("fault {kill}, {fault:?}");
        tally.hit += u64::from(!service.has_ended(&id).await);
        fault.inflict(&what, &laboratory, &service, (&id, first), database.as_ref()).await;
        let token = service.kill();
        let killed = laboratory.motions().made.len();
        let last = laboratory.wait_until_still();
        let shakes = laboratory.shakes_since(killed);
        assert!(shakes <= LAST_SHAKES, "{what}: {shakes} shakes after the kill");
        let poured_mg = laboratory.vial_mg() - before_mg;
        assert_eq!(laboratory.pitch_deg(), 0.0, "{what}: the spoon is not level");

        service = Service::start(folder.path(), &laboratory, database.as_ref(), Some(token));
        let state = service.state(&id).await;
        let latched = !service.get("/v1/bench").await["latch"].is_null();
        match state.as_str() {
            "unknown" => {
                tally.unknown += 1;
                assert!(latched, "{what}: an interrupted dose leaves the bench latched");
                let (status, refused) = service.weigh(&format!("another-{kill}")).await;
                let latched = (409, Some("urn:flip:problem:bench-latched"));
                assert_eq!((status, refused["type"].as_str()), latched, "{refused}");
            }
            "done" | "aborted" => {
                let weighing = service.get(&format!("/v1/weighings/{id}")).await["weighing"].take();
                let (outcome, shown_mg) = (&weighing["outcome"], &weighing["reading_mg"]);
                tally
                    .ended
                    .push(format!("{what}: {outcome}, {shown_mg} mg shown, {poured_mg:.2} mg"));
            }
            other => panic!("{what}: {other}"),
        }
        // The same request again finds the same weighing, and pours nothing.
        let (_, again) = service.weigh(&key).await;
        assert_eq!(again["id"].as_str(), Some(id.as_str()), "{again}");
        tokio::time::sleep(Duration::from_millis(150)).await;
        let decided_mm = service.decided_mm(&id).await;
        let made = laboratory.motions().made.clone();
        assert_eq!(made.len(), last, "{what}: {:?} after it", &made[last..]);
        let accounted_mg =
            accounted_mg(&made[first..], &decided_mm).unwrap_or_else(|why| panic!("{what}: {why}"));
        let missing_mg = poured_mg - accounted_mg;
        assert!(missing_mg.abs() < SAME_MG, "{what}: {missing_mg} mg that fell in no motion");
        tally.poured_mg.push(poured_mg);
        if poured_mg > LIMIT_MG {
            tally
                .over
                .push(format!("{what}: {state}, {poured_mg:.2} mg, shakes of {decided_mm:.1?} mm"));
        }
        if latched {
            service.clear().await;
        }
    }
    let verified = service.get("/v1/audit/verification").await;
    assert!(
        verified["broken"].is_null() && verified["records"].as_i64().unwrap() > 0,
        "{verified}"
    );
    tally
}

#[test]
fn killed_at_any_moment_of_a_dose_nothing_is_poured_twice_and_the_bench_waits_for_a_person() {
    let usual = KILLS[usize::from(flip_testing::on_postgres())];
    let number = |name: &str, usual: u64| {
        std::env::var(name).map_or(usual, |text| text.parse::<u64>().unwrap())
    };
    let kills = number("FLIP_KILLS", usual);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let laboratories = number("FLIP_LABORATORIES", LABORATORIES) * cores as u64;
    let (mut hit, mut unknown) = (0, 0);
    let (mut ended, mut poured_mg, mut over) = (Vec::new(), Vec::new(), Vec::new());
    let in_laboratory = |first: u64| {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .unwrap();
        runtime.block_on(kill_all((first..kills).step_by(laboratories as usize)))
    };
    std::thread::scope(|scope| {
        let all: Vec<_> = (0..laboratories.min(kills))
            .map(|first| scope.spawn(move || in_laboratory(first)))
            .collect();
        for laboratory in all {
            let tally = laboratory.join().expect("a laboratory has failed");
            hit += tally.hit;
            unknown += tally.unknown;
            ended.extend(tally.ended);
            poured_mg.extend(tally.poured_mg);
            over.extend(tally.over);
        }
    });
    poured_mg.sort_by(f64::total_cmp);
    let quartiles: Vec<String> =
        (0..=4).map(|q| format!("{:.1}", poured_mg[q * (poured_mg.len() - 1) / 4])).collect();
    let quartiles = quartiles.join(", ");
    println!(
        "{kills} kills: {unknown} doses unknown and latched, {} had ended; in the vials (quartiles) {quartiles} mg of {TARGET_MG}",
        ended.len()
    );
    println!("ended before they were killed:\n  {}", ended.join("\n  "));
    println!(
        "above {LIMIT_MG} mg by the last shake, decided before the kill:\n  {}",
        over.join("\n  ")
    );
    let most_mg = LIMIT_MG + DISPLAY_MG;
    assert!(
        poured_mg[poured_mg.len() - 1] <= most_mg,
        "an overdose: {quartiles}, and at most {most_mg:.1} are expected"
    );
    assert!(hit * 2 >= kills, "most kills hit a dose: {hit} of {kills}");
    // On PostgreSQL a dose that is cut off ends by itself before its service is killed.
    let ends_by_itself = flip_testing::on_postgres();
    assert!(ends_by_itself || unknown * 2 >= kills, "of {kills} doses {unknown} are unknown");
}

#[test]
fn a_shake_that_nobody_decided_or_that_begins_above_the_limit_is_found() {
    let shake = |mm: f64, poured_mg: f64| Motion {
        motion: format!("Shake({mm:?})"),
        pitch_deg: 24.0,
        poured_mg,
        vial_mg: 0.0,
    };
    let pitch =
        Motion { motion: "Pitch(24.0)".to_owned(), pitch_deg: 24.0, poured_mg: 0.5, vial_mg: 0.0 };
    let dose = [pitch, shake(4.0, 8.0), shake(2.5, 6.0)];
    assert_eq!(accounted_mg(&dose, &[4.0, 2.5]), Ok(14.5));
    // The kill came between the decision and its shake.
    assert_eq!(accounted_mg(&dose[..2], &[4.0, 2.5]), Ok(8.5));
    let wrong = [
        (&dose[..], vec![4.0]),
        (&dose[..], vec![4.0, 2.0]),
        (&dose[..], vec![2.5, 4.0]),
        (&dose[1..], vec![]),
    ];
    for (made, decided_mm) in wrong {
        assert!(
            accounted_mg(made, &decided_mm).unwrap_err().contains("on record"),
            "{decided_mm:?}"
        );
    }
    let [pitch, first, second] = dose;
    let above = [pitch, first, second, shake(1.0, 0.0)];
    assert!(accounted_mg(&above, &[4.0, 2.5, 1.0]).unwrap_err().contains("began with 14.50 mg"));
}
