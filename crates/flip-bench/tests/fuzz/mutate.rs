//! Mutants: inputs already checked, with a few things changed.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Bytes that parsers treat specially.
const BYTES: [u8; 16] = *b"\0\x01\x7f\x80\xff\r\n\t *,.+-09";
/// Numbers at and beyond the limits of fields.
const NUMBERS: [&str; 16] = [
    "0",
    "-0",
    "00",
    "1",
    "-1",
    "255",
    "256",
    "1000",
    "1001",
    "65535",
    "65536",
    "4294967296",
    "18446744073709551616",
    "1e308",
    "NaN",
    "inf",
];
/// Most bytes copied, removed or repeated at once.
const PIECE_BYTES_MAX: usize = 32;

/// Generates mutants, deterministic for a seed.
pub struct Mutator {
    rng: Pcg64Mcg,
    words: &'static [&'static str],
    bytes_max: usize,
}

impl Mutator {
    pub fn new(seed: u64, words: &'static [&'static str], bytes_max: usize) -> Self {
        Self { rng: Pcg64Mcg::seed_from_u64(seed), words, bytes_max }
    }

    pub fn is_heads(&mut self) -> bool {
        self.rng.random()
    }

    /// One of these inputs with up to six changes.
    pub fn mutant(&mut self, from: &[Vec<u8>]) -> Vec<u8> {
        let mut input = from[self.below(from.len())].clone();
        for _ in 0..self.rng.random_range(1..=6) {
            self.change(&mut input, from);
        }
        input.truncate(self.bytes_max);
        input
    }

    fn change(&mut self, input: &mut Vec<u8>, from: &[Vec<u8>]) {
        let at = self.below(input.len() + 1);
        let piece = at..(at + self.below(PIECE_BYTES_MAX)).min(input.len());
        match self.below(10) {
            0 if at < input.len() => input[at] ^= 1 << self.below(8),
            1 if at < input.len() => input[at] = self.rng.random(),
            2 if at < input.len() => input[at] = BYTES[self.below(BYTES.len())],
            3 => input.insert(at, BYTES[self.below(BYTES.len())]),
            4 => drop(input.drain(piece)),
            5 => {
                let copy = input[piece].to_vec();
                input.splice(at..at, copy);
            }
            6 => {
                let other = &from[self.below(from.len())];
                let begin = self.below(other.len() + 1);
                let end = (begin + self.below(PIECE_BYTES_MAX)).min(other.len());
                input.splice(piece, other[begin..end].iter().copied());
            }
            7 => {
                let number = NUMBERS[self.below(NUMBERS.len())].bytes();
                input.splice(number_at(input, at), number);
            }
            8 if !self.words.is_empty() => {
                let word = self.words[self.below(self.words.len())].bytes();
                let end = if self.is_heads() { at } else { piece.end };
                input.splice(at..end, word);
            }
            9 if self.below(8) == 0 => input.truncate(at),
            _ => {}
        }
    }

    fn below(&mut self, end: usize) -> usize {
        self.rng.random_range(0..end.max(1) as u64) as usize
    }
}

/// The digits starting here.
fn number_at(input: &[u8], at: usize) -> std::ops::Range<usize> {
    at..at + input[at..].iter().take_while(|byte| byte.is_ascii_digit()).count()
}

/// The input cut at every length.
pub fn every_prefix(input: &[u8]) -> impl Iterator<Item = Vec<u8>> {
    (0..input.len()).map(|end| input[..end].to_vec())
}

/// The input with one bit flipped, for every bit.
pub fn every_bit_flipped(input: &[u8]) -> impl Iterator<Item = Vec<u8>> {
    (0..8 * input.len()).map(|bit| {
        let mut flipped = input.to_vec();
        flipped[bit / 8] ^= 1 << (bit % 8);
        flipped
    })
}
