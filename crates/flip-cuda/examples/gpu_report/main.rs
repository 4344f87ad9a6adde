//! Speed, repeatability and equivalence of spoons on a graphics card, beside this machine's
//! processor cores.
//!
//! ```sh
//! cargo run --release -p flip-cuda --example gpu_report            # all five
//! cargo run --release -p flip-cuda --example gpu_report -- speed   # one of them
//! cargo run --release -p flip-cuda --example gpu_report -- speed threads=640
//! cargo run --release -p flip-cuda --example gpu_report -- quick   # speed of one batch on the card
//! cargo run --release -p flip-cuda --example gpu_report -- quick kernel=small
//! cargo run --release -p flip-cuda --example gpu_report -- launches launches=10000
//! ```
//!
//! Prints what it measures; without a card it prints why there is nothing to measure.

mod equivalence;
mod heaps;
mod launches;
mod powders;
mod repeats;
mod speed;

use flip_cuda::Card;
use std::process::ExitCode;

/// Launches after which memory is compared, unless others are asked for.
const LAUNCHES: usize = 1_000_000;

fn main() -> ExitCode {
    let asked: Vec<String> = std::env::args().skip(1).collect();
    let open =
        if asked.iter().any(|it| it == "kernel=small") { Card::open_small } else { Card::open };
    let card = match open(0) {
        Ok(card) => card,
        Err(reason) => {
            println!("skipped: {reason}");
            return ExitCode::SUCCESS;
        }
    };
    let threads = asked.iter().find_map(|it| it.strip_prefix("threads=")?.parse().ok());
    let card = match threads {
        Some(threads) => card.with_threads(threads),
        None => card,
    };
    let cores = powders::cores();
    println!("{}, {} multiprocessors; {cores} CPU cores", card.name(), card.multiprocessors());
    let parts = asked.iter().filter(|it| !it.contains('=')).count();
    let wanted = |name: &str| parts == 0 || asked.iter().any(|it| it == name);
    let mut results = Vec::new();
    if wanted("speed") {
        results.push(speed::report(&card, false));
    }
    if asked.iter().any(|it| it == "quick") {
        results.push(speed::report(&card, true));
    }
    if wanted("repeats") {
        results.push(repeats::report(&card));
    }
    if wanted("equivalence") {
        results.push(equivalence::report(&card));
    }
    if wanted("heaps") {
        results.push(heaps::report(&card));
    }
    if wanted("launches") {
        let launches = asked.iter().find_map(|it| it.strip_prefix("launches=")?.parse().ok());
        results.push(launches::report(&card, launches.unwrap_or(LAUNCHES)));
    }
    for result in &results {
        if let Err(error) = result {
            println!("failed: {error}");
        }
    }
    if results.iter().all(Result::is_ok) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
