//! The covariance of an error state in blocks of three: sparse prediction, scalar updates.
//!
//! The state is B vectors of three. `P` is held as 3×3 blocks, of which only those on and above the
//! diagonal are computed or read; the transition is the identity plus a few blocks, and only products
//! with those are formed. A measurement is taken one component at a time, with no matrix to invert.
//!
//! ```text
//! P ← Φ P Φᵀ + Q                                     \[Xing18\] (22)
//! s = P_kk + r,  u = P e_k/√s,  P ← P − u uᵀ         (23), (25), component k measured
//! ```
//!
//! Symmetry is by construction. The measured row, where nearly all cancels when r is small, is set to
//! what is left of it, `P_kj r/s`, and no measurement may cut a variance by more than [`LARGEST_CUT`]:
//! in f32 P stays positive over hours (see the tests), with neither Joseph's form nor factors.

use frames::{Real, math};
use nalgebra::{Matrix3, Vector3};

/// The most that one measurement may divide a variance by.
///
/// A difference in f32 is good to 6e-8 of what it is taken from; after this cut 6e-5 of the result.
/// Without it, a tight measurement of a wide prior turns P indefinite. It costs nothing but the first
/// seconds: the next measurement takes the rest.
pub const LARGEST_CUT: f64 = 1000.0;

/// One block of Φ − I: what block `col` of the state at the start adds to block `row` at the end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TransitionBlock<T: Real> {
    /// The block that is moved.
    pub row: usize,
    /// The block that moves it.
    pub col: usize,
    /// By how much.
    pub block: Matrix3<T>,
}

/// A symmetric 3B × 3B covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Covariance<T: Real, const B: usize> {
    /// `upper[i][j]` for i ≤ j; the rest is not used.
    upper: [[Matrix3<T>; B]; B],
}

/// What a scalar measurement does to the state: `x ← x + gain · innovation`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gain<T: Real, const B: usize> {
    /// The column of gains, by block.
    pub column: [Vector3<T>; B],
    /// Variance of the innovation, P_kk + r.
    pub innovation_var: T,
}

impl<T: Real, const B: usize> Covariance<T, B> {
    /// Independent components with these variances.
    pub fn diagonal(variances: [Vector3<T>; B]) -> Self {
        let mut upper = [[Matrix3::zeros(); B]; B];
        for (k, variance) in variances.iter().enumerate() {
            upper[k][k] = Matrix3::from_diagonal(variance);
        }
        Self { upper }
    }

    /// The block of rows `i` and columns `j`.
    pub fn block(&self, i: usize, j: usize) -> Matrix3<T> {
        if i <= j {
            self.upper[i][j]
        } else {
            self.upper[j][i].transpose()
        }
    }

    /// The variances of block `i`.
    pub fn variances(&self, i: usize) -> Vector3<T> {
        self.upper[i][i].diagonal()
    }

    /// Whether every variance is finite and positive and no correlation exceeds one.
    pub fn is_sound(&self) -> bool {
        let variances: [Vector3<T>; B] = core::array::from_fn(|i| self.variances(i));
        let positive = |v: &Vector3<T>| v.iter().all(|p| p.finite() && *p > T::zero());
        variances.iter().all(positive)
            && (0..B).all(|i| {
                (i..B).all(|j| {
                    let block = &self.upper[i][j];
                    (0..3).all(|col| {
                        // Of a diagonal block the part above the diagonal: correlations with others.
                        let rows = if i == j { col } else { 3 };
                        (0..rows).all(|row| {
                            let p_ij = block[(row, col)];
                            p_ij * p_ij <= variances[i][row] * variances[j][col]
                        })
                    })
                })
            })
    }

    /// Φ P Φᵀ with `Φ = I + couplings`.
    ///
    /// Couplings may chain (a block that is moved may move another): all of them act on the state at
    /// the start. Put those first that read what others move, and a block's coupling with itself before its
    /// others: then it is done in place, in half the time. In any other order, or with a cycle, it takes a copy.
    pub fn propagate(&mut self, transition: &[TransitionBlock<T>]) {
        let mut moved = [false; B];
        let mut in_place = true;
        for &TransitionBlock { row, col, .. } in transition {
            in_place &= !moved[col];
            moved[row] = true;
        }
        if in_place {
            // Φ is the product of its parts then.
            for moved_block in transition {
                self.move_block(moved_block);
            }
        } else {
            self.propagate_copy(transition, &moved);
        }
    }

