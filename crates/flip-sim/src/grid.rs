//! The search grid: grains sorted by cell. Lengths in grain diameters.

use super::constraints::Vector;

/// Side of a cell.
const CELL: f32 = 2.0;

/// A uniform grid over the grains' bounding box.
#[derive(Debug, Clone, Default)]
pub(super) struct Grid {
    origin: [f32; 3],
    size: [i32; 3],
    /// `first[c]..first[c + 1]` are the places of the grains of cell `c`.
    first: Vec<u32>,
    /// The grains by place: cell after cell.
    pub grain: Vec<u32>,
    cell_of: Vec<u32>,
}

/// Maximum number of cells along one side, so that a stray grain far away does not cost memory.
const CELLS_MAX: i32 = 128;

impl Grid {
    #[inline(always)]
    fn coordinate(&self, x: f32, axis: usize) -> i32 {
        (((x - self.origin[axis]) * (1.0 / CELL)) as i32).clamp(0, self.size[axis] - 1)
    }

    /// Sorts grains at `x` into cells.
    pub(super) fn fill(&mut self, x: &[Vector]) {
        let mut low = [f32::MAX; 3];
        let mut high = [f32::MIN; 3];
        for x in x {
            for axis in 0..3 {
                low[axis] = low[axis].min(x[axis]);
                high[axis] = high[axis].max(x[axis]);
            }
        }
        self.origin = low;
        self.size = std::array::from_fn(|k| {
            (((high[k] - low[k]) * (1.0 / CELL)) as i32).clamp(0, CELLS_MAX - 1) + 1
        });
        let cells = (self.size[0] * self.size[1] * self.size[2]) as usize;
        self.first.clear();
        self.first.resize(cells + 2, 0);
        self.cell_of.clear();
        for x in x {
            let [i, j, k] = std::array::from_fn(|axis| self.coordinate(x[axis], axis));
            let cell = ((k * self.size[1] + j) * self.size[0] + i) as u32;
            self.cell_of.push(cell);
            self.first[cell as usize + 2] += 1;
        }
        for cell in 0..cells {
            self.first[cell + 2] += self.first[cell + 1];
        }
        self.grain.clear();
        self.grain.resize(x.len(), 0);
        // Filling moves every start up by one cell, to its final place.
        for (grain, &cell) in self.cell_of.iter().enumerate() {
            let place = &mut self.first[cell as usize + 1];
            self.grain[*place as usize] = grain as u32;
            *place += 1;
        }
    }

    /// Memory held, bytes.
    pub(super) fn bytes(&self) -> usize {
        let Self { origin: _, size: _, first, grain, cell_of } = self;
        held(first) + held(grain) + held(cell_of)
    }

    /// The lines of cells within `range` of `x`.
    #[inline(always)]
    pub(super) fn near(&self, x: Vector, range: f32) -> Lines {
        let at = |k: usize, by: f32| self.coordinate(x[k] + by, k);
        let (low, high) = (
            [at(0, -range), at(1, -range), at(2, -range)],
            [at(0, range), at(1, range), at(2, range)],
        );
        Lines { low, high, y: low[1], z: low[2] }
    }

    /// The lines of cells within `range` of `x`, starting with its own line.
    #[inline(always)]
    pub(super) fn after(&self, x: Vector, range: f32) -> Lines {
        Lines { y: self.coordinate(x[1], 1), z: self.coordinate(x[2], 2), ..self.near(x, range) }
    }
}

/// Memory held by a column, used or not, bytes.
pub(super) fn held<T>(column: &Vec<T>) -> usize {
    column.capacity() * size_of::<T>()
}

/// Iterates over the lines of cells in a box. It uses no closure or iterator adapter, because the
/// code inside must be compiled for the CPU path in use.
pub(super) struct Lines {
    low: [i32; 3],
    high: [i32; 3],
    y: i32,
    z: i32,
}

impl Lines {
    /// The places of the grains of the next line.
    #[inline(always)]
    pub(super) fn next(&mut self, grid: &Grid) -> Option<std::ops::Range<usize>> {
        if self.y > self.high[1] {
            self.y = self.low[1];
            self.z += 1;
        }
        if self.z > self.high[2] {
            return None;
        }
        let line = (self.z * grid.size[1] + self.y) * grid.size[0];
        self.y += 1;
        Some(
            grid.first[(line + self.low[0]) as usize] as usize
                ..grid.first[(line + self.high[0]) as usize + 1] as usize,
        )
    }
}
