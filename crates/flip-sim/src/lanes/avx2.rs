//! Sixteen lanes as two AVX2 registers.

use super::{Add, Computation, Div, Lanes, Mask, Mul, Sub, Vector, WIDTH};
use std::arch::x86_64::*;

/// Computes with AVX2.
#[target_feature(enable = "avx2,popcnt,bmi1,bmi2")]
pub(super) fn run<C: Computation>(computation: C) -> C::Output {
    computation.with::<Avx2>()
}

/// The AVX2 implementation, in two halves. Values of this type are created only in functions that
/// are compiled for AVX2 and entered after checking that the processor supports it
/// ([`super::Path::available`]); this makes the intrinsics below sound.
#[derive(Clone, Copy)]
pub(crate) struct Avx2(__m256, __m256);

/// Lanes in one half.
const HALF: usize = WIDTH / 2;

macro_rules! operators {
    ($($trait:ident $method:ident $intrinsic:ident),*) => {$(
        impl $trait for Avx2 {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                // SAFETY: the processor has AVX2, see the type.
                unsafe { Self($intrinsic(self.0, other.0), $intrinsic(self.1, other.1)) }
            }
        }
    )*};
}
operators!(Add add _mm256_add_ps, Sub sub _mm256_sub_ps, Mul mul _mm256_mul_ps, Div div _mm256_div_ps);

impl Lanes for Avx2 {
    #[inline(always)]
    fn splat(x: f32) -> Self {
        // SAFETY: the processor has AVX2, see the type. The same applies to every function below
        // without its own reason.
        unsafe { Self(_mm256_set1_ps(x), _mm256_set1_ps(x)) }
    }
    #[inline(always)]
    fn load(x: &[f32; WIDTH]) -> Self {
        // SAFETY: the array has sixteen numbers.
        unsafe { Self(_mm256_loadu_ps(x.as_ptr()), _mm256_loadu_ps(x.as_ptr().add(HALF))) }
    }
    #[inline(always)]
    fn store(self, to: &mut [f32; WIDTH]) {
        // SAFETY: the array has room for sixteen numbers.
        unsafe {
            _mm256_storeu_ps(to.as_mut_ptr(), self.0);
            _mm256_storeu_ps(to.as_mut_ptr().add(HALF), self.1);
        }
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: see `splat`.
        unsafe { Self(_mm256_max_ps(self.0, other.0), _mm256_max_ps(self.1, other.1)) }
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: see `splat`.
        unsafe { Self(_mm256_min_ps(self.0, other.0), _mm256_min_ps(self.1, other.1)) }
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: see `splat`.
        unsafe { Self(_mm256_sqrt_ps(self.0), _mm256_sqrt_ps(self.1)) }
    }
    #[inline(always)]
    fn below(self, other: Self) -> Mask {
        // SAFETY: see `splat`.
        unsafe {
            let low = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0));
            let high = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(self.1, other.1));
            (low | high << HALF) as Mask
        }
    }
    #[inline(always)]
    fn select(mask: Mask, yes: Self, no: Self) -> Self {
        let (low, high) = (spread(mask), spread(mask >> HALF));
        // SAFETY: see `splat`.
        unsafe { Self(_mm256_blendv_ps(no.0, yes.0, low), _mm256_blendv_ps(no.1, yes.1, high)) }
    }
    #[inline(always)]
    fn rows(from: &[Vector; WIDTH]) -> [Self; 4] {
        const IN_ORDER: [u32; WIDTH] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];
        // SAFETY: every index is below sixteen, the length of the array.
        unsafe { Self::gather(from, &IN_ORDER) }
    }
    #[inline(always)]
    fn write_rows(components: [Self; 4], to: &mut [Vector; WIDTH]) {
        let [a, b, c, d] = components;
        let (low, high) = (transpose([a.0, b.0, c.0, d.0]), transpose([a.1, b.1, c.1, d.1]));
        // SAFETY: every vector of the array has room for four numbers.
        unsafe {
            for r in 0..4 {
                // Group g of a half's `quads[r]` is its vector 4 g + r.
                _mm_storeu_ps(to[r].as_mut_ptr(), _mm256_castps256_ps128(low[r]));
                _mm_storeu_ps(to[4 + r].as_mut_ptr(), _mm256_extractf128_ps::<1>(low[r]));
                _mm_storeu_ps(to[8 + r].as_mut_ptr(), _mm256_castps256_ps128(high[r]));
                _mm_storeu_ps(to[12 + r].as_mut_ptr(), _mm256_extractf128_ps::<1>(high[r]));
            }
        }
    }
    #[inline(always)]
    unsafe fn gather(from: &[Vector], index: &[u32; WIDTH]) -> [Self; 4] {
        let base = from.as_ptr();
        // SAFETY: the caller guarantees that every index is within `from`.
        unsafe {
            let at = |lane: usize| base.add(index[lane] as usize).cast::<f32>();
            let two = |r: usize| {
                _mm256_insertf128_ps::<1>(
                    _mm256_castps128_ps256(_mm_loadu_ps(at(r))),
                    _mm_loadu_ps(at(4 + r)),
                )
            };
            let [a, b, c, d] = transpose([two(0), two(1), two(2), two(3)]);
            let [e, f, g, h] = transpose([two(8), two(9), two(10), two(11)]);
            [Self(a, e), Self(b, f), Self(c, g), Self(d, h)]
        }
    }
}

/// Expands the low eight bits to a lane mask.
#[inline(always)]
fn spread(mask: Mask) -> __m256 {
    // SAFETY: see `splat`.
    unsafe {
        let bits = _mm256_set_epi32(128, 64, 32, 16, 8, 4, 2, 1);
        let set = _mm256_and_si256(_mm256_set1_epi32(i32::from(mask)), bits);
        _mm256_castsi256_ps(_mm256_cmpeq_epi32(set, bits))
    }
}

/// 4 x 4 transposes within each group of four lanes; its own inverse.
#[inline(always)]
fn transpose(rows: [__m256; 4]) -> [__m256; 4] {
    // SAFETY: see `splat`.
    unsafe {
        let pd = [
            _mm256_castps_pd(_mm256_unpacklo_ps(rows[0], rows[1])),
            _mm256_castps_pd(_mm256_unpackhi_ps(rows[0], rows[1])),
            _mm256_castps_pd(_mm256_unpacklo_ps(rows[2], rows[3])),
            _mm256_castps_pd(_mm256_unpackhi_ps(rows[2], rows[3])),
        ];
        [
            _mm256_castpd_ps(_mm256_unpacklo_pd(pd[0], pd[2])),
            _mm256_castpd_ps(_mm256_unpackhi_pd(pd[0], pd[2])),
            _mm256_castpd_ps(_mm256_unpacklo_pd(pd[1], pd[3])),
            _mm256_castpd_ps(_mm256_unpackhi_pd(pd[1], pd[3])),
        ]
    }
}