    /// E P Eᵀ with `E = I + coupling`.
    fn move_block(&mut self, &TransitionBlock { row, col, ref block }: &TransitionBlock<T>) {
        let a = |r: usize, c: usize| block[(r, c)];
        let at = |r: usize, c: usize| block[(c, r)];
        // The diagonal takes E from both sides: a P_cr with P as it was, and later P_rc aᵀ with P_rc moved.
        let source = self.block(col, row);
        let mut diagonal = self.upper[row][row];
        add_product(&mut diagonal, a, |r, c| source[(r, c)]);
        for j in 0..B {
            if j == row {
                continue;
            }
            let (target, source) = if j < col {
                (self.upper[row.min(j)][row.max(j)], self.upper[j][col])
            } else {
                (self.upper[row.min(j)][row.max(j)], self.upper[col][j])
            };
            let mut sum = target;
            match (j < row, j < col) {
                (false, false) => add_product(&mut sum, a, |r, c| source[(r, c)]),
                (false, true) => add_product(&mut sum, a, |r, c| source[(c, r)]),
                (true, false) => add_product(&mut sum, |r, c| source[(c, r)], at),
                (true, true) => add_product(&mut sum, |r, c| source[(r, c)], at),
            }
            self.upper[row.min(j)][row.max(j)] = sum;
        }
        let moved = if row == col { diagonal } else { self.block(row, col) };
        add_product(&mut diagonal, |r, c| moved[(r, c)], at);
        symmetrise(&mut diagonal);
        self.upper[row][row] = diagonal;
    }

    /// M = Φ P by rows, then P = M Φᵀ.
    fn propagate_copy(&mut self, transition: &[TransitionBlock<T>], moved: &[bool; B]) {
        let mut m = [[Matrix3::zeros(); B]; B];
        for (i, row) in m.iter_mut().enumerate().filter(|(i, _)| moved[*i]) {
            for (j, block) in row.iter_mut().enumerate() {
                *block = self.block(i, j);
            }
        }
        for TransitionBlock { row, col, block } in transition {
            for (j, sum) in m[*row].iter_mut().enumerate() {
                *sum += block * self.block(*col, j);
            }
        }
        for i in 0..B {
            for j in i..B {
                if moved[i] {
                    self.upper[i][j] = m[i][j];
                    for TransitionBlock { col, block, .. } in
                        transition.iter().filter(|moved_block| moved_block.row == j)
                    {
                        self.upper[i][j] += m[i][*col] * block.transpose();
                    }
                } else if moved[j] {
                    self.upper[i][j] = m[j][i].transpose();
                }
            }
            symmetrise(&mut self.upper[i][i]);
        }
    }

    /// Adds `block` at (i, j), i ≤ j, and its transpose at (j, i): process noise.
    pub fn add(&mut self, i: usize, j: usize, block: &Matrix3<T>) {
        self.upper[i.min(j)][i.max(j)] += block;
        if i == j {
            symmetrise(&mut self.upper[i][i]);
        }
    }

    /// D^½ P D^½ with `D = diag(factors)`: fading, \[Xing18\] (26).
    pub fn fade(&mut self, factors: &[Vector3<T>; B]) {
        let roots = factors.map(|f| f.map(math::sqrt));
        for i in 0..B {
            for j in i..B {
                let block = &mut self.upper[i][j];
                for (row, col) in (0..9).map(|k| (k % 3, k / 3)) {
                    block[(row, col)] *= roots[i][row] * roots[j][col];
                }
            }
        }
    }

