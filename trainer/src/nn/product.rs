//! The matrix product that all learning uses, in safe code.
//!
//! Computes `C = A B` and applies an [`Epilogue`] to each row while it is in registers. The rows of
//! `B` and `C` are contiguous and their length is a multiple of [`LANES`]; `A` may have any two
//! strides, so a transposed factor needs no copy.
//!
//! SIMD vectors run along the columns, and every element of `C` is one chain of fused
//! multiply-adds over `k = 0, 1, ..`. The result is therefore the same, bit for bit, with AVX-512,
//! AVX2, NEON or no vectors, so a training run can be reproduced on another machine. General matrix
//! libraries do not guarantee this, because their blocking determines how the sum over k is split.
//! `pulp` chooses the instructions at run time.

use pulp::{Arch, Simd, WithSimd};

/// The number of columns is a multiple of this: the widest vector (AVX-512) holds 16 `f32`.
pub const LANES: usize = 16;

/// Returns the smallest multiple of [`LANES`] that is not less than `n`.
pub const fn padded(n: usize) -> usize {
    n.next_multiple_of(LANES)
}

/// The left factor: element (row, k) is `data[row * row_stride + k * k_stride]`.
#[derive(Clone, Copy, Debug)]
pub struct Left<'a> {
    /// The elements.
    pub data: &'a [f32],
    /// Number of rows of `A` and of `C`.
    pub rows: usize,
    /// Distance between rows.
    pub row_stride: usize,
    /// Distance between successive k.
    pub k_stride: usize,
}

impl<'a> Left<'a> {
    /// Describes a row-major matrix whose rows are `stride` apart.
    pub fn rows(data: &'a [f32], rows: usize, stride: usize) -> Self {
        Self {
            data,
            rows,
            row_stride: stride,
            k_stride: 1,
        }
    }

    /// Describes the transpose of a row-major matrix whose rows are `stride` apart; `rows` is the
    /// number of rows of the transpose.
    pub fn transposed(data: &'a [f32], rows: usize, stride: usize) -> Self {
        Self {
            data,
            rows,
            row_stride: 1,
            k_stride: stride,
        }
    }
}

/// The operation on each element of `C` before it is stored.
#[derive(Clone, Copy, Debug)]
pub enum Epilogue<'a> {
    /// The element is stored unchanged.
    None,
    /// Adds the row's bias.
    Bias(&'a [f32]),
    /// Adds the row's bias and applies `max(0, .)`.
    BiasRelu(&'a [f32]),
    /// Adds the column's bias; the slice has at least as many elements as there are columns.
    ColumnBias(&'a [f32]),
    /// Adds the product to what `C` contains.
    Accumulate,
    /// Sets the element to zero unless this matrix (shaped like `C`) is positive there: the
    /// derivative of ReLU.
    WherePositive(&'a [f32]),
}

/// Computes `c = a b`, where `b` has `k` rows, `c` has `a.rows` rows, and both have `columns`
/// columns.
///
/// # Panics
/// If a slice is shorter than its shape requires, or `columns` is not a multiple of [`LANES`].
pub fn product(
    arch: Arch,
    a: Left<'_>,
    b: &[f32],
    c: &mut [f32],
    k: usize,
    columns: usize,
    epilogue: Epilogue<'_>,
) {
    assert_eq!(columns % LANES, 0, "columns must be a multiple of {LANES}");
    assert!(b.len() >= k * columns, "right factor is too short");
    assert!(c.len() >= a.rows * columns, "result is too short");
    if let Epilogue::ColumnBias(bias) = epilogue {
        assert!(bias.len() >= columns, "bias is too short");
    }
    if a.rows == 0 {
        return;
    }
    assert!(
        k == 0 || a.data.len() > (a.rows - 1) * a.row_stride + (k - 1) * a.k_stride,
        "left factor is too short"
    );
    arch.dispatch(Product {
        a,
        b,
        c,
        k,
        columns,
        epilogue,
    });
}

struct Product<'a> {
    a: Left<'a>,
    b: &'a [f32],
    c: &'a mut [f32],
    k: usize,
    columns: usize,
    epilogue: Epilogue<'a>,
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // A tile of accumulators fills half of the registers: 16 of 32 if vectors have 16 lanes,
        // 8 of 16 otherwise. Narrow results use tall tiles.
        let width = self.columns / S::F32_LANES;
        match (S::F32_LANES >= 16, width) {
            (true, 1) => self.tiles::<S, 8, 1>(simd),
            (true, 2..=3) => self.tiles::<S, 8, 2>(simd),
            (true, _) => self.tiles::<S, 4, 4>(simd),
            (false, _) => self.tiles::<S, 4, 2>(simd),
        }
    }
}

impl Product<'_> {
    #[inline(always)]
    fn tiles<S: Simd, const R: usize, const V: usize>(self, simd: S) {
        let width = self.columns / S::F32_LANES;
        let (b, _) = S::as_simd_f32s(&self.b[..self.k * self.columns]);
        let (c, _) = S::as_mut_simd_f32s(&mut self.c[..self.a.rows * self.columns]);
        let operand = match self.epilogue {
            Epilogue::WherePositive(gate) => S::as_simd_f32s(&gate[..self.a.rows * self.columns]).0,
            Epilogue::ColumnBias(bias) => S::as_simd_f32s(&bias[..self.columns]).0,
            _ => &[],
        };
        let mut panel = Panel::<S> {
            a: self.a,
            b,
            c,
            operand,
            k: self.k,
            width,
            epilogue: self.epilogue,
        };
        let mut row = 0;
        while row + R <= panel.a.rows {
            panel.row_of_tiles::<R, V>(simd, row);
            row += R;
        }
        while row < panel.a.rows {
            panel.row_of_tiles::<1, V>(simd, row);
            row += 1;
        }
    }
}

