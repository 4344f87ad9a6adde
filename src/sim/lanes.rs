//! Sixteen grains at once: the one place that knows the processor.
//!
//! Every operation is an IEEE operation on each lane by itself: no fused multiply-add, no approximate reciprocal. So the portable
//! path and the AVX-512 path give the same bits, on every x86-64 machine; `FLIP_SIMD=portable` forces the first.
#![allow(unsafe_code)] // Processor intrinsics; every block says why it is sound.
#![allow(clippy::inline_always)] // A function that is not inlined into its `target_feature` caller is compiled without the feature.

use super::constraints::Vector;
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
    /// The same number in every lane.
    fn splat(x: f32) -> Self;
    /// From memory.
    fn load(x: &[f32; WIDTH]) -> Self;
    /// To memory.
    fn store(self, to: &mut [f32; WIDTH]);
    /// `self > other ? self : other`, lane by lane: the other one when `self` is no number.
    fn max(self, other: Self) -> Self;
    /// `self < other ? self : other`, lane by lane.
    fn min(self, other: Self) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Lanes in which `self < other`.
    fn below(self, other: Self) -> Mask;
    /// `yes` where the bit is set.
    fn select(mask: Mask, yes: Self, no: Self) -> Self;
    /// Sixteen vectors by their components.
    fn rows(from: &[Vector; WIDTH]) -> [Self; 4];
    /// The reverse of [`Lanes::rows`].
    fn write_rows(components: [Self; 4], to: &mut [Vector; WIDTH]);
    /// The vectors at these places, by their components.
    ///
    /// # Safety
    /// Every index is below `from.len()`.
    unsafe fn gather(from: &[Vector], index: &[u32; WIDTH]) -> [Self; 4];
    /// Write `first + lane` for every set bit to `to[at..]` and return the place after the last. The sixteen places after `at` may be
    /// overwritten.
    ///
    /// # Panics
    /// If `to` has fewer than sixteen places after `at`.
    fn append(mask: Mask, first: u32, to: &mut [u32], at: usize) -> usize;
}

/// Sixteen consecutive vectors.
#[inline(always)]
pub(super) fn block(from: &[Vector], b: usize) -> &[Vector; WIDTH] {
    from[b * WIDTH..(b + 1) * WIDTH].try_into().expect("the slice has the width of a block")
}

/// Sixteen consecutive vectors, to write to.
#[inline(always)]
pub(super) fn block_mut(from: &mut [Vector], b: usize) -> &mut [Vector; WIDTH] {
    (&mut from[b * WIDTH..(b + 1) * WIDTH]).try_into().expect("the slice has the width of a block")
}

/// Which implementation runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Path {
    /// Any processor.
    Portable,
    /// AVX-512F.
    Avx512,
}

impl Path {
    /// The widest that this processor has, or the portable one when `FLIP_SIMD` is `portable`.
    pub(super) fn best() -> Self {
        static BEST: OnceLock<Path> = OnceLock::new();
        *BEST.get_or_init(|| {
            let forced = std::env::var_os("FLIP_SIMD").is_some_and(|value| value == "portable");
            if !forced && std::arch::is_x86_feature_detected!("avx512f") { Self::Avx512 } else { Self::Portable }
        })
    }
}

/// The portable implementation.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub(super) struct Portable([f32; WIDTH]);

impl Portable {
    #[inline(always)]
    fn each(mut value: impl FnMut(usize) -> f32) -> Self {
        let mut out = [0.0; WIDTH];
        for (lane, out) in out.iter_mut().enumerate() {
            *out = value(lane);
        }
        Self(out)
    }
}

macro_rules! portable {
    ($($trait:ident $method:ident $operator:tt),*) => {$(
        impl $trait for Portable {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self::each(|l| self.0[l] $operator other.0[l])
            }
        }
    )*};
}
portable!(Add add +, Sub sub -, Mul mul *, Div div /);

impl Lanes for Portable {
    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self([x; WIDTH])
    }
    #[inline(always)]
    fn load(x: &[f32; WIDTH]) -> Self {
        Self(*x)
    }
    #[inline(always)]
    fn store(self, to: &mut [f32; WIDTH]) {
        *to = self.0;
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self::each(|l| if self.0[l] > other.0[l] { self.0[l] } else { other.0[l] })
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self::each(|l| if self.0[l] < other.0[l] { self.0[l] } else { other.0[l] })
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self::each(|l| self.0[l].sqrt())
    }
    #[inline(always)]
    fn below(self, other: Self) -> Mask {
        (0..WIDTH).fold(0, |mask, l| mask | (Mask::from(self.0[l] < other.0[l]) << l))
    }
    #[inline(always)]
    fn select(mask: Mask, yes: Self, no: Self) -> Self {
        Self::each(|l| if mask >> l & 1 == 1 { yes.0[l] } else { no.0[l] })
    }
    #[inline(always)]
    fn rows(from: &[Vector; WIDTH]) -> [Self; 4] {
        [0, 1, 2, 3].map(|k| Self::each(|l| from[l][k]))
    }
    #[inline(always)]
    fn write_rows(components: [Self; 4], to: &mut [Vector; WIDTH]) {
        for (l, to) in to.iter_mut().enumerate() {
            *to = components.map(|component| component.0[l]);
        }
    }
    #[inline(always)]
    unsafe fn gather(from: &[Vector], index: &[u32; WIDTH]) -> [Self; 4] {
        Self::rows(&index.map(|i| from[i as usize]))
    }
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

