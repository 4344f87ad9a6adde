//! Sixteen numbers at a time, on whatever the processor has.
//!
//! Every operation is an IEEE operation on each lane separately, the fused multiply-add among them,
//! so every path gives the same bits. `FLIP_SIMD=portable` and `FLIP_SIMD=avx2` force one, as in the
//! simulator. A processor without fused multiply-add (before 2013) computes it in software, which is
//! a hundred times slower and equal.
#![allow(unsafe_code)] // Processor intrinsics; every block says why it is sound.
#![allow(clippy::inline_always)] // A function that is not inlined into its `target_feature` caller is compiled without the feature.

use std::sync::OnceLock;

/// Numbers in a vector.
pub(super) const WIDTH: usize = 16;

/// Sixteen numbers.
pub(super) trait Lanes: Copy {
    /// Whether a vector is one register, of which there are thirty-two.
    const WIDE: bool;
    /// Sets every lane to the same number.
    fn splat(x: f32) -> Self;
    /// Loads from memory.
    fn load(x: &[f32; WIDTH]) -> Self;
    /// Stores to memory.
    fn store(self, to: &mut [f32; WIDTH]);
    /// Sum.
    fn plus(self, other: Self) -> Self;
    /// Difference.
    fn minus(self, other: Self) -> Self;
    /// Product.
    fn times(self, other: Self) -> Self;
    /// Quotient.
    fn over(self, other: Self) -> Self;
    /// `self * by + plus`, rounded once.
    fn times_plus(self, by: Self, plus: Self) -> Self;
    /// `self > other ? self : other`: `other` if either is NaN.
    fn max(self, other: Self) -> Self;
    /// `self < other ? self : other`: `other` if either is NaN.
    fn min(self, other: Self) -> Self;
    /// Square root.
    fn root(self) -> Self;
    /// Nearest integer, ties to even.
    fn rounded(self) -> Self;
    /// Two to the power of an integer from -126 to 127.
    fn power_of_two(self) -> Self;
    /// `self < other ? yes : no`.
    fn if_below(self, other: Self, yes: Self, no: Self) -> Self;
    /// Sixteen vectors with rows and columns exchanged.
    #[inline(always)]
    fn turned(rows: [Self; WIDTH]) -> [Self; WIDTH] {
        let mut stored = [[0.0; WIDTH]; WIDTH];
        for (row, to) in rows.iter().zip(&mut stored) {
            row.store(to);
        }
        let mut out = rows;
        for (j, out) in out.iter_mut().enumerate() {
            let mut column = [0.0; WIDTH];
            for (number, row) in column.iter_mut().zip(&stored) {
                *number = row[j];
            }
            *out = Self::load(&column);
        }
        out
    }
}

/// A computation that is written once for lanes of every kind.
pub(super) trait Task {
    /// Computes with these lanes; to be inlined, so that it is compiled for a path's features.
    fn with<L: Lanes>(self);
}

/// The implementation in use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Path {
    /// Any processor.
    Portable,
    /// AVX2 and fused multiply-add.
    Avx2,
    /// AVX-512F.
    Avx512,
}

