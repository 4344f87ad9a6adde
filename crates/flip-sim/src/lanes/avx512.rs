//! Sixteen lanes as one AVX-512 register.

use super::{Add, Computation, Div, Lanes, Mask, Mul, Sub, Vector, WIDTH};
use std::arch::x86_64::*;

/// Computes with AVX-512F.
#[target_feature(enable = "avx512f,popcnt,bmi1,bmi2")]
pub(super) fn run<C: Computation>(computation: C) -> C::Output {
    computation.with::<Avx512>()
}

/// The AVX-512F implementation. Values of this type are created only in functions that are compiled
/// for AVX-512F and entered after checking that the processor supports it
/// ([`super::Path::available`]); this makes the intrinsics below sound.
#[derive(Clone, Copy)]
pub(crate) struct Avx512(__m512);

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
        // SAFETY: the processor has AVX-512F, see the type. The same applies to every function
        // below without its own reason.
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
        // SAFETY: the caller guarantees that every index is within `from`.
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
    unsafe fn exchange(
        components: [Self; 4],
        to: &mut [Vector],
        first: &[u32; WIDTH],
        second: &[u32; WIDTH],
    ) {
        let quads = transpose(components.map(|component| component.0));
        let base = to.as_mut_ptr();
        // SAFETY: the caller guarantees that every index is within `to`; `vectors` has four quads
        // of sixteen numbers.
        unsafe {
            // Goes through memory, which does not occupy the arithmetic units.
            let mut vectors = [Self::splat(0.0); 4];
            for r in 0..4 {
                std::ptr::write_volatile(&raw mut vectors[r], quads[r]);
            }
            let vectors = (&raw const vectors).cast::<Vector>();
            let minus = _mm_setr_ps(-0.0, -0.0, -0.0, 0.0);
            for g in 0..4 {
                for r in 0..4 {
                    // Group g of `quads[r]` is vector 4 g + r.
                    let (lane, vector) = (4 * g + r, _mm_loadu_ps(vectors.add(4 * r + g).cast()));
                    let sum = base.add(first[lane] as usize).cast::<f32>();
                    _mm_storeu_ps(sum, _mm_add_ps(_mm_loadu_ps(sum), vector));
                    let sum = base.add(second[lane] as usize).cast::<f32>();
                    _mm_storeu_ps(sum, _mm_add_ps(_mm_loadu_ps(sum), _mm_xor_ps(vector, minus)));
                }
            }
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