pub(super) use wide::Avx512;

mod wide {
    use super::{Add, Div, Lanes, Mask, Mul, Sub, Vector, WIDTH};
    use std::arch::x86_64::*;

    /// The AVX-512F implementation. Values of this type come to be only in functions that are compiled for AVX-512F and entered after
    /// the processor was asked for it ([`super::Path::best`]): this is what makes the intrinsics below sound.
    #[derive(Clone, Copy)]
    pub(in crate::sim) struct Avx512(__m512);

    macro_rules! operators {
        ($($trait:ident $method:ident $intrinsic:ident),*) => {$(
            impl $trait for Avx512 {
                type Output = Self;
                #[inline(always)]
                fn $method(self, other: Self) -> Self {
                    // SAFETY: the processor has AVX-512F, see the type.
                    Self(unsafe { $intrinsic(self.0, other.0) })
                }
            }
        )*};
    }
    operators!(Add add _mm512_add_ps, Sub sub _mm512_sub_ps, Mul mul _mm512_mul_ps, Div div _mm512_div_ps);

    impl Lanes for Avx512 {
        #[inline(always)]
        fn splat(x: f32) -> Self {
            // SAFETY: the processor has AVX-512F, see the type. So in every function below that says nothing more.
            Self(unsafe { _mm512_set1_ps(x) })
        }
        #[inline(always)]
        fn load(x: &[f32; WIDTH]) -> Self {
            // SAFETY: the array has sixteen numbers.
            Self(unsafe { _mm512_loadu_ps(x.as_ptr()) })
        }
        #[inline(always)]
        fn store(self, to: &mut [f32; WIDTH]) {
            // SAFETY: the array has room for sixteen numbers.
            unsafe { _mm512_storeu_ps(to.as_mut_ptr(), self.0) }
        }
        #[inline(always)]
        fn max(self, other: Self) -> Self {
            // SAFETY: see `splat`.
            Self(unsafe { _mm512_max_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn min(self, other: Self) -> Self {
            // SAFETY: see `splat`.
            Self(unsafe { _mm512_min_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            // SAFETY: see `splat`.
            Self(unsafe { _mm512_sqrt_ps(self.0) })
        }
        #[inline(always)]
        fn below(self, other: Self) -> Mask {
            // SAFETY: see `splat`.
            unsafe { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) }
        }
        #[inline(always)]
        fn select(mask: Mask, yes: Self, no: Self) -> Self {
            // SAFETY: see `splat`.
            Self(unsafe { _mm512_mask_blend_ps(mask, no.0, yes.0) })
        }
        #[inline(always)]
        fn rows(from: &[Vector; WIDTH]) -> [Self; 4] {
            const IN_ORDER: [u32; WIDTH] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];
            // SAFETY: every index is below sixteen, the length of the array.
            unsafe { Self::gather(from, &IN_ORDER) }
        }
        #[inline(always)]
        fn write_rows(components: [Self; 4], to: &mut [Vector; WIDTH]) {
            let quads = transpose(components.map(|component| component.0));
            // SAFETY: every vector of the array has room for four numbers.
            unsafe {
                for r in 0..4 {
                    // Group g of `quads[r]` is vector 4 g + r.
                    let quad = quads[r].0;
                    _mm_storeu_ps(to[r].as_mut_ptr(), _mm512_castps512_ps128(quad));
                    _mm_storeu_ps(to[4 + r].as_mut_ptr(), _mm512_extractf32x4_ps::<1>(quad));
                    _mm_storeu_ps(to[8 + r].as_mut_ptr(), _mm512_extractf32x4_ps::<2>(quad));
                    _mm_storeu_ps(to[12 + r].as_mut_ptr(), _mm512_extractf32x4_ps::<3>(quad));
                }
            }
        }
        #[inline(always)]
        unsafe fn gather(from: &[Vector], index: &[u32; WIDTH]) -> [Self; 4] {
            let base = from.as_ptr();
            // SAFETY: the caller promises that every index is within `from`.
            unsafe {
                let at = |lane: usize| base.add(index[lane] as usize).cast::<f32>();
                let four = |r: usize| {
                    let groups = _mm512_castps128_ps512(_mm_loadu_ps(at(r)));
                    let groups = _mm512_insertf32x4::<1>(groups, _mm_loadu_ps(at(4 + r)));
                    let groups = _mm512_insertf32x4::<2>(groups, _mm_loadu_ps(at(8 + r)));
                    _mm512_insertf32x4::<3>(groups, _mm_loadu_ps(at(12 + r)))
                };
                transpose([four(0), four(1), four(2), four(3)])
            }
        }
        #[inline(always)]
        fn append(mask: Mask, first: u32, to: &mut [u32], at: usize) -> usize {
            let to: &mut [u32] = &mut to[at..at + WIDTH];
            // SAFETY: the slice has room for sixteen numbers.
            unsafe {
                let lanes = _mm512_set_epi32(15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0);
                let index = _mm512_add_epi32(_mm512_set1_epi32(first.cast_signed()), lanes);
                _mm512_storeu_si512(to.as_mut_ptr().cast(), _mm512_maskz_compress_epi32(mask, index));
            }
            at + mask.count_ones() as usize
        }
    }

    /// 4 x 4 transposes within each group of four lanes; its own inverse.
    #[inline(always)]
    fn transpose(rows: [__m512; 4]) -> [Avx512; 4] {
        // SAFETY: see `splat`.
        unsafe {
            let low = [_mm512_unpacklo_ps(rows[0], rows[1]), _mm512_unpacklo_ps(rows[2], rows[3])];
            let high = [_mm512_unpackhi_ps(rows[0], rows[1]), _mm512_unpackhi_ps(rows[2], rows[3])];
            let [low, high] = [low.map(|x| _mm512_castps_pd(x)), high.map(|x| _mm512_castps_pd(x))];
            [
                Avx512(_mm512_castpd_ps(_mm512_unpacklo_pd(low[0], low[1]))),
                Avx512(_mm512_castpd_ps(_mm512_unpackhi_pd(low[0], low[1]))),
                Avx512(_mm512_castpd_ps(_mm512_unpacklo_pd(high[0], high[1]))),
                Avx512(_mm512_castpd_ps(_mm512_unpackhi_pd(high[0], high[1]))),
            ]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::seed::derive;

    /// Numbers of every size and sign, some equal, some zero.
    fn numbers(seed: u64) -> [f32; WIDTH] {
        std::array::from_fn(|l| match derive(seed, &[l as u64]) % 7 {
            0 => 0.0,
            1 => 1.0,
            k => (derive(seed, &[l as u64, 1]) as f32 / 2f32.powi(63) - 1.0) * 10f32.powi(3 - k as i32),
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
        for result in [x + y, x - y, x * y, x / (y * y + half), x.max(y), x.min(y), (x * x).sqrt()] {
            tell(result);
        }
        let mask = x.below(y);
        tell(L::select(mask, x, y));
        let vectors: Vec<Vector> = (0..40).map(|k| std::array::from_fn(|c| a[(k + c) % WIDTH] + k as f32)).collect();
        let index = std::array::from_fn(|l| (derive(seed, &[7, l as u64]) % 40) as u32);
        // SAFETY: the indices are below forty.
        let gathered = unsafe { L::gather(&vectors, &index) };
        gathered.into_iter().chain(L::rows(block(&vectors, 1))).for_each(&mut tell);
        let mut written = [[0.0; 4]; WIDTH];
        L::write_rows(gathered, &mut written);
        assert_eq!(written, index.map(|i| vectors[i as usize]));
        let mut list = [0; 2 * WIDTH];
        let end = L::append(mask, 5, &mut list, 3);
        out.extend(&list[3..end]);
        out.push(u32::from(mask));
        out
    }

    #[target_feature(enable = "avx512f")]
    fn everything_wide(seed: u64) -> Vec<u32> {
        everything::<Avx512>(seed)
    }

    #[test]
    fn both_paths_give_the_same_bits() {
        if !std::arch::is_x86_feature_detected!("avx512f") {
            println!("skipped: this processor has no AVX-512F, so there is only the portable path");
            return;
        }
        for seed in 0..200 {
            // SAFETY: the processor was asked.
            assert_eq!(everything::<Portable>(seed), unsafe { everything_wide(seed) });
        }
    }

    #[test]
    fn append_writes_the_lanes_of_the_set_bits() {
        let mut list = [0; WIDTH + 2];
        assert_eq!(Portable::append(0b1000_0000_0000_0101, 10, &mut list, 2), 5);
        assert_eq!(list[2..5], [10, 12, 25]);
    }
}
