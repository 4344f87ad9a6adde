//! The portable path with operation counters: the same bits, plus the arithmetic and memory
//! traffic.

use super::{Add, Div, Lanes, Mask, Mul, Portable, Sub, Vector, WIDTH};
use std::cell::Cell;

/// Work done by a stretch of the simulation, including lanes without a contact, which are computed
/// all the same.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Work {
    /// Additions, subtractions, multiplications, divisions, square roots, minima and maxima of
    /// single numbers. Comparisons, selections and integer work are not counted.
    pub flops: u64,
    /// The divisions and square roots among them, which processors execute several times more
    /// slowly.
    pub slow_flops: u64,
    /// Bytes read or written sequentially, including the indices of gathers.
    pub streamed_bytes: u64,
    /// Bytes read or written by index.
    pub gathered_bytes: u64,
}

thread_local! {
    static WORK: Cell<Work> = const { Cell::new(Work { flops: 0, slow_flops: 0, streamed_bytes: 0, gathered_bytes: 0 }) };
}

/// Counts the work of `run` on this thread.
pub(crate) fn counted(run: impl FnOnce()) -> Work {
    WORK.set(Work::default());
    run();
    WORK.get()
}

fn tally(change: impl FnOnce(&mut Work)) {
    let mut work = WORK.get();
    change(&mut work);
    WORK.set(work);
}

fn flop() {
    tally(|work| work.flops += WIDTH as u64);
}

fn slow_flop() {
    tally(|work| {
        work.flops += WIDTH as u64;
        work.slow_flops += WIDTH as u64;
    });
}

fn stream<T>(_: &[T; WIDTH]) {
    tally(|work| work.streamed_bytes += size_of::<[T; WIDTH]>() as u64);
}

/// Counts a scatter: sixteen vectors are read by index, added to and written back.
fn scattered(index: &[u32; WIDTH]) {
    stream(index);
    tally(|work| {
        work.flops += 4 * WIDTH as u64;
        work.gathered_bytes += 2 * size_of::<[Vector; WIDTH]>() as u64;
    });
}

/// Sixteen numbers that count the operations on them.
#[derive(Clone, Copy)]
pub(crate) struct Counting(Portable);

macro_rules! counting {
    ($($trait:ident $method:ident $count:ident),*) => {$(
        impl $trait for Counting {
            type Output = Self;
            fn $method(self, other: Self) -> Self {
                $count();
                Self(self.0.$method(other.0))
            }
        }
    )*};
}
counting!(Add add flop, Sub sub flop, Mul mul flop, Div div slow_flop);

impl Lanes for Counting {
    fn splat(x: f32) -> Self {
        Self(Portable::splat(x))
    }
    fn load(x: &[f32; WIDTH]) -> Self {
        stream(x);
        Self(Portable::load(x))
    }
    fn store(self, to: &mut [f32; WIDTH]) {
        stream(to);
        self.0.store(to);
    }
    fn max(self, other: Self) -> Self {
        flop();
        Self(self.0.max(other.0))
    }
    fn min(self, other: Self) -> Self {
        flop();
        Self(self.0.min(other.0))
    }
    fn sqrt(self) -> Self {
        slow_flop();
        Self(self.0.sqrt())
    }
    fn below(self, other: Self) -> Mask {
        self.0.below(other.0)
    }
    fn select(mask: Mask, yes: Self, no: Self) -> Self {
        Self(Portable::select(mask, yes.0, no.0))
    }
    fn rows(from: &[Vector; WIDTH]) -> [Self; 4] {
        stream(from);
        Portable::rows(from).map(Self)
    }
    fn write_rows(components: [Self; 4], to: &mut [Vector; WIDTH]) {
        stream(to);
        Portable::write_rows(components.map(|component| component.0), to);
    }
    unsafe fn gather(from: &[Vector], index: &[u32; WIDTH]) -> [Self; 4] {
        stream(index);
        tally(|work| work.gathered_bytes += size_of::<[Vector; WIDTH]>() as u64);
        // SAFETY: the caller guarantees that every index is below `from.len()`.
        unsafe { Portable::gather(from, index) }.map(Self)
    }
    unsafe fn scatter(components: [Self; 4], to: &mut [Vector], index: &[u32; WIDTH]) {
        scattered(index);
        // SAFETY: the caller guarantees that every index is below `to.len()`.
        unsafe { Portable::scatter(components.map(|component| component.0), to, index) }
    }
    unsafe fn exchange(
        components: [Self; 4],
        to: &mut [Vector],
        first: &[u32; WIDTH],
        second: &[u32; WIDTH],
    ) {
        scattered(first);
        scattered(second);
        // SAFETY: as above.
        unsafe { Portable::exchange(components.map(|component| component.0), to, first, second) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn operations_are_counted_by_kind_and_by_lane() {
        let work = counted(|| {
            let x = Counting::load(&[2.0; WIDTH]);
            let y = (x * x + x - x / x).sqrt().max(x);
            y.store(&mut [0.0; WIDTH]);
        });
        assert_eq!(
            work,
            Work { flops: 6 * 16, slow_flops: 2 * 16, streamed_bytes: 2 * 64, gathered_bytes: 0 }
        );
        assert_eq!(counted(|| ()), Work::default());
    }
}