    /// Takes a measurement of all three components of block `measured`, with noise variances `r` > 0: what
    /// [`Covariance::update`] does for one axis after the other, but going over P once.
    ///
    /// The gains are in the order in which the components are to be taken.
    pub fn update_block(&mut self, measured: usize, r: [T; 3]) -> [Gain<T, B>; 3] {
        // The rows that are measured, as they are after each step.
        let mut rows = [[Vector3::zeros(); B]; 3];
        for i in 0..B {
            let block = self.block(i, measured);
            for (axis, row) in rows.iter_mut().enumerate() {
                row[i] = block.column(axis).into();
            }
        }
        let gains: [Gain<T, B>; 3] = core::array::from_fn(|axis| {
            let factors = rows.map(|row| row[measured][axis]);
            let p_kk = factors[axis];
            let r = at_least(r[axis], p_kk);
            let innovation_var = p_kk + r;
            let inverse = T::one() / innovation_var;
            // What is left of the row itself, where nearly all cancels: P_kj − P_kk P_kj/s = P_kj r/s.
            let left = r * inverse;
            let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
            let column = core::array::from_fn(|i| {
                let part = rows[axis][i];
                let gain = part * inverse;
                rows[next][i] -= gain * factors[next];
                rows[last][i] -= gain * factors[last];
                rows[axis][i] = part * left;
                gain
            });
            for other in [next, last] {
                rows[other][measured][axis] = rows[axis][measured][other];
            }
            Gain { column, innovation_var }
        });
        for i in 0..B {
            if i == measured {
                continue;
            }
            for j in i..B {
                if j == measured {
                    continue;
                }
                let mut block = self.upper[i][j];
                for Gain { column, innovation_var } in &gains {
                    subtract_outer(&mut block, &column[i], &(column[j] * *innovation_var));
                }
                if i == j {
                    symmetrise(&mut block);
                }
                self.upper[i][j] = block;
            }
        }
        for i in 0..B {
            let [x, y, z] = rows.map(|row| row[i]);
            let columns = Matrix3::from_columns(&[x, y, z]);
            if i < measured {
                self.upper[i][measured] = columns;
            } else {
                self.upper[measured][i] = columns.transpose();
            }
        }
        symmetrise(&mut self.upper[measured][measured]);
        gains
    }

    /// Takes a measurement of component `axis` of block `measured` with noise variance `r` > 0.
    ///
    /// `r` is raised to [`LARGEST_CUT`]⁻¹ of the variance that is measured.
    pub fn update(&mut self, measured: usize, axis: usize, r: T) -> Gain<T, B> {
        let mut p_h = [Vector3::zeros(); B];
        for (i, part) in p_h.iter_mut().enumerate() {
            *part = self.block(i, measured).column(axis).into();
        }
        let p_kk = p_h[measured][axis];
        let r = at_least(r, p_kk);
        let innovation_var = p_kk + r;
        let inverse = T::one() / innovation_var;
        let column = p_h.map(|part| part * inverse);
        for (i, gain) in column.iter().enumerate() {
            for (block, part) in self.upper[i][i..].iter_mut().zip(&p_h[i..]) {
                subtract_outer(block, gain, part);
            }
            symmetrise(&mut self.upper[i][i]);
        }
        // The measured row is the one where nearly all cancels: P_kj − P_kk P_kj/s = P_kj r/s.
        let left = p_h.map(|part| part * (r * inverse));
        for (i, part) in left.iter().enumerate() {
            if i <= measured {
                self.upper[i][measured].set_column(axis, part);
            }
            if i >= measured {
                self.upper[measured][i].set_row(axis, &part.transpose());
            }
        }
        Gain { column, innovation_var }
    }
}

/// `r`, raised to what [`LARGEST_CUT`] asks for. No `max`: on the target that is a call.
#[inline(always)]
fn at_least<T: Real>(r: T, p_kk: T) -> T {
    let least = p_kk * T::lit(1.0 / LARGEST_CUT);
    if r < least { least } else { r }
}

/// `sum += a b`, each product added by itself: one instruction on the target.
#[inline(always)]
fn add_product<T: Real>(sum: &mut Matrix3<T>, a: impl Fn(usize, usize) -> T, b: impl Fn(usize, usize) -> T) {
    for col in 0..3 {
        for row in 0..3 {
            let mut element = sum[(row, col)];
            for k in 0..3 {
                element += a(row, k) * b(k, col);
            }
            sum[(row, col)] = element;
        }
    }
}

/// `block −= a bᵀ`.
#[inline(always)]
fn subtract_outer<T: Real>(block: &mut Matrix3<T>, a: &Vector3<T>, b: &Vector3<T>) {
    for col in 0..3 {
        for row in 0..3 {
            block[(row, col)] -= a[row] * b[col];
        }
    }
}

