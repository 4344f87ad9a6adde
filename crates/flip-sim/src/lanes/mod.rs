//! Sixteen grains at a time: the only processor-specific module.
//!
//! Every operation is an IEEE operation on each lane separately: no fused multiply-add, no
//! approximate reciprocal. The portable path and the wider ones therefore give the same bits on
//! every x86-64 machine; `FLIP_SIMD=portable` and `FLIP_SIMD=avx2` force one.
#![allow(unsafe_code)] // Processor intrinsics; every block says why it is sound.
#![allow(clippy::inline_always)] // A function that is not inlined into its `target_feature` caller is compiled without the feature.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod counting;
pub(super) mod peak;
mod portable;

pub use counting::Work;
pub(super) use counting::{Counting, counted};

use super::constraints::Vector;
pub(super) use portable::Portable;
use std::ops::{Add, Div, Mul, Sub};
use std::sync::OnceLock;

/// Grains in a block.
pub(super) const WIDTH: usize = 16;
/// One bit for each lane.
pub(super) type Mask = u16;

/// Sixteen numbers.
pub(super) trait Lanes:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// Sets every lane to the same number.
    fn splat(x: f32) -> Self;
    /// Loads from memory.
    fn load(x: &[f32; WIDTH]) -> Self;
    /// Stores to memory.
    fn store(self, to: &mut [f32; WIDTH]);
    /// `self > other ? self : other`, lane by lane: `other` if `self` is NaN.
    fn max(self, other: Self) -> Self;
    /// `self < other ? self : other`, lane by lane.
    fn min(self, other: Self) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Mask of the lanes in which `self < other`.
    fn below(self, other: Self) -> Mask;
    /// Selects `yes` where the bit is set, otherwise `no`.
    fn select(mask: Mask, yes: Self, no: Self) -> Self;
    /// Loads sixteen vectors by component.
    fn rows(from: &[Vector; WIDTH]) -> [Self; 4];
    /// The reverse of [`Lanes::rows`].
    fn write_rows(components: [Self; 4], to: &mut [Vector; WIDTH]);
    /// Gathers the vectors at these places by component.
    ///
    /// # Safety
    /// Every index is below `from.len()`.
    unsafe fn gather(from: &[Vector], index: &[u32; WIDTH]) -> [Self; 4];
    /// Adds the vectors to those at these places, lane after lane.
    ///
    /// # Safety
    /// Every index is below `to.len()`.
    #[inline(always)]
    unsafe fn scatter(components: [Self; 4], to: &mut [Vector], index: &[u32; WIDTH]) {
        let mut vectors = [[0.0; 4]; WIDTH];
        Self::write_rows(components, &mut vectors);
        for lane in 0..WIDTH {
            // SAFETY: the caller guarantees that every index is within `to`.
            let sum = unsafe { to.get_unchecked_mut(index[lane] as usize) };
            *sum = plus(*sum, vectors[lane]);
        }
    }
    /// Adds the first three components at the first places and subtracts them at the second, lane
    /// after lane; the fourth is added at both.
    ///
    /// # Safety
    /// Every index is below `to.len()`.
    #[inline(always)]
    unsafe fn exchange(
        components: [Self; 4],
        to: &mut [Vector],
        first: &[u32; WIDTH],
        second: &[u32; WIDTH],
    ) {
        let mut vectors = [[0.0; 4]; WIDTH];
        Self::write_rows(components, &mut vectors);
        for lane in 0..WIDTH {
            let [x, y, z, w] = vectors[lane];
            // SAFETY: the caller guarantees that every index is within `to`.
            unsafe {
                let sum = to.get_unchecked_mut(first[lane] as usize);
                *sum = plus(*sum, [x, y, z, w]);
                let sum = to.get_unchecked_mut(second[lane] as usize);
                *sum = plus(*sum, [-x, -y, -z, w]);
            }
        }
    }
    /// Writes `first + lane` for every set bit to `to[at..]` and returns the place after the last.
    /// The sixteen places after `at` may be overwritten.
    ///
    /// # Panics
    /// If `to` has fewer than sixteen places after `at`.
    #[inline(always)]
    fn append(mask: Mask, first: u32, to: &mut [u32], mut at: usize) -> usize {
        let mut left = mask;
        while left != 0 {
            to[at] = first + left.trailing_zeros();
            at += 1;
            left &= left - 1;
        }
        at
    }
}

