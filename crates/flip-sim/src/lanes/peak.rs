//! Peak performance of the processor for the kernel's own operations: the two limits of the
//! roofline model (Williams et al. 2009).

use super::{Computation, Lanes, Path, WIDTH};
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
        Path::Avx512 => path.run(MultiplyAdd::<CHAINS_WIDE>(rounds)),
        _ => path.run(MultiplyAdd::<CHAINS>(rounds)),
    };
    2 * u64::from(rounds) * (chains * WIDTH) as u64
}

/// Rounds of so many independent chains; their number is the result.
struct MultiplyAdd<const N: usize>(u32);

impl<const N: usize> Computation for MultiplyAdd<N> {
    type Output = usize;
    #[inline(always)]
    fn with<L: Lanes>(self) -> usize {
        let (factor, term) = (L::splat(black_box(0.999_9)), L::splat(black_box(0.001)));
        let mut x = [L::splat(black_box(1.0)); N];
        for _ in 0..self.0 {
            let mut k = 0;
            while k < N {
                x[k] = x[k] * factor + term;
                k += 1;
            }
        }
        keep(x);
        N
    }
}

/// Reads `numbers` in order, `passes` times; returns the number of bytes read.
pub(crate) fn read(path: Path, numbers: &[[f32; WIDTH]], passes: u32) -> u64 {
    path.run(Read { numbers, passes });
    u64::from(passes) * size_of_val(numbers) as u64
}

struct Read<'a> {
    numbers: &'a [[f32; WIDTH]],
    passes: u32,
}

impl Computation for Read<'_> {
    type Output = ();
    #[inline(always)]
    fn with<L: Lanes>(self) {
        let mut sum = [L::splat(0.0); 4];
        for _ in 0..self.passes {
            for four in black_box(self.numbers).as_chunks::<4>().0 {
                let mut k = 0;
                while k < 4 {
                    sum[k] = sum[k] + L::load(&four[k]);
                    k += 1;
                }
            }
        }
        keep(sum);
    }
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