struct Panel<'a, S: Simd> {
    a: Left<'a>,
    b: &'a [S::f32s],
    c: &'a mut [S::f32s],
    /// The gate or the bias of the epilogue.
    operand: &'a [S::f32s],
    k: usize,
    width: usize,
    epilogue: Epilogue<'a>,
}

impl<S: Simd> Panel<'_, S> {
    #[inline(always)]
    fn row_of_tiles<const R: usize, const V: usize>(&mut self, simd: S, row: usize) {
        let mut column = 0;
        while column + V <= self.width {
            self.tile::<R, V>(simd, row, column);
            column += V;
        }
        while column < self.width {
            self.tile::<R, 1>(simd, row, column);
            column += 1;
        }
    }

    #[inline(always)]
    fn tile<const R: usize, const V: usize>(&mut self, simd: S, row: usize, column: usize) {
        let (k, width) = (self.k, self.width);
        let (row_stride, k_stride) = (self.a.row_stride, self.a.k_stride);
        let a = &self.a.data[row * row_stride..];
        let b = &self.b[column..];
        let mut sum = [[simd.splat_f32s(0.0); V]; R];
        for k in 0..k {
            let b = &b[k * width..k * width + V];
            // Indices instead of iterators, so that the compiler keeps the sums in registers.
            for r in 0..R {
                let factor = simd.splat_f32s(a[r * row_stride + k * k_stride]);
                for v in 0..V {
                    sum[r][v] = simd.mul_add_f32s(factor, b[v], sum[r][v]);
                }
            }
        }
        let zero = simd.splat_f32s(0.0);
        for (r, sum) in sum.iter().enumerate() {
            let start = (row + r) * self.width + column;
            for (v, &sum) in sum.iter().enumerate() {
                self.c[start + v] = match self.epilogue {
                    Epilogue::None => sum,
                    Epilogue::Bias(bias) => simd.add_f32s(sum, simd.splat_f32s(bias[row + r])),
                    Epilogue::BiasRelu(bias) => {
                        let z = simd.add_f32s(sum, simd.splat_f32s(bias[row + r]));
                        // max_f32s would hide a NaN, which has to pass through to be detected.
                        let negative = simd.less_than_f32s(z, zero);
                        simd.select_f32s(negative, zero, z)
                    }
                    Epilogue::WherePositive(_) => {
                        let on = simd.greater_than_f32s(self.operand[start + v], zero);
                        simd.select_f32s(on, sum, zero)
                    }
                    Epilogue::ColumnBias(_) => simd.add_f32s(sum, self.operand[column + v]),
                    Epilogue::Accumulate => simd.add_f32s(self.c[start + v], sum),
                };
            }
        }
    }
}

/// Computes `to = from^T`, where `from` has `rows` rows at a distance of `from_stride` and `to` has
/// `columns` rows at a distance of `to_stride`.
pub fn transpose(
    arch: Arch,
    from: &[f32],
    to: &mut [f32],
    rows: usize,
    columns: usize,
    from_stride: usize,
    to_stride: usize,
) {
    // With blocks, both sides stay in the first-level cache.
    const BLOCK: usize = 16;
    arch.dispatch(|| {
        for row in (0..rows).step_by(BLOCK) {
            let row_end = (row + BLOCK).min(rows);
            for column in 0..columns {
                let to = &mut to[column * to_stride + row..column * to_stride + row_end];
                for (i, to) in to.iter_mut().enumerate() {
                    *to = from[(row + i) * from_stride + column];
                }
            }
        }
    });
}

