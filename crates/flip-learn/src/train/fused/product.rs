//! Matrix products.
//!
//! Every element of a product is one sum in the order of the inner index, each step a fused
//! multiply-add. Registers hold different elements side by side, never parts of one sum, so the
//! bits do not depend on their width, on how matrices are cut into tiles, or on the processor.
#![allow(unsafe_code)] // The innermost loop alone; its block says why it is sound.
#![allow(clippy::inline_always)] // See `lanes`.

use super::lanes::{Lanes, Path, Task, WIDTH, put, take, vectors};

/// A matrix in a slice: element (i, j) is at `i * down + j * right`.
#[derive(Debug, Clone, Copy)]
pub(super) struct View<'a> {
    pub data: &'a [f32],
    pub rows: usize,
    pub columns: usize,
    pub down: usize,
    pub right: usize,
}

impl<'a> View<'a> {
    /// Rows one after another.
    ///
    /// # Panics
    /// If there are fewer numbers than `rows * columns`.
    pub(super) fn new(data: &'a [f32], rows: usize, columns: usize) -> Self {
        Self { data: &data[..rows * columns], rows, columns, down: columns, right: 1 }
    }

    /// Rows and columns exchanged.
    pub(super) fn turned(self) -> Self {
        let Self { data, rows, columns, down, right } = self;
        Self { data, rows: columns, columns: rows, down: right, right: down }
    }

    /// Some of its rows.
    pub(super) fn some_rows(self, from: usize, rows: usize) -> Self {
        assert!(from + rows <= self.rows);
        Self { data: &self.data[(from * self.down).min(self.data.len())..], rows, ..self }
    }

    /// Some of its columns.
    pub(super) fn some_columns(self, from: usize, columns: usize) -> Self {
        self.turned().some_rows(from, columns).turned()
    }

    /// Whether its last element lies within the slice.
    fn fits(&self) -> bool {
        let empty = self.rows == 0 || self.columns == 0;
        empty || (self.rows - 1) * self.down + (self.columns - 1) * self.right < self.data.len()
    }
}

/// The second factor, copied so that a tile reads it from one end to the other: strips of columns,
/// each with a first row that its sums start from, and then the matrix's rows; filled up with zeros.
#[derive(Debug, Default)]
pub(super) struct Panels {
    data: Vec<f32>,
    inner: usize,
    columns: usize,
    vectors: usize,
}

impl Panels {
    /// Copies a matrix, and the numbers that the sums of its columns start from: zero, or one of
    /// each of `starts` added up.
    ///
    /// # Panics
    /// If neither the matrix's rows nor its columns are without gaps.
    pub(super) fn pack(&mut self, path: Path, matrix: View, starts: &[&[f32]]) {
        assert!(matrix.fits() && (matrix.right == 1 || matrix.down == 1));
        let strip = path.vectors() * WIDTH;
        (self.inner, self.columns, self.vectors) = (matrix.rows, matrix.columns, path.vectors());
        let length = (matrix.rows + 1) * strip;
        let needed = matrix.columns.div_ceil(strip) * length;
        // Never shrunk: to grow again would fill it with zeros first.
        self.data.resize(self.data.len().max(needed), 0.0);
        path.run(Pack { panels: self, matrix, starts });
    }

    fn panel(&self, strip: usize) -> &[f32] {
        let length = (self.inner + 1) * self.vectors * WIDTH;
        &self.data[strip * length..(strip + 1) * length]
    }
}

/// See [`Panels::pack`].
struct Pack<'a> {
    panels: &'a mut Panels,
    matrix: View<'a>,
    starts: &'a [&'a [f32]],
}

