//! Sixteen lanes as four registers of four, which every processor of the supported kinds has.

use super::{Add, Div, Lanes, Mask, Mul, Sub, Vector, WIDTH};
use wide::f32x4;

/// Lanes in a quarter.
const QUARTER: usize = WIDTH / 4;

/// The portable implementation, in four quarters. With plain arrays, each loop over sixteen lanes is
/// the compiler's to unroll, and the crate takes four times as long to compile.
#[derive(Clone, Copy)]
pub(crate) struct Portable([f32x4; 4]);

impl Portable {
    #[inline(always)]
    fn each(value: impl Fn(usize) -> f32x4) -> Self {
        Self([value(0), value(1), value(2), value(3)])
    }
}

macro_rules! operators {
    ($($trait:ident $method:ident $operator:tt),*) => {$(
        impl $trait for Portable {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self::each(|q| self.0[q] $operator other.0[q])
            }
        }
    )*};
}
operators!(Add add +, Sub sub -, Mul mul *, Div div /);

impl Lanes for Portable {
    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self([f32x4::splat(x); 4])
    }
    #[inline(always)]
    fn load(x: &[f32; WIDTH]) -> Self {
        Self::each(|q| f32x4::from([0, 1, 2, 3].map(|l| x[QUARTER * q + l])))
    }
    #[inline(always)]
    fn store(self, to: &mut [f32; WIDTH]) {
        for (to, quarter) in to.as_chunks_mut().0.iter_mut().zip(self.0) {
            *to = quarter.to_array();
        }
    }
    // Selected by a comparison: what the library's own extremes do with NaN depends on the processor.
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self::each(|q| self.0[q].simd_gt(other.0[q]).select(self.0[q], other.0[q]))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self::each(|q| self.0[q].simd_lt(other.0[q]).select(self.0[q], other.0[q]))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self::each(|q| self.0[q].sqrt())
    }
    #[inline(always)]
    fn below(self, other: Self) -> Mask {
        let bits = |q: usize| self.0[q].simd_lt(other.0[q]).to_bitmask() << (QUARTER * q);
        (bits(0) | bits(1) | bits(2) | bits(3)) as Mask
    }
    #[inline(always)]
    fn select(mask: Mask, yes: Self, no: Self) -> Self {
        Self::each(|q| spread(mask >> (QUARTER * q)).select(yes.0[q], no.0[q]))
    }
    #[inline(always)]
    fn rows(from: &[Vector; WIDTH]) -> [Self; 4] {
        columns(|l| from[l])
    }
    #[inline(always)]
    fn write_rows(components: [Self; 4], to: &mut [Vector; WIDTH]) {
        for (q, to) in to.as_chunks_mut::<QUARTER>().0.iter_mut().enumerate() {
            *to = f32x4::transpose(components.map(|it| it.0[q])).map(f32x4::to_array);
        }
    }
    #[inline(always)]
    unsafe fn gather(from: &[Vector], index: &[u32; WIDTH]) -> [Self; 4] {
        columns(|l| from[index[l] as usize])
    }
}

/// Sixteen vectors by component.
#[inline(always)]
fn columns(vector: impl Fn(usize) -> Vector) -> [Portable; 4] {
    let quarter =
        |q: usize| f32x4::transpose([0, 1, 2, 3].map(|l| f32x4::from(vector(QUARTER * q + l))));
    let quarters = [quarter(0), quarter(1), quarter(2), quarter(3)];
    [0, 1, 2, 3].map(|component| Portable(quarters.map(|it| it[component])))
}

/// Expands the low four bits to a lane mask.
#[inline(always)]
fn spread(mask: Mask) -> f32x4 {
    const LANES: [[f32; QUARTER]; 1 << QUARTER] = {
        let mut lanes = [[0.0; QUARTER]; 1 << QUARTER];
        let mut mask = 0;
        while mask < lanes.len() {
            let mut lane = 0;
            while lane < QUARTER {
                if mask >> lane & 1 == 1 {
                    lanes[mask][lane] = f32::from_bits(u32::MAX);
                }
                lane += 1;
            }
            mask += 1;
        }
        lanes
    };
    f32x4::from(LANES[usize::from(mask & 0xF)])
}
