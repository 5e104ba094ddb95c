//! Products of dense matrices in single precision, bit-identical on every machine.
//!
//! Every element of a product is start + Σₚ aₚ bₚ, summed in order of p with fused multiply-add (IEEE 754-2019 clause
//! 5.4.1), so that each product and its sum are rounded once. Neither batch size nor register width changes a bit. A
//! machine without the operation (below x86-64-v3) computes it in software: same bits, slowly.
//!
//! The right factor is copied into panels of 32 columns; R rows by 32 columns of the result stay in registers.
//!
//! The rows of a large product can be split among threads, which does not change a bit either.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use pulp::{Arch, Simd, WithSimd, bytemuck};
use rayon::prelude::*;

use super::simd::SimdClosure;

/// Columns of a panel: two of the widest vector registers.
const PANEL_COLUMNS: usize = 32;

/// Multiplications that justify another thread: some fifty microseconds.
const MIN_PARALLEL_MULTIPLICATIONS: usize = 5_000_000;

/// Size of a factor that justifies packing by several threads.
const MIN_PARALLEL_PACK_LEN: usize = 50_000;

/// Maximum number of rows that are computed together.
const MAX_TILE_ROWS: usize = 8;

#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(64))]
struct PanelRow([f32; PANEL_COLUMNS]);