impl Task for Pack<'_> {
    #[inline(always)]
    fn with<L: Lanes>(self) {
        let Self { panels, matrix, starts } = self;
        let strip = panels.vectors * WIDTH;
        let length = (matrix.rows + 1) * strip;
        let strips = matrix.columns.div_ceil(strip);
        let filled = panels.data[..strips * length].chunks_exact_mut(length);
        for (place, panel) in filled.enumerate() {
            for within in (0..strip).step_by(WIDTH) {
                let left = place * strip + within;
                // None beyond the last column: zeros.
                let count = matrix.columns.saturating_sub(left).min(WIDTH);
                let mut first = L::splat(0.0);
                for start in starts {
                    first = first.plus(take(start, left.min(start.len()), count));
                }
                put(first, panel, within, WIDTH);
                if matrix.rows == 0 {
                    continue;
                }
                let panel = &mut panel[strip + within..];
                if matrix.right == 1 {
                    for i in 0..matrix.rows {
                        let from = (i * matrix.down + left).min(matrix.data.len());
                        put(take::<L>(matrix.data, from, count), panel, i * strip, WIDTH);
                    }
                } else {
                    for (i, rows) in vectors(matrix.rows) {
                        let mut columns = [L::splat(0.0); WIDTH];
                        for (j, column) in columns[..count].iter_mut().enumerate() {
                            *column = take(matrix.data, (left + j) * matrix.right + i, rows);
                        }
                        for (k, row) in L::turned(columns)[..rows].iter().enumerate() {
                            put(*row, panel, (i + k) * strip, WIDTH);
                        }
                    }
                }
            }
        }
    }
}

/// Where a product goes: rows of a slice, `down` apart.
#[derive(Debug)]
pub(super) struct Into<'a> {
    pub data: &'a mut [f32],
    pub down: usize,
}

/// What happens to a sum before it is stored.
#[derive(Debug, Clone, Copy)]
pub(super) enum Finish<'a> {
    /// Nothing.
    Plain,
    /// The number that is there is where it starts from, in place of the panel's first row.
    Onto,
    /// Negative sums become zero.
    Relu,
    /// It becomes zero where this matrix, of the product's shape, is not above zero.
    Where(View<'a>),
}

/// `left * right`, with `right` packed.
#[derive(Debug)]
pub(super) struct Product<'a> {
    pub left: View<'a>,
    pub right: &'a Panels,
    pub into: Into<'a>,
    pub finish: Finish<'a>,
}

impl Product<'_> {
    /// # Panics
    /// If the shapes do not fit.
    pub(super) fn compute(self, path: Path) {
        assert!(self.left.columns == self.right.inner && self.left.fits());
        assert!(path.vectors() == self.right.vectors, "packed for another path");
        let (rows, columns) = (self.left.rows, self.right.columns);
        assert!(rows == 0 || (rows - 1) * self.into.down + columns <= self.into.data.len());
        if let Finish::Where(mask) = self.finish {
            assert!(mask.rows == rows && mask.columns == columns && mask.right == 1 && mask.fits());
        }
        path.run(self);
    }

    #[inline(always)]
    fn strips<L: Lanes, const ROWS: usize, const VECTORS: usize>(&mut self) {
        let strip = VECTORS * WIDTH;
        for s in 0..self.right.columns.div_ceil(strip) {
            let mut row = 0;
            while row + ROWS <= self.left.rows {
                self.tile::<L, ROWS, VECTORS>(s, row);
                row += ROWS;
            }
            while row + 4 <= self.left.rows {
                self.tile::<L, 4, VECTORS>(s, row);
                row += 4;
            }
            while row < self.left.rows {
                self.tile::<L, 1, VECTORS>(s, row);
                row += 1;
            }
        }
    }

    /// One tile of the product: `ROWS` rows from `row`, the columns of strip `s`.
    ///
    /// The sums stay in registers only if the loops over them are of constant length and without
    /// iterators: with iterators the product took twice as long.
    #[allow(clippy::needless_range_loop)]
    #[inline(always)]
    fn tile<L: Lanes, const ROWS: usize, const VECTORS: usize>(&mut self, s: usize, row: usize) {
        let left_edge = s * VECTORS * WIDTH;
        let count = (VECTORS * WIDTH).min(self.right.columns - left_edge);
        let panel = self.right.panel(s);
        let mut sums = [[L::splat(0.0); VECTORS]; ROWS];
        for (r, sums) in sums.iter_mut().enumerate() {
            let at = (row + r) * self.into.down + left_edge;
            for (v, sum) in sums.iter_mut().enumerate() {
                *sum = match self.finish {
                    Finish::Onto if v * WIDTH < count => {
                        take(self.into.data, at + v * WIDTH, WIDTH.min(count - v * WIDTH))
                    }
                    _ => take(panel, v * WIDTH, WIDTH),
                };
            }
        }
        let (down, right) = (self.left.down, self.left.right);
        let first = &raw const self.left.data[(row * down).min(self.left.data.len())..];
        let (left, rows) = (first.cast::<f32>(), panel[VECTORS * WIDTH..].as_chunks::<WIDTH>().0);
        for k in 0..self.right.inner {
            let mut b = [L::splat(0.0); VECTORS];
            for v in 0..VECTORS {
                // SAFETY: a panel has `inner` rows of `VECTORS` vectors after its first
                // ([`Panels::pack`]), and `k` is below `inner`.
                b[v] = L::load(unsafe { rows.get_unchecked(k * VECTORS + v) });
            }
            for r in 0..ROWS {
                // SAFETY: `row + r` is below the rows of `left` and `k` below its columns, and
                // [`Product::compute`] checked that its last element lies within its slice.
                let a = L::splat(unsafe { *left.add(r * down + k * right) });
                for v in 0..VECTORS {
                    sums[r][v] = a.times_plus(b[v], sums[r][v]);
                }
            }
        }
        for (r, sums) in sums.iter().enumerate() {
            let at = (row + r) * self.into.down + left_edge;
            for (v, (column, count)) in vectors(count).enumerate() {
                let zero = L::splat(0.0);
                let sum = match self.finish {
                    Finish::Plain | Finish::Onto => sums[v],
                    Finish::Relu => zero.max(sums[v]),
                    Finish::Where(mask) => {
                        let at = (row + r) * mask.down + left_edge + column;
                        zero.if_below(take(mask.data, at, count), sums[v], zero)
                    }
                };
                put(sum, self.into.data, at + column, count);
            }
        }
    }
}

