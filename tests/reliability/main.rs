//! Does a fault ever pour too much, leave a spoon tilted, or go unnamed? Every fault of every
//! device a weighing uses, at every moment of one.
//!
//! `cargo test` runs a tenth of the cases and every restart of the balance, `make reliability` all
//! of them (`docs/reliability.md`).

mod bench;
mod cases;
mod record;
mod report;
mod verdict;

use bench::{Dose, run};
use cases::Case;
use report::Row;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Concurrent weighings: they wait for one another's devices more than they compute.
const AT_ONCE: usize = 16;
/// One case in this many, if not all are requested.
const SHARE: u64 = 10;
/// The doses weighed; each passes through every moment at which a fault can begin.
const DOSES: [Dose; 4] = [
    Dose { target_mg: 5.0, seed: 1 },
    Dose { target_mg: 10.0, seed: 1 },
    Dose { target_mg: 15.0, seed: 1 },
    Dose { target_mg: 20.0, seed: 1 },
];

#[test]
fn no_fault_pours_too_much_leaves_the_spoon_tilted_or_goes_unnamed() {
    let all = Case::all();
    let is_full = std::env::var("FLIP_RELIABILITY").is_ok_and(|value| value == "full");
    let only = std::env::var("FLIP_RELIABILITY_ONLY").ok();
    let is_chosen = |case: &Case| match &only {
        Some(name) => case.to_string().contains(name),
        // A balance that restarts is checked in every state: nothing but its own message reveals
        // it.
        None => is_full || case.is_restart() || case.hash().is_multiple_of(SHARE),
    };
    let chosen: Vec<Case> = all.iter().copied().filter(is_chosen).collect();
    let twins = at_once(&DOSES, |dose| run(*dose, None));
    for (dose, twin) in DOSES.iter().zip(&twins) {
        assert_eq!(twin.record.check(), Ok(()), "{dose:?}");
        println!("{}", report::twin(*dose, twin));
    }
    let rows = at_once(&chosen, |case| {
        let which = case.hash() as usize / 64 % DOSES.len();
        let began = std::time::Instant::now();
        let ran = run(DOSES[which], Some(*case));
        // A busy machine may delay an answer beyond its deadline before the fault has begun: then
        // nothing was tested.
        let is_tried = ran.record.injected_at().is_some();
        let ran = if is_tried { ran } else { run(DOSES[which], Some(*case)) };
        Row::new(DOSES[which], *case, &ran, twins[which].vial_mg, began.elapsed())
    });
    println!("{} of {} cases", chosen.len(), all.len());
    println!("{}", report::table(&rows));
    if only.is_some() {
        rows.iter().for_each(|row| println!("{row}"));
    }
    let wrong: Vec<String> = rows.iter().flat_map(Row::complaints).collect();
    assert!(wrong.is_empty(), "{} complaints:\n{}", wrong.len(), wrong.join("\n"));
}

/// The results of `work` for each of these, in order.
fn at_once<T: Sync, R: Send>(items: &[T], work: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let next = AtomicUsize::new(0);
    let done = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                while let Some((at, item)) = {
                    let at = next.fetch_add(1, Ordering::SeqCst);
                    items.get(at).map(|item| (at, item))
                } {
                    let result = work(item);
                    done.lock().expect("no worker panicked").push((at, result));
                }
            });
        }
    });
    let mut done = done.into_inner().expect("no worker panicked");
    done.sort_by_key(|(at, _)| *at);
    done.into_iter().map(|(_, result)| result).collect()
}