/// Left factor of a product with m rows and k columns.
#[derive(Clone, Copy)]
pub enum Lhs<'a> {
    /// Row-major: m rows of k.
    Rows(&'a [f32]),
    /// Column-major: k columns of m, that is, the transpose of a matrix of k rows.
    Columns(&'a [f32]),
}

/// Right factor of a product with k rows and n columns.
#[derive(Clone, Copy)]
pub enum Rhs<'a> {
    /// Row-major: k rows of n.
    Rows(&'a [f32]),
    /// Column-major: n columns of k, that is, the transpose of a matrix of n rows.
    Columns(&'a [f32]),
}

/// A packed right factor with the start values of its products.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PackedPanels {
    rows: usize,
    columns: usize,
    /// Panels; the first row of each contains the start values.
    data: Vec<PanelRow>,
}

impl PackedPanels {
    /// Packs a factor of `rows` by `columns` numbers; sums start from `start`, or from 0.
    pub(crate) fn pack(&mut self, right: Rhs<'_>, start: Option<&[f32]>, shape: [usize; 2]) {
        self.reshape(shape);
        for (panel, data) in self.data.chunks_exact_mut(shape[0] + 1).enumerate() {
            fill_panel(data, panel * PANEL_COLUMNS, right, start, shape);
        }
    }

    /// Packs a factor as `pack` does, on all threads of the current pool.
    pub fn pack_parallel(&mut self, right: Rhs<'_>, start: Option<&[f32]>, shape: [usize; 2]) {
        if shape[0] * shape[1] < MIN_PARALLEL_PACK_LEN {
            return self.pack(right, start, shape);
        }
        self.reshape(shape);
        self.data
            .par_chunks_exact_mut(shape[0] + 1)
            .enumerate()
            .for_each(|(panel, data)| {
                fill_panel(data, panel * PANEL_COLUMNS, right, start, shape);
            });
    }

    fn reshape(&mut self, [rows, columns]: [usize; 2]) {
        (self.rows, self.columns) = (rows, columns);
        self.data.resize(
            columns.div_ceil(PANEL_COLUMNS) * (rows + 1),
            PanelRow([0.0; PANEL_COLUMNS]),
        );
    }

    /// Creates panels from a factor.
    pub fn new(right: Rhs<'_>, start: Option<&[f32]>, shape: [usize; 2]) -> Self {
        let mut panels = Self::default();
        panels.pack(right, start, shape);
        panels
    }

    /// Computes the product with a left factor of `m` rows into `out` (m rows of n), with ReLU if `rectified`.
    pub(crate) fn multiply(&self, left: Lhs<'_>, m: usize, rectified: bool, out: &mut [f32]) {
        let (Lhs::Rows(data) | Lhs::Columns(data)) = left;
        debug_assert_eq!((data.len(), out.len()), (m * self.rows, m * self.columns));
        self.multiply_with_arch(Arch::new(), left, m, rectified, out);
    }

    fn multiply_with_arch(
        &self,
        path: Arch,
        left: Lhs<'_>,
        m: usize,
        rectified: bool,
        out: &mut [f32],
    ) {
        path.dispatch(Multiply {
            panels: self,
            lhs: left,
            m,
            rows: 0..m,
            rectified,
            out,
        });
    }

    /// Multiplies as `multiply` does, on all threads of the current pool; for products without concurrent ones.
    pub fn multiply_parallel(&self, left: Lhs<'_>, m: usize, rectified: bool, out: &mut [f32]) {
        let worth = (m * self.rows * self.columns / MIN_PARALLEL_MULTIPLICATIONS).max(1);
        let parts = rayon::current_num_threads().min(worth);
        if parts == 1 {
            return self.multiply(left, m, rectified, out);
        }
        let rows = m.div_ceil(parts).next_multiple_of(MAX_TILE_ROWS);
        out.par_chunks_mut(rows * self.columns)
            .enumerate()
            .for_each(|(part, out)| {
                let rows = part * rows..m.min((part + 1) * rows);
                Arch::new().dispatch(Multiply {
                    panels: self,
                    lhs: left,
                    m,
                    rows,
                    rectified,
                    out,
                });
            });
    }
}

/// Overwrites the panel of the columns that begin at `from`.
fn fill_panel(
    data: &mut [PanelRow],
    from: usize,
    right: Rhs<'_>,
    start: Option<&[f32]>,
    [rows, columns]: [usize; 2],
) {
    let width = PANEL_COLUMNS.min(columns - from);
    if width < PANEL_COLUMNS {
        data.fill(PanelRow([0.0; PANEL_COLUMNS]));
    }
    let Some((first, rest)) = data.split_first_mut() else {
        return;
    };
    first.0.fill(0.0);
    if let Some(start) = start {
        first.0[..width].copy_from_slice(&start[from..from + width]);
    }
    match right {
        Rhs::Rows(right) => {
            for (row, source) in rest.iter_mut().zip(right.chunks_exact(columns)) {
                row.0[..width].copy_from_slice(&source[from..from + width]);
            }
        }
        Rhs::Columns(right) => {
            for (column, source) in right.chunks_exact(rows).skip(from).take(width).enumerate() {
                for (row, &value) in rest.iter_mut().zip(source) {
                    row.0[column] = value;
                }
            }
        }
    }
}

/// Runs `work`, some of whose products are computed in parallel, while the other threads of the pool stay awake.
///
/// Waking idle threads takes as long as a small product. So they spin if products have up to `largest` multiplications,
/// and yield on a busy machine. They execute all tasks of the pool, so the pool must be for this work alone.
pub fn with_workers<R>(largest: usize, work: impl FnOnce() -> R) -> R {
    /// Drop guard: lets the spinning pool threads stop, also on panic.
    struct SetOnDrop<'a>(&'a AtomicBool);
    impl Drop for SetOnDrop<'_> {
        fn drop(&mut self) {
            self.0.store(true, Ordering::Release);
        }
    }
    let is_done = AtomicBool::new(false);
    rayon::in_place_scope(|scope| {
        for _ in 1..rayon::current_num_threads().min(largest / MIN_PARALLEL_MULTIPLICATIONS) {
            scope.spawn(|_| {
                while !is_done.load(Ordering::Acquire) {
                    if rayon::yield_now() != Some(rayon::Yield::Executed) {
                        std::thread::yield_now();
                    }
                }
            });
        }
        let _done = SetOnDrop(&is_done);
        work()
    })
}

struct Multiply<'a> {
    panels: &'a PackedPanels,
    lhs: Lhs<'a>,
    m: usize,
    /// Rows to multiply.
    rows: Range<usize>,
    rectified: bool,
    /// Product of these rows.
    out: &'a mut [f32],
}

impl WithSimd for Multiply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        // With 32 vector registers, sixteen hold sums; with 16, twelve. A sum waits some four cycles for its last term
        // while two terms start per cycle, so at least eight sums keep the units busy.
        if S::F32_LANES == 16 {
            self.multiply_all::<S, MAX_TILE_ROWS>(simd)
        } else {
            self.multiply_all::<S, 6>(simd)
        }
    }
}

