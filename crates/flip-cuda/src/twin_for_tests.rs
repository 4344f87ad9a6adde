//! The twin: the kernel's source compiled for this processor, as a program that reads jobs from a
//! file and writes what became of them.

use crate::layout::{self, Kernel};
use crate::orders::{Orders, Raw};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, OnceLock, PoisonError};

/// Compiles a twin once per process, into a folder that lasts as long; none, with the reason printed,
/// where there is no g++.
pub(crate) fn built(source: &'static str) -> Option<PathBuf> {
    static BUILT: Mutex<BTreeMap<&str, Option<PathBuf>>> = Mutex::new(BTreeMap::new());
    let mut built = BUILT.lock().unwrap_or_else(PoisonError::into_inner);
    built.entry(source).or_insert_with(|| compiled(source)).clone()
}

fn compiled(source: &str) -> Option<PathBuf> {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| tempfile::tempdir().expect("a folder for the twins"));
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join(source);
    let path = folder.path().join(source.file_stem().unwrap_or_default());
    if !source.exists() {
        println!("skipped: the twin's source is not on this machine");
        return None;
    }
    // Fused operations would round otherwise than the code for processors does.
    let flags = [
        "-O2",
        "-std=c++17",
        "-ffp-contract=off",
        "-fno-math-errno",
        "-Wall",
        "-Wno-unknown-pragmas",
    ];
    match Command::new("g++").args(flags).arg(&source).arg("-o").arg(&path).status() {
        Err(_) => {
            println!("skipped: there is no g++ to compile the twin with");
            None
        }
        Ok(status) => {
            assert!(status.success(), "g++ refused {}", source.display());
            Some(path)
        }
    }
}

/// Carries out orders on these spoons; their states afterwards, and what a card would return. None
/// where the twin cannot be compiled.
pub(crate) fn carry_out(
    laws: &[Vec<u32>],
    spoons: &[Vec<u32>],
    orders: &Orders,
) -> Option<(Vec<Vec<u32>>, Raw)> {
    let extended = laws[0].len() == Kernel::Extended.law();
    let twin = if extended { "cuda/extended_twin.cpp" } else { "cuda/twin.cpp" };
    carry_out_by(twin, laws, spoons, orders)
}

/// The same by another twin, of heaps.
pub(crate) fn carry_out_by(
    twin: &'static str,
    laws: &[Vec<u32>],
    spoons: &[Vec<u32>],
    orders: &Orders,
) -> Option<(Vec<Vec<u32>>, Raw)> {
    let program = built(twin)?;
    // Both kinds of powder have laws of their own length.
    let kernel =
        if laws[0].len() == Kernel::Extended.law() { Kernel::Extended } else { Kernel::Base };
    let folder = tempfile::tempdir().expect("a folder for the jobs");
    let (input, output) = (folder.path().join("in"), folder.path().join("out"));
    let (jobs, parts) = (orders.jobs.len() / layout::JOB, orders.parts.len() / layout::PART);
    let counts = [
        laws.len(),
        spoons.len(),
        jobs,
        parts,
        orders.bodies.len() / 2,
        orders.added.len() / kernel.added(),
    ];
    let mut words: Vec<u32> = counts.iter().map(|count| *count as u32).collect();
    for table in laws.iter().chain(spoons).chain([&orders.jobs, &orders.parts]) {
        words.extend(table);
    }
    words.extend(orders.bodies.iter().map(|x| x.to_bits()));
    words.extend(&orders.added);
    let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    std::fs::write(&input, bytes).expect("the jobs are written");
    let status = Command::new(program).args([&input, &output]).status().expect("the twin runs");
    assert!(status.success(), "the twin failed: {status}");
    let bytes = std::fs::read(&output).expect("the twin's answer is read");
    let words: Vec<u32> =
        bytes.as_chunks().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect();
    let mut rest = words.as_slice();
    let mut take = |count: usize| {
        let (taken, left) = rest.split_at(count);
        rest = left;
        taken.to_vec()
    };
    let states = spoons.iter().map(|spoon| take(spoon.len())).collect();
    let raw = Raw {
        outcomes: take(jobs * layout::OUTCOME),
        rests: take(parts),
        departed: {
            let lost = take(1)[0] as usize;
            take(lost * kernel.departed())
        },
        kernel_s: 0.0,
    };
    Some((states, raw))
}

#[path = "twin_tests.rs"]
pub(crate) mod tests;
