//! Tests of the engine itself: it finds what it must find.

use crate::engine::{Failure, Seen, Target, bounded, run};
use std::time::Duration;

const SOON: Duration = Duration::from_secs(20);

fn target(check: fn(&[u8]) -> Result<Seen, String>) -> Target {
    Target { name: "planted", check, repair: None, words: &["OPEN"], bytes_max: 64 }
}

fn failure(check: fn(&[u8]) -> Result<Seen, String>) -> Failure {
    run(&target(check), &[b"1 CLOSE*ABCD".to_vec()], SOON, 1)
        .expect_err("the planted fault must be found")
}

#[test]
fn a_planted_panic_is_found_and_made_small() {
    let found = failure(|input| {
        let at = input.windows(4).position(|word| word == b"OPEN");
        let wrong = at.is_some_and(|at| input.get(at + 4) == Some(&b'*'));
        assert!(!wrong, "planted");
        Ok(Seen::Read(at.is_some().into()))
    });
    assert_eq!((found.input.as_slice(), found.why.as_str()), (&b"OPEN*"[..], "panic: planted"));
}

#[test]
fn memory_that_a_length_field_asks_for_is_noticed() {
    let found = failure(|input| {
        let bytes = usize::from(input.first().copied().unwrap_or(0)) << 10;
        bounded(200 << 10, || vec![0_u8; bytes]).map(|_| Seen::Read(0))
    });
    assert!(
        found.why.starts_with("held ") && found.input.len() == 1 && found.input[0] >= 200,
        "{found:?}"
    );
}

#[test]
fn an_input_that_takes_too_long_is_noticed() {
    let slow = |_: &[u8]| {
        bounded(0, || std::thread::sleep(Duration::from_millis(300))).map(|()| Seen::Read(0))
    };
    let found = failure(slow);
    assert!(found.why.starts_with("took 0.3"), "{found:?}");
}

#[test]
fn a_corpus_is_looked_at_even_without_time() {
    let files = [b"12".to_vec(), b"3".to_vec()];
    let whole = run(&target(|_| Ok(Seen::Read(0))), &files, Duration::ZERO, 1).unwrap();
    assert_eq!(whole.inputs, 2 + 3 + 24, "files, prefixes, flipped bits");
    assert_eq!((whole.read, whole.outcomes, whole.corpus_files), (29, 1, 2));
}