impl Task for Product<'_> {
    #[inline(always)]
    fn with<L: Lanes>(mut self) {
        if L::WIDE { self.strips::<L, 8, 2>() } else { self.strips::<L, 4, 1>() }
    }
}

/// A product with so few columns that each element is computed alone: the sum of sixteen partial
/// sums, of which each takes every sixteenth term. `right` is given by columns: `[columns, inner]`.
#[derive(Debug)]
pub(super) struct Narrow<'a> {
    pub left: View<'a>,
    pub right: View<'a>,
    /// What the sums start from; none for zero.
    pub starts: Option<&'a [f32]>,
    pub into: Into<'a>,
}

impl Task for Narrow<'_> {
    #[inline(always)]
    fn with<L: Lanes>(self) {
        let Self { left, right, starts, into } = self;
        assert!(left.right == 1 && right.right == 1 && left.columns == right.columns);
        for i in 0..left.rows {
            for j in 0..right.rows {
                let mut sums = L::splat(0.0);
                for (at, count) in vectors(left.columns) {
                    let a: L = take(left.data, i * left.down + at, count);
                    sums = a.times_plus(take(right.data, j * right.down + at, count), sums);
                }
                let mut parts = [0.0; WIDTH];
                sums.store(&mut parts);
                for half in [8, 4, 2, 1] {
                    for l in 0..half {
                        parts[l] += parts[l + half];
                    }
                }
                into.data[i * into.down + j] = parts[0] + starts.map_or(0.0, |starts| starts[j]);
            }
        }
    }
}

/// Sums of a matrix's columns, from its first row to its last.
#[derive(Debug)]
pub(super) struct ColumnSums<'a> {
    pub of: View<'a>,
    pub into: &'a mut [f32],
}

impl Task for ColumnSums<'_> {
    #[inline(always)]
    fn with<L: Lanes>(self) {
        let Self { of, into } = self;
        assert!(of.right == 1);
        for (at, count) in vectors(of.columns) {
            let mut sums = L::splat(0.0);
            for i in 0..of.rows {
                sums = sums.plus(take(of.data, i * of.down + at, count));
            }
            put(sums, into, at, count);
        }
    }
}

#[cfg(test)]
#[path = "product_tests.rs"]
mod tests;