#[inline(always)]
fn plus(a: Vector, b: Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]]
}

/// Sixteen consecutive vectors.
#[inline(always)]
pub(super) fn block(from: &[Vector], b: usize) -> &[Vector; WIDTH] {
    from[b * WIDTH..(b + 1) * WIDTH].try_into().expect("the slice has the width of a block")
}

/// Sixteen consecutive vectors, mutable.
#[inline(always)]
pub(super) fn block_mut(from: &mut [Vector], b: usize) -> &mut [Vector; WIDTH] {
    (&mut from[b * WIDTH..(b + 1) * WIDTH]).try_into().expect("the slice has the width of a block")
}

/// A computation that is written once for lanes of every kind.
pub(super) trait Computation {
    /// Its result.
    type Output;
    /// Computes with these lanes; to be inlined, so that it is compiled for a path's features.
    fn with<L: Lanes>(self) -> Self::Output;
}

/// The implementation in use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Path {
    /// Any processor.
    Portable,
    /// AVX2.
    Avx2,
    /// AVX-512F.
    Avx512,
}

impl Path {
    /// All paths, narrowest first, and whether this processor supports them.
    fn all() -> [(&'static str, Self, bool); 3] {
        #[cfg(target_arch = "x86_64")]
        let (avx2, avx512) = {
            use std::arch::is_x86_feature_detected;
            // Every processor with AVX2 has these; without them the compiler counts the bits of a
            // mask ten times more slowly.
            let bits = is_x86_feature_detected!("popcnt")
                && is_x86_feature_detected!("bmi1")
                && is_x86_feature_detected!("bmi2");
            (bits && is_x86_feature_detected!("avx2"), bits && is_x86_feature_detected!("avx512f"))
        };
        #[cfg(not(target_arch = "x86_64"))]
        let (avx2, avx512) = (false, false);
        [
            ("portable", Self::Portable, true),
            ("avx2", Self::Avx2, avx2),
            ("avx512", Self::Avx512, avx512),
        ]
    }

    /// Computes on this path.
    #[inline]
    pub(super) fn run<C: Computation>(self, computation: C) -> C::Output {
        match self {
            // SAFETY: a path is chosen only on a processor that supports it.
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => unsafe { avx2::run(computation) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => unsafe { avx512::run(computation) },
            _ => computation.with::<Portable>(),
        }
    }

    /// The name used by `FLIP_SIMD`.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
        }
    }

    /// The paths supported by this processor, narrowest first.
    pub(super) fn available() -> impl Iterator<Item = Self> {
        Self::all().into_iter().filter(|(.., has)| *has).map(|(_, path, _)| path)
    }