impl Path {
    /// Name of each path for `FLIP_SIMD`, and whether this processor has it; narrowest first.
    fn all() -> [(&'static str, Self, bool); 3] {
        #[cfg(target_arch = "x86_64")]
        let has = {
            use std::arch::is_x86_feature_detected as has;
            let fused = has!("avx2") && has!("fma");
            (fused, fused && has!("avx512f"))
        };
        #[cfg(not(target_arch = "x86_64"))]
        let has = (false, false);
        [
            ("portable", Self::Portable, true),
            ("avx2", Self::Avx2, has.0),
            ("avx512", Self::Avx512, has.1),
        ]
    }

    /// The paths of this processor.
    pub(super) fn available() -> impl DoubleEndedIterator<Item = (&'static str, Self)> {
        Self::all().into_iter().filter(|(.., has)| *has).map(|(name, path, _)| (name, path))
    }

    /// The path that `FLIP_SIMD` names if this processor has it, otherwise the widest.
    pub(super) fn best() -> Self {
        static BEST: OnceLock<Path> = OnceLock::new();
        *BEST.get_or_init(|| {
            let forced = std::env::var("FLIP_SIMD").unwrap_or_default();
            let named = Self::available().find(|(name, _)| *name == forced);
            named.or(Self::available().next_back()).map_or(Self::Portable, |(_, path)| path)
        })
    }

    /// Computes on this path.
    pub(super) fn run(self, task: impl Task) {
        match self {
            // SAFETY: a path is chosen only on a processor that has it.
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => unsafe { x86::on_avx2(task) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => unsafe { x86::on_avx512(task) },
            _ => task.with::<Portable>(),
        }
    }

    /// Vectors in a row of a product's panel ([`super::product`]).
    pub(super) fn vectors(self) -> usize {
        if self == Self::Avx512 { 2 } else { 1 }
    }
}

/// Any processor.
#[derive(Clone, Copy)]
pub(super) struct Portable([f32; WIDTH]);

impl Portable {
    #[inline(always)]
    fn each(self, other: Self, of: impl Fn(f32, f32) -> f32) -> Self {
        let mut out = self.0;
        for (l, out) in out.iter_mut().enumerate() {
            *out = of(self.0[l], other.0[l]);
        }
        Self(out)
    }
}

impl Lanes for Portable {
    const WIDE: bool = false;
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
    fn plus(self, other: Self) -> Self {
        self.each(other, |a, b| a + b)
    }
    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        self.each(other, |a, b| a - b)
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        self.each(other, |a, b| a * b)
    }
    #[inline(always)]
    fn over(self, other: Self) -> Self {
        self.each(other, |a, b| a / b)
    }
    #[inline(always)]
    fn times_plus(self, by: Self, plus: Self) -> Self {
        let mut out = self.0;
        for (l, out) in out.iter_mut().enumerate() {
            *out = self.0[l].mul_add(by.0[l], plus.0[l]);
        }
        Self(out)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.each(other, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.each(other, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn root(self) -> Self {
        self.each(self, |a, _| a.sqrt())
    }
    #[inline(always)]
    fn rounded(self) -> Self {
        self.each(self, |a, _| a.round_ties_even())
    }
    #[inline(always)]
    fn power_of_two(self) -> Self {
        self.each(self, |a, _| f32::from_bits(((a as i32 + 127) << 23) as u32))
    }
    #[inline(always)]
    fn if_below(self, other: Self, yes: Self, no: Self) -> Self {
        let mut out = no.0;
        for (l, out) in out.iter_mut().enumerate() {
            *out = if self.0[l] < other.0[l] { yes.0[l] } else { no.0[l] };
        }
        Self(out)
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{Lanes, Task, WIDTH};
    use std::arch::x86_64::*;

    /// Computes with AVX2.
    #[target_feature(enable = "avx2,fma")]
    pub(super) fn on_avx2(task: impl Task) {
        task.with::<Avx2>();
    }

    /// Computes with AVX-512F.
    #[target_feature(enable = "avx2,fma,avx512f")]
    pub(super) fn on_avx512(task: impl Task) {
        task.with::<Avx512>();
    }

    /// Two registers. Values of this type and of the next are made only in functions that were
    /// entered after a check that the processor has their instructions; that makes the intrinsics
    /// below sound.
    #[derive(Clone, Copy)]
    pub(super) struct Avx2(__m256, __m256);
    /// One register.
    #[derive(Clone, Copy)]
    pub(super) struct Avx512(__m512);

    /// Operations on pairs of lanes, under their names for both.
    macro_rules! pairs {
        ($($name:ident $two:ident $one:ident),*) => {
            impl Avx2 {$(
                #[inline(always)]
                fn $name(self, other: Self) -> Self {
                    // SAFETY: the processor has AVX2, see the type.
                    unsafe { Self($two(self.0, other.0), $two(self.1, other.1)) }
                }
            )*}
            impl Avx512 {$(
                #[inline(always)]
                fn $name(self, other: Self) -> Self {
                    // SAFETY: the processor has AVX-512F, see the type.
                    unsafe { Self($one(self.0, other.0)) }
                }
            )*}
        };
    }
    pairs!(sum _mm256_add_ps _mm512_add_ps, difference _mm256_sub_ps _mm512_sub_ps,
        product _mm256_mul_ps _mm512_mul_ps, quotient _mm256_div_ps _mm512_div_ps,
        larger _mm256_max_ps _mm512_max_ps, smaller _mm256_min_ps _mm512_min_ps);

    /// The operations that both have under the names above.
    macro_rules! named {
        () => {
            #[inline(always)]
            fn plus(self, other: Self) -> Self {
                self.sum(other)
            }
            #[inline(always)]
            fn minus(self, other: Self) -> Self {
                self.difference(other)
            }
            #[inline(always)]
            fn times(self, other: Self) -> Self {
                self.product(other)
            }
            #[inline(always)]
            fn over(self, other: Self) -> Self {
                self.quotient(other)
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                self.larger(other)
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                self.smaller(other)
            }
        };
    }

    // SAFETY of every block in both: the processor has the instructions, see the types; arrays have
    // sixteen numbers.
    impl Lanes for Avx2 {
        const WIDE: bool = false;
        named!();
        #[inline(always)]
        fn splat(x: f32) -> Self {
            // SAFETY: see above.
            unsafe { Self(_mm256_set1_ps(x), _mm256_set1_ps(x)) }
        }
        #[inline(always)]
        fn load(x: &[f32; WIDTH]) -> Self {
            // SAFETY: see above.
            unsafe { Self(_mm256_loadu_ps(x.as_ptr()), _mm256_loadu_ps(x.as_ptr().add(8))) }
        }
        #[inline(always)]
        fn store(self, to: &mut [f32; WIDTH]) {
            // SAFETY: see above.
            unsafe {
                _mm256_storeu_ps(to.as_mut_ptr(), self.0);
                _mm256_storeu_ps(to.as_mut_ptr().add(8), self.1);
            }
        }
        #[inline(always)]
        fn times_plus(self, by: Self, plus: Self) -> Self {
            // SAFETY: see above.
            unsafe {
                Self(_mm256_fmadd_ps(self.0, by.0, plus.0), _mm256_fmadd_ps(self.1, by.1, plus.1))
            }
        }
        #[inline(always)]
        fn root(self) -> Self {
            // SAFETY: see above.
            unsafe { Self(_mm256_sqrt_ps(self.0), _mm256_sqrt_ps(self.1)) }
        }
        #[inline(always)]
        fn rounded(self) -> Self {
            const NEAREST: i32 = _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC;
            // SAFETY: see above.
            unsafe { Self(_mm256_round_ps::<NEAREST>(self.0), _mm256_round_ps::<NEAREST>(self.1)) }
        }
        #[inline(always)]
        fn power_of_two(self) -> Self {
            // SAFETY: see above.
            unsafe {
                let bias = _mm256_set1_epi32(127);
                let a = _mm256_add_epi32(_mm256_cvtps_epi32(self.0), bias);
                let b = _mm256_add_epi32(_mm256_cvtps_epi32(self.1), bias);
                Self(
                    _mm256_castsi256_ps(_mm256_slli_epi32::<23>(a)),
                    _mm256_castsi256_ps(_mm256_slli_epi32::<23>(b)),
                )
            }
        }
        #[inline(always)]
        fn if_below(self, other: Self, yes: Self, no: Self) -> Self {
            // SAFETY: see above.
            unsafe {
                let a = _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0);
                let b = _mm256_cmp_ps::<_CMP_LT_OQ>(self.1, other.1);
                Self(_mm256_blendv_ps(no.0, yes.0, a), _mm256_blendv_ps(no.1, yes.1, b))
            }
        }
    }

    impl Lanes for Avx512 {
        const WIDE: bool = true;
        named!();
        #[inline(always)]
        fn splat(x: f32) -> Self {
            // SAFETY: see above.
            Self(unsafe { _mm512_set1_ps(x) })
        }
        #[inline(always)]
        fn load(x: &[f32; WIDTH]) -> Self {
            // SAFETY: see above.
            Self(unsafe { _mm512_loadu_ps(x.as_ptr()) })
        }
        #[inline(always)]
        fn store(self, to: &mut [f32; WIDTH]) {
            // SAFETY: see above.
            unsafe { _mm512_storeu_ps(to.as_mut_ptr(), self.0) }
        }
        #[inline(always)]
        fn times_plus(self, by: Self, plus: Self) -> Self {
            // SAFETY: see above.
            Self(unsafe { _mm512_fmadd_ps(self.0, by.0, plus.0) })
        }
        #[inline(always)]
        fn root(self) -> Self {
            // SAFETY: see above.
            Self(unsafe { _mm512_sqrt_ps(self.0) })
        }
        #[inline(always)]
        fn rounded(self) -> Self {
            const NEAREST: i32 = _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC;
            // SAFETY: see above.
            Self(unsafe { _mm512_roundscale_ps::<NEAREST>(self.0) })
        }
        #[inline(always)]
        fn power_of_two(self) -> Self {
            // SAFETY: see above.
            unsafe {
                let exponent = _mm512_add_epi32(_mm512_cvtps_epi32(self.0), _mm512_set1_epi32(127));
                Self(_mm512_castsi512_ps(_mm512_slli_epi32::<23>(exponent)))
            }
        }
        #[inline(always)]
        fn if_below(self, other: Self, yes: Self, no: Self) -> Self {
            // SAFETY: see above.
            unsafe {
                let below = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0);
                Self(_mm512_mask_blend_ps(below, no.0, yes.0))
            }
        }
        #[inline(always)]
        fn turned(rows: [Self; WIDTH]) -> [Self; WIDTH] {
            /// The same quarters of two registers: the first and third, or the second and fourth.
            const EVEN: i32 = 0x88;
            const ODD: i32 = 0xdd;
            let mut out = rows;
            // SAFETY: see above.
            unsafe {
                // Four rows of four columns in each quarter of a register.
                let mut fours = [[rows[0].0; 4]; 4];
                for (g, four) in fours.iter_mut().enumerate() {
                    let [a, b, c, d] = [0, 1, 2, 3].map(|r| rows[4 * g + r].0);
                    let pairs = [
                        [_mm512_unpacklo_ps(a, b), _mm512_unpacklo_ps(c, d)],
                        [_mm512_unpackhi_ps(a, b), _mm512_unpackhi_ps(c, d)],
                    ];
                    for (half, [x, y]) in pairs.into_iter().enumerate() {
                        let (x, y) = (_mm512_castps_pd(x), _mm512_castps_pd(y));
                        four[2 * half] = _mm512_castpd_ps(_mm512_unpacklo_pd(x, y));
                        four[2 * half + 1] = _mm512_castpd_ps(_mm512_unpackhi_pd(x, y));
                    }
                }
                for c in 0..4 {
                    let [a, b, x, y] = [fours[0][c], fours[1][c], fours[2][c], fours[3][c]];
                    let (low, high) =
                        (_mm512_shuffle_f32x4::<EVEN>(a, b), _mm512_shuffle_f32x4::<EVEN>(x, y));
                    out[c] = Self(_mm512_shuffle_f32x4::<EVEN>(low, high));
                    out[c + 8] = Self(_mm512_shuffle_f32x4::<ODD>(low, high));
                    let (low, high) =
                        (_mm512_shuffle_f32x4::<ODD>(a, b), _mm512_shuffle_f32x4::<ODD>(x, y));
                    out[c + 4] = Self(_mm512_shuffle_f32x4::<EVEN>(low, high));
                    out[c + 12] = Self(_mm512_shuffle_f32x4::<ODD>(low, high));
                }
            }
            out
        }
    }
}

/// Loads `count` numbers, up to sixteen, and zeros in their place where there are fewer.
#[inline(always)]
pub(super) fn take<L: Lanes>(from: &[f32], at: usize, count: usize) -> L {
    if count == WIDTH {
        return L::load(from[at..at + WIDTH].try_into().expect("sixteen numbers"));
    }
    let mut room = [0.0; WIDTH];
    room[..count].copy_from_slice(&from[at..at + count]);
    L::load(&room)
}

/// Stores the first `count` numbers, up to sixteen.
#[inline(always)]
pub(super) fn put<L: Lanes>(what: L, to: &mut [f32], at: usize, count: usize) {
    if count == WIDTH {
        what.store((&mut to[at..at + WIDTH]).try_into().expect("sixteen numbers"));
    } else {
        let mut room = [0.0; WIDTH];
        what.store(&mut room);
        to[at..at + count].copy_from_slice(&room[..count]);
    }
}

/// Starts and lengths of the vectors that cover `count` numbers.
#[inline(always)]
pub(super) fn vectors(count: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..count).step_by(WIDTH).map(move |at| (at, WIDTH.min(count - at)))
}