impl Multiply<'_> {
    #[inline(always)]
    fn multiply_all<S: Simd, const R: usize>(&mut self, simd: S) {
        let panels = self.panels;
        for (index, panel) in panels.data.chunks_exact(panels.rows + 1).enumerate() {
            for group in 0..PANEL_COLUMNS / (2 * S::F32_LANES) {
                let column = index * PANEL_COLUMNS + group * 2 * S::F32_LANES;
                if column >= panels.columns {
                    break;
                }
                let Range { start, end } = self.rows;
                let mut row = start;
                while row + R <= end {
                    self.compute_tile::<S, R>(simd, panel, group, [row, column]);
                    row += R;
                }
                while row + 2 <= end {
                    self.compute_tile::<S, 2>(simd, panel, group, [row, column]);
                    row += 2;
                }
                if row < end {
                    self.compute_tile::<S, 1>(simd, panel, group, [row, column]);
                }
            }
        }
    }

    #[inline(always)]
    fn compute_tile<S: Simd, const R: usize>(
        &mut self,
        simd: S,
        panel: &[PanelRow],
        group: usize,
        [row, column]: [usize; 2],
    ) {
        let k = self.panels.rows;
        let mut sums = match self.lhs {
            Lhs::Rows(left) => {
                let rows: [&[f32]; R] =
                    std::array::from_fn(|r| &left[(row + r) * k..(row + r + 1) * k]);
                tile_sums::<S, R>(simd, panel, group, |p| std::array::from_fn(|r| rows[r][p]))
            }
            Lhs::Columns(left) => {
                let m = self.m;
                tile_sums::<S, R>(simd, panel, group, |p| {
                    let column = &left[p * m + row..][..R];
                    std::array::from_fn(|r| column[r])
                })
            }
        };
        let n = self.panels.columns;
        let width = (2 * S::F32_LANES).min(n - column);
        for (r, sums) in sums.iter_mut().enumerate() {
            if self.rectified {
                *sums = sums.map(|sum| simd.max_f32s(sum, simd.splat_f32s(0.0)));
            }
            let sums: &[f32] = bytemuck::cast_slice(sums);
            let from = (row + r - self.rows.start) * n + column;
            self.out[from..from + width].copy_from_slice(&sums[..width]);
        }
    }
}

/// Computes R rows of the product by two vectors of columns; `left` returns the R left factors of one term.
#[inline(always)]
fn tile_sums<S: Simd, const R: usize>(
    simd: S,
    panel: &[PanelRow],
    group: usize,
    left: impl Fn(usize) -> [f32; R],
) -> [[S::f32s; 2]; R] {
    let vectors = |row: &PanelRow| {
        let (vectors, _) = S::as_simd_f32s(&row.0);
        [vectors[2 * group], vectors[2 * group + 1]]
    };
    let mut sums = [vectors(&panel[0]); R];
    for (p, row) in panel[1..].iter().enumerate() {
        let right = vectors(row);
        for (sums, left) in sums.iter_mut().zip(left(p)) {
            let left = simd.splat_f32s(left);
            for (sum, right) in sums.iter_mut().zip(right) {
                *sum = simd.mul_add_f32s(left, right, *sum);
            }
        }
    }
    sums
}

/// Computes Σₚ aₚ bₚ as sixteen interleaved partial sums that are added pairwise, in the same order on every machine.
#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut partial = [0.0_f32; 16];
    let a_chunks = a.chunks_exact(16);
    let b_chunks = b.chunks_exact(16);
    for (index, (a, b)) in a_chunks
        .remainder()
        .iter()
        .zip(b_chunks.remainder())
        .enumerate()
    {
        partial[index] = a * b;
    }
    for (a, b) in a_chunks.zip(b_chunks) {
        for lane in 0..16 {
            partial[lane] = a[lane].mul_add(b[lane], partial[lane]);
        }
    }
    let mut width = 8;
    while width > 0 {
        for lane in 0..width {
            partial[lane] += partial[lane + width];
        }
        width /= 2;
    }
    partial[0]
}

/// Computes `start` plus the product of each row of `rows` with `factor` into `out`.
pub fn multiply_vector(rows: &[f32], factor: &[f32], start: f32, out: &mut [f32]) {
    Arch::new().dispatch(SimdClosure(
        #[inline(always)]
        || {
            for (row, out) in rows.chunks_exact(factor.len()).zip(out.iter_mut()) {
                *out = start + dot(row, factor);
            }
        },
    ));
}

#[cfg(test)]
mod tests;