    /// The path named by `FLIP_SIMD` if this processor supports it, otherwise the widest.
    pub(super) fn best() -> Self {
        static BEST: OnceLock<Path> = OnceLock::new();
        *BEST.get_or_init(|| {
            let forced = std::env::var("FLIP_SIMD").unwrap_or_default();
            let named = Self::all()
                .into_iter()
                .find(|(name, _, has)| *has && *name == forced)
                .map(|(_, path, _)| path);
            named.or(Self::available().last()).unwrap_or(Self::Portable)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_core::domain::seed::derive;

    /// Numbers of every size and sign, some equal, some zero.
    fn numbers(seed: u64) -> [f32; WIDTH] {
        std::array::from_fn(|l| match derive(seed, &[l as u64]) % 7 {
            0 => 0.0,
            1 => 1.0,
            k => {
                (derive(seed, &[l as u64, 1]) as f32 / 2f32.powi(63) - 1.0)
                    * 10f32.powi(3 - k as i32)
            }
        })
    }

    /// Every operation of `L` on the same numbers, as bits.
    #[inline(always)]
    fn everything<L: Lanes>(seed: u64) -> Vec<u32> {
        let (a, b) = (numbers(seed), numbers(seed + 1000));
        let (x, y) = (L::load(&a), L::load(&b));
        let mut out = Vec::new();
        let mut tell = |x: L| {
            let mut lanes = [0.0; WIDTH];
            x.store(&mut lanes);
            out.extend(lanes.map(f32::to_bits));
        };
        let half = L::splat(0.5);
        for result in [x + y, x - y, x * y, x / (y * y + half), x.max(y), x.min(y), (x * x).sqrt()]
        {
            tell(result);
        }
        let mask = x.below(y);
        tell(L::select(mask, x, y));
        let vectors: Vec<Vector> =
            (0..40).map(|k| std::array::from_fn(|c| a[(k + c) % WIDTH] + k as f32)).collect();
        let index = std::array::from_fn(|l| (derive(seed, &[7, l as u64]) % 40) as u32);
        // SAFETY: the indices are below forty.
        let gathered = unsafe { L::gather(&vectors, &index) };
        gathered.into_iter().chain(L::rows(block(&vectors, 1))).for_each(&mut tell);
        let mut written = [[0.0; 4]; WIDTH];
        L::write_rows(gathered, &mut written);
        assert_eq!(written, index.map(|i| vectors[i as usize]));
        // Repeated places, within one call and between both.
        let mut sums = vectors.clone();
        let first = std::array::from_fn(|l| (derive(seed, &[8, l as u64]) % 5) as u32);
        // SAFETY: the indices are below forty.
        unsafe {
            L::exchange(gathered, &mut sums, &first, &index);
            L::scatter(gathered, &mut sums, &first);
        }
        out.extend(sums.iter().flatten().map(|x| x.to_bits()));
        let mut list = [0; 2 * WIDTH];
        let end = L::append(mask, 5, &mut list, 3);
        out.extend(&list[3..end]);
        out.push(u32::from(mask));
        out
    }

    struct Everything(u64);

    impl Computation for Everything {
        type Output = Vec<u32>;
        #[inline(always)]
        fn with<L: Lanes>(self) -> Vec<u32> {
            everything::<L>(self.0)
        }
    }

    #[test]
    fn every_path_gives_the_same_bits() {
        for path in Path::available().skip(1) {
            for seed in 0..200 {
                let wide = path.run(Everything(seed));
                assert_eq!(everything::<Portable>(seed), wide, "{path:?}, seed {seed}");
            }
        }
        if Path::available().count() == 1 {
            println!(
                "skipped: this processor has neither AVX2 nor AVX-512F, so there is only the portable path"
            );
        }
    }

    #[test]
    fn what_is_exchanged_is_taken_from_one_and_given_to_the_other() {
        let components = [1.0, 2.0, 3.0, 1.0].map(Portable::splat);
        let mut first = [2; WIDTH];
        first[0] = 0;
        let mut sums = [[0.0; 4]; 3];
        // SAFETY: the indices are below three.
        unsafe { Portable::exchange(components, &mut sums, &first, &[1; WIDTH]) };
        assert_eq!(
            sums,
            [[1.0, 2.0, 3.0, 1.0], [-16.0, -32.0, -48.0, 16.0], [15.0, 30.0, 45.0, 15.0]]
        );
    }

    #[test]
    fn append_writes_the_lanes_of_the_set_bits() {
        let mut list = [0; WIDTH + 2];
        assert_eq!(Portable::append(0b1000_0000_0000_0101, 10, &mut list, 2), 5);
        assert_eq!(list[2..5], [10, 12, 25]);
    }
}
