//! Peak performance of the processor for the kernel's own operations: the two limits of the
//! roofline model (Williams et al. 2009).

use super::{Avx2, Avx512, Lanes, Path, Portable, WIDTH};
use std::hint::black_box;

/// Independent chains: enough to hide the latency of an addition and a multiplication without
/// running out of registers.
const CHAINS_WIDE: usize = 12;
/// The same if sixteen numbers take two or more registers.
const CHAINS: usize = 6;

/// Multiplies and adds in registers without fusing, like the kernel; returns the number of
/// operations, counting one per number.
pub(crate) fn multiply_add(path: Path, rounds: u32) -> u64 {
    let chains = match path {
        Path::Portable => multiply_add_with::<Portable, CHAINS>(rounds),
        // SAFETY: a path is chosen only on a processor that supports it.
        Path::Avx2 => unsafe { multiply_add_avx2(rounds) },
        // SAFETY: as above.
        Path::Avx512 => unsafe { multiply_add_avx512(rounds) },
    };
    2 * u64::from(rounds) * (chains * WIDTH) as u64
}

#[target_feature(enable = "avx2")]
fn multiply_add_avx2(rounds: u32) -> usize {
    multiply_add_with::<Avx2, CHAINS>(rounds)
}

#[target_feature(enable = "avx512f")]
fn multiply_add_avx512(rounds: u32) -> usize {
    multiply_add_with::<Avx512, CHAINS_WIDE>(rounds)
}

#[inline(always)]
fn multiply_add_with<L: Lanes, const N: usize>(rounds: u32) -> usize {
    let (factor, term) = (L::splat(black_box(0.999_9)), L::splat(black_box(0.001)));
    let mut x = [L::splat(black_box(1.0)); N];
    for _ in 0..rounds {
        let mut k = 0;
        while k < N {
            x[k] = x[k] * factor + term;
            k += 1;
        }
    }
    keep(x);
    N
}

/// Reads `numbers` in order, `passes` times; returns the number of bytes read.
pub(crate) fn read(path: Path, numbers: &[[f32; WIDTH]], passes: u32) -> u64 {
    match path {
        Path::Portable => read_with::<Portable>(numbers, passes),
        // SAFETY: a path is chosen only on a processor that supports it.
        Path::Avx2 => unsafe { read_avx2(numbers, passes) },
        // SAFETY: as above.
        Path::Avx512 => unsafe { read_avx512(numbers, passes) },
    }
    u64::from(passes) * size_of_val(numbers) as u64
}

#[target_feature(enable = "avx2")]
fn read_avx2(numbers: &[[f32; WIDTH]], passes: u32) {
    read_with::<Avx2>(numbers, passes);
}

#[target_feature(enable = "avx512f")]
fn read_avx512(numbers: &[[f32; WIDTH]], passes: u32) {
    read_with::<Avx512>(numbers, passes);
}

#[inline(always)]
fn read_with<L: Lanes>(numbers: &[[f32; WIDTH]], passes: u32) {
    let mut sum = [L::splat(0.0); 4];
    for _ in 0..passes {
        for four in black_box(numbers).as_chunks::<4>().0 {
            let mut k = 0;
            while k < 4 {
                sum[k] = sum[k] + L::load(&four[k]);
                k += 1;
            }
        }
    }
    keep(sum);
}

/// Prevents the compiler from optimising the numbers away.
#[inline(always)]
fn keep<L: Lanes, const N: usize>(x: [L; N]) {
    let mut lanes = [0.0; WIDTH];
    let mut k = 0;
    while k < N {
        x[k].store(&mut lanes);
        black_box(&mut lanes);
        k += 1;
    }
}
