//! The fuzzing loop: corpus files, each of their bits flipped, then mutants of inputs whose outcome
//! was new.

use crate::corpus;
use crate::mutate::{Mutator, every_bit_flipped, every_prefix};
use std::cell::Cell;
use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;
use std::time::{Duration, Instant};

/// Longest time for one input, s; exceeding it counts only three times in a row, because other
/// programs run at the same time.
const SECONDS_MAX: f64 = 0.25;
/// Inputs with distinct outcomes kept for mutation, for accepted and for refused ones.
const KEPT_MAX: usize = 2000;
/// Longest corpus file whose every bit is flipped, bytes.
const FLIPPED_BYTES_MAX: usize = 512;
/// Tries when minimising a failing input.
const TRIES_MAX: usize = 4000;

/// One parser and its invariants.
pub struct Target {
    /// Its folder in `corpus`.
    pub name: &'static str,
    /// Parses one input and checks the result.
    ///
    /// # Errors
    /// The violated invariant.
    pub check: fn(&[u8]) -> Result<Seen, String>,
    /// Corrects the checksums of a mutant, so that it is refused for its content.
    pub repair: Option<fn(Vec<u8>) -> Vec<u8>>,
    /// Tokens inserted into mutants.
    pub words: &'static [&'static str],
    /// Longest input, bytes.
    pub bytes_max: usize,
}

/// The outcome of an input. The number distinguishes outcomes: see [`outcome`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Seen {
    /// It was accepted.
    Read(u64),
    /// It was refused.
    Refused(u64),
}

/// How a run went.
#[derive(Debug, Default)]
pub struct Run {
    pub inputs: u64,
    pub read: u64,
    pub seconds: f64,
    pub corpus_files: usize,
    pub outcomes: usize,
}

/// An input that should not have failed.
#[derive(Debug)]
pub struct Failure {
    pub input: Vec<u8>,
    pub why: String,
}

/// A number for an outcome.
pub fn outcome(of: impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    of.hash(&mut hasher);
    hasher.finish()
}

/// Returns the result of `parse`.
///
/// # Errors
/// It held more than `bytes_max` bytes at once, or took longer than [`SECONDS_MAX`].
pub fn bounded<T>(bytes_max: usize, parse: impl Fn() -> T) -> Result<T, String> {
    let mut seconds = f64::INFINITY;
    for _ in 0..3 {
        let (mut parsed, begun) = (None, Instant::now());
        let held =
            allocation_counter::measure(|| parsed = Some(catch_unwind(AssertUnwindSafe(&parse))))
                .bytes_max;
        seconds = begun.elapsed().as_secs_f64().min(seconds);
        let parsed =
            parsed.expect("measured").map_err(|panic| format!("panic: {}", words_of(&*panic)))?;
        if held > bytes_max as u64 {
            return Err(format!("held {held} bytes, at most {bytes_max} are allowed"));
        }
        if seconds <= SECONDS_MAX {
            return Ok(parsed);
        }
    }
    Err(format!("took {seconds:.2} s, at most {SECONDS_MAX} s are allowed"))
}

/// Runs a target for the time set in the environment, and reports the result.
pub fn fuzz(target: &Target) {
    let files = corpus::read(target.name);
    let seconds = number_from("FLIP_FUZZ_SECONDS").unwrap_or(2.0);
    let seed = number_from("FLIP_FUZZ_SEED").unwrap_or(1.0) as u64;
    match run(target, &files, Duration::from_secs_f64(seconds), seed) {
        Ok(run) => {
            assert!(run.read > 0, "{}: not even a file of the corpus is read", target.name);
            say(target.name, &run);
        }
        Err(Failure { input, why }) => {
            let path = corpus::keep(target.name, &input);
            panic!(
                "{}: {why}\n  kept as {}\n  {:?}",
                target.name,
                path.display(),
                String::from_utf8_lossy(&input)
            );
        }
    }
}