#[inline]
fn symmetrise<T: Real>(block: &mut Matrix3<T>) {
    for (row, col) in [(1, 0), (2, 0), (2, 1)] {
        block[(row, col)] = block[(col, row)];
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::SMatrix;
    use proptest::prelude::*;

    use super::*;

    type Dense = SMatrix<f64, 12, 12>;

    fn dense(p: &Covariance<f64, 4>) -> Dense {
        Dense::from_fn(|i, j| p.block(i / 3, j / 3)[(i % 3, j % 3)])
    }

    fn block(seed: u32) -> Matrix3<f64> {
        Matrix3::from_fn(|i, j| {
            let k = f64::from(seed) * 9.0 + (i * 3 + j) as f64;
            0.3 * libm_sin(k * 1.7)
        })
    }

    fn libm_sin(x: f64) -> f64 {
        math::sin_cos(x).0
    }

    fn transition(seed: u32) -> [TransitionBlock<f64>; 5] {
        [(0, 0), (0, 2), (1, 0), (1, 2), (1, 3)].map(|(row, col)| TransitionBlock {
            row,
            col,
            block: block(seed + 10 * row as u32 + col as u32),
        })
    }

    fn some_covariance(seed: u32) -> Covariance<f64, 4> {
        let mut p = Covariance::diagonal([
            Vector3::new(1.0, 2.0, 3.0),
            Vector3::new(0.1, 0.2, 0.3),
            Vector3::new(1.0, 1.5, 0.5),
            Vector3::new(2.0, 0.2, 1.0),
        ]);
        p.propagate(&transition(seed));
        p
    }

    proptest! {
        #[test]
        fn propagation_is_the_dense_product(seed in 0..1000_u32) {
            let before = dense(&some_covariance(seed));
            let transition = transition(seed + 77);
            let [own, phi_bg, dv_phi, dv_bg, dv_ba] = transition;
            let back = TransitionBlock { row: 3, col: 1, block: block(seed + 5) };
            let orders: [&[TransitionBlock<f64>]; 5] = [
                // In place, through a copy, with a cycle, with what is moved twice, and nothing at all.
                &[dv_phi, dv_bg, dv_ba, own, phi_bg],
                &transition,
                &[dv_ba, back, own],
                &[own, own],
                &[],
            ];
            for transition in orders {
                let mut phi = Dense::identity();
                for c in transition {
                    let mut view = phi.fixed_view_mut::<3, 3>(3 * c.row, 3 * c.col);
                    view += c.block;
                }
                let mut p = some_covariance(seed);
                p.propagate(transition);
                prop_assert!((dense(&p) - phi * before * phi.transpose()).norm() < 1e-12);
                prop_assert_eq!(dense(&p), dense(&p).transpose());
            }
        }

        #[test]
        fn update_is_the_dense_one(seed in 0..1000_u32, measured in 0..4_usize, axis in 0..3_usize, r in 1e-4..10.0_f64) {
            let mut p = some_covariance(seed);
            let before = dense(&p);
            let k = 3 * measured + axis;
            let gain = p.update(measured, axis, r);
            let s = before[(k, k)] + r.max(before[(k, k)] / LARGEST_CUT);
            let expected_gain = before.column(k) / s;
            let after = before - expected_gain * before.row(k);
            prop_assert!((dense(&p) - after).norm() < 1e-11);
            prop_assert_eq!(dense(&p), dense(&p).transpose());
            for i in 0..12 {
                prop_assert!((gain.column[i / 3][i % 3] - expected_gain[i]).abs() < 1e-12);
            }
            prop_assert!((gain.innovation_var - s).abs() < 1e-12);
            prop_assert!(p.is_sound());
        }

        #[test]
        fn three_components_at_once_are_three_one_by_one(seed in 0..1000_u32, measured in 0..4_usize, r in 1e-4..10.0_f64) {
            let mut p = some_covariance(seed);
            let mut one_by_one = p;
            let r = [r, 0.7 * r, 2.0 * r];
            let gains = p.update_block(measured, r);
            for (axis, gain) in gains.iter().enumerate() {
                let expected = one_by_one.update(measured, axis, r[axis]);
                prop_assert!((gain.innovation_var - expected.innovation_var).abs() < 1e-12);
                for (part, expected) in gain.column.iter().zip(&expected.column) {
                    prop_assert!((part - expected).norm() < 1e-12);
                }
            }
            prop_assert!((dense(&p) - dense(&one_by_one)).norm() < 1e-11);
            prop_assert_eq!(dense(&p), dense(&p).transpose());
            prop_assert!(p.is_sound());
        }

        #[test]
        fn fading_scales_rows_and_columns(seed in 0..1000_u32, f in 1.0..50.0_f64) {
            let mut p = some_covariance(seed);
            let before = dense(&p);
            let one = Vector3::repeat(1.0);
            p.fade(&[one, one, Vector3::new(f, 1.0, 2.0), one]);
            let d = Dense::from_diagonal(&nalgebra::SVector::<f64, 12>::from_fn(|i, _| match i {
                6 => math::sqrt(f),
                8 => math::sqrt(2.0),
                _ => 1.0,
            }));
            prop_assert!((dense(&p) - d * before * d).norm() < 1e-12);
        }
    }
}
