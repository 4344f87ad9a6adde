//! Speed, repeatability and equivalence of spoons on a graphics card, beside this machine's
//! processor cores.
//!
//! ```sh
//! cargo run --release -p flip-cuda --example gpu_report            # all three
//! cargo run --release -p flip-cuda --example gpu_report -- speed   # one of them
//! ```
//!
//! Prints what it measures; without a card it prints why there is nothing to measure.

mod equivalence;
mod powders;
mod repeats;
mod speed;

use flip_cuda::Card;
use std::process::ExitCode;

fn main() -> ExitCode {
    let card = match Card::open(0) {
        Ok(card) => card,
        Err(reason) => {
            println!("skipped: {reason}");
            return ExitCode::SUCCESS;
        }
    };
    let cores = powders::cores();
    println!("{}, {} multiprocessors; {cores} CPU cores", card.name(), card.multiprocessors());
    let asked: Vec<String> = std::env::args().skip(1).collect();
    let wanted = |name: &str| asked.is_empty() || asked.iter().any(|it| it == name);
    let mut results = Vec::new();
    if wanted("speed") {
        results.push(speed::report(&card));
    }
    if wanted("repeats") {
        results.push(repeats::report(&card));
    }
    if wanted("equivalence") {
        results.push(equivalence::report(&card));
    }
    for result in &results {
        if let Err(error) = result {
            println!("failed: {error}");
        }
    }
    if results.iter().all(Result::is_ok) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