/// Runs a target for this long, but always checks the corpus.
///
/// # Errors
/// The first input that fails, minimised.
pub fn run(target: &Target, files: &[Vec<u8>], limit: Duration, seed: u64) -> Result<Run, Failure> {
    be_quiet_about_expected_panics();
    let begun = Instant::now();
    let mut search = Search {
        target,
        read: Vec::new(),
        refused: Vec::new(),
        known: HashMap::new(),
        run: Run::default(),
    };
    search.run.corpus_files = files.len();
    for file in files {
        search.look(file.clone())?;
    }
    for file in files.iter().filter(|file| file.len() <= FLIPPED_BYTES_MAX) {
        for input in every_prefix(file).chain(every_bit_flipped(file)) {
            search.look(input)?;
        }
    }
    let mut mutator = Mutator::new(seed, target.words, target.bytes_max);
    while begun.elapsed() < limit {
        for _ in 0..16 {
            let is_from_read =
                search.refused.is_empty() || (!search.read.is_empty() && mutator.is_heads());
            let mut input =
                mutator.mutant(if is_from_read { &search.read } else { &search.refused });
            if let Some(repair) = target.repair.filter(|_| mutator.is_heads()) {
                input = repair(input);
            }
            search.look(input)?;
        }
    }
    search.run.seconds = begun.elapsed().as_secs_f64();
    search.run.outcomes = search.known.len();
    Ok(search.run)
}

struct Search<'a> {
    target: &'a Target,
    /// Kept inputs that were accepted, and those refused; mutants come from both equally.
    read: Vec<Vec<u8>>,
    refused: Vec<Vec<u8>>,
    /// Which of them has this outcome.
    known: HashMap<Seen, usize>,
    run: Run,
}

impl Search<'_> {
    /// Checks one input, and keeps it if its outcome is new or if it is the shortest with it.
    fn look(&mut self, input: Vec<u8>) -> Result<(), Failure> {
        let seen = tried(self.target, &input).map_err(|why| smallest(self.target, &input, why))?;
        self.run.inputs += 1;
        self.run.read += u64::from(matches!(seen, Seen::Read(_)));
        let kept = if matches!(seen, Seen::Read(_)) { &mut self.read } else { &mut self.refused };
        match self.known.get(&seen) {
            Some(&at) if kept[at].len() > input.len() => kept[at] = input,
            None if kept.len() < KEPT_MAX => {
                self.known.insert(seen, kept.len());
                kept.push(input);
            }
            _ => {}
        }
        Ok(())
    }
}

thread_local! {
    static IS_TRYING: Cell<bool> = const { Cell::new(false) };
}

/// The target's outcome for this input; a panic is a failure like any other.
fn tried(target: &Target, input: &[u8]) -> Result<Seen, String> {
    IS_TRYING.set(true);
    let seen = catch_unwind(|| (target.check)(input));
    IS_TRYING.set(false);
    seen.unwrap_or_else(|panic| Err(format!("panic: {}", words_of(&*panic))))
}

/// The same failure with as few bytes as a greedy search finds.
fn smallest(target: &Target, input: &[u8], why: String) -> Failure {
    let mut least = Failure { input: input.to_vec(), why };
    let (mut tries, mut length) = (0, input.len().div_ceil(2));
    while length > 0 && tries < TRIES_MAX {
        let mut at = 0;
        while at < least.input.len() && tries < TRIES_MAX {
            let end = (at + length).min(least.input.len());
            let shorter = [&least.input[..at], &least.input[end..]].concat();
            tries += 1;
            match tried(target, &shorter) {
                Err(why) => least = Failure { input: shorter, why },
                Ok(_) => at = end,
            }
        }
        length /= 2;
    }
    least
}

/// Panics of a parser become failures with their own message; the hundreds during minimisation are
/// noise.
fn be_quiet_about_expected_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let usual = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            if !IS_TRYING.get() {
                usual(panic);
            }
        }));
    });
}

fn words_of(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or(panic.downcast_ref::<&str>().copied()).unwrap_or("without words").to_owned()
}

fn number_from(variable: &str) -> Option<f64> {
    std::env::var(variable)
        .ok()
        .map(|text| text.parse().unwrap_or_else(|_| panic!("{variable} must be a number")))
}

/// Writes straight to standard output, because a passing test should report this as well.
fn say(name: &str, run: &Run) {
    let Run { inputs, read, seconds, corpus_files, outcomes } = run;
    let share = 100.0 * *read as f64 / *inputs as f64;
    let line = format!(
        "fuzz {name}: {inputs} inputs in {seconds:.1} s, {share:.0} % of them read, {outcomes} outcomes, {corpus_files} corpus files\n"
    );
    // If nobody listens, only the line is lost.
    let _ = std::io::stdout().write_all(line.as_bytes());
}