/// Returns the sum of the values, added in a fixed order: lane by lane, then over the lanes.
pub(crate) fn lane_sum(values: &[f32]) -> f32 {
    let mut lanes = [0.0_f32; LANES];
    for chunk in values.chunks_exact(LANES) {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane += value;
        }
    }
    lanes.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::super::arch::every_arch;
    use super::*;
    use rand::{Rng, RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    fn random(n: usize, rng: &mut impl Rng) -> Vec<f32> {
        (0..n).map(|_| rng.random_range(-1.0..1.0)).collect()
    }

    /// Computes the product from its definition, in the same order of summation.
    fn reference(a: Left<'_>, b: &[f32], k: usize, columns: usize) -> Vec<f32> {
        let mut c = Vec::new();
        for row in 0..a.rows {
            for column in 0..columns {
                let mut sum = 0.0_f32;
                for i in 0..k {
                    let factor = a.data[row * a.row_stride + i * a.k_stride];
                    sum = factor.mul_add(b[i * columns + column], sum);
                }
                c.push(sum);
            }
        }
        c
    }

    /// Results equal the definition bit for bit, as the module documents.
    #[test]
    fn every_shape_has_the_bits_of_the_definition() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        for rows in [1, 2, 3, 4, 5, 15, 19] {
            for k in [1, 7, 21, 64] {
                for columns in [16, 32, 48, 64, 80] {
                    let a = random(rows * k, &mut rng);
                    let b = random(k * columns, &mut rng);
                    let bias = random(rows, &mut rng);
                    let gate = random(rows * columns, &mut rng);
                    for left in [Left::rows(&a, rows, k), Left::transposed(&a, rows, rows)] {
                        let plain = reference(left, &b, k, columns);
                        for arch in every_arch() {
                            let with = |epilogue| {
                                let mut c = vec![f32::NAN; rows * columns];
                                product(arch, left, &b, &mut c, k, columns, epilogue);
                                c
                            };
                            let expected = |of: &dyn Fn(usize) -> f32| -> Vec<f32> {
                                (0..rows * columns).map(of).collect()
                            };
                            let biased = |i: usize| plain[i] + bias[i / columns];
                            let gated = |i: usize| if gate[i] > 0.0 { plain[i] } else { 0.0 };
                            assert_eq!(with(Epilogue::None), plain, "{arch:?}");
                            assert_eq!(with(Epilogue::Bias(&bias)), expected(&biased));
                            assert_eq!(
                                with(Epilogue::BiasRelu(&bias)),
                                expected(&|i| biased(i).max(0.0))
                            );
                            assert_eq!(with(Epilogue::WherePositive(&gate)), expected(&gated));
                            let added = |i: usize| plain[i] + gate[i % columns];
                            assert_eq!(with(Epilogue::ColumnBias(&gate)), expected(&added));
                            let mut c = gate.clone();
                            product(arch, left, &b, &mut c, k, columns, Epilogue::Accumulate);
                            assert_eq!(c, expected(&|i| gate[i] + plain[i]));
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn a_nan_passes_through_relu() {
        let mut c = [0.0; LANES];
        let left = Left::rows(&[1.0], 1, 1);
        let b = [f32::NAN; LANES];
        product(
            Arch::new(),
            left,
            &b,
            &mut c,
            1,
            LANES,
            Epilogue::BiasRelu(&[0.0]),
        );
        assert!(c.iter().all(|c| c.is_nan()));
    }

    #[test]
    fn transpose_moves_every_element() {
        let mut rng = Pcg64Mcg::seed_from_u64(2);
        let (rows, columns, from_stride, to_stride) = (21, 37, 48, 32);
        let from = random(rows * from_stride, &mut rng);
        let mut to = vec![0.0; columns * to_stride];
        transpose(
            Arch::new(),
            &from,
            &mut to,
            rows,
            columns,
            from_stride,
            to_stride,
        );
        for r in 0..rows {
            for c in 0..columns {
                assert_eq!(to[c * to_stride + r], from[r * from_stride + c]);
            }
        }
    }

    #[test]
    #[should_panic(expected = "left factor is too short")]
    fn a_short_factor_is_refused() {
        let left = Left::rows(&[0.0; 7], 2, 4);
        product(
            Arch::new(),
            left,
            &[0.0; 64],
            &mut [0.0; 32],
            4,
            16,
            Epilogue::None,
        );
    }
}
