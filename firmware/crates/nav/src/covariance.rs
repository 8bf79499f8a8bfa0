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
pub struct Coupling<T: Real> {
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
        (0..3 * B).all(|i| {
            let p_ii = self.at(i, i);
            p_ii.finite()
                && p_ii > T::zero()
                && (0..i).all(|j| {
                    let p_ij = self.at(j, i);
                    p_ij * p_ij <= p_ii * self.at(j, j)
                })
        })
    }

    fn at(&self, i: usize, j: usize) -> T {
        self.upper[i / 3][j / 3][(i % 3, j % 3)]
    }

    /// Φ P Φᵀ with `Φ = I + couplings`.
    ///
    /// Couplings may chain (a block that is moved may move another): all of them act on the state at
    /// the start.
    pub fn propagate(&mut self, couplings: &[Coupling<T>]) {
        // M = Φ P; rows that nothing moves are P's own.
        let mut m = [[Matrix3::zeros(); B]; B];
        for (i, row) in m.iter_mut().enumerate() {
            for (j, block) in row.iter_mut().enumerate() {
                *block = self.block(i, j);
            }
        }
        for Coupling { row, col, block } in couplings {
            for (j, moved) in m[*row].iter_mut().enumerate() {
                *moved += block * self.block(*col, j);
            }
        }
        // P = M Φᵀ, upper blocks only.
        for (i, row) in m.iter().enumerate() {
            for j in i..B {
                let mut sum = row[j];
                for coupling in couplings.iter().filter(|coupling| coupling.row == j) {
                    sum += row[coupling.col] * coupling.block.transpose();
                }
                self.upper[i][j] = sum;
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

    /// Takes a measurement of component `axis` of block `measured` with noise variance `r` > 0.
    ///
    /// `r` is raised to [`LARGEST_CUT`]⁻¹ of the variance that is measured.
    pub fn update(&mut self, measured: usize, axis: usize, r: T) -> Gain<T, B> {
        let mut p_h = [Vector3::zeros(); B];
        for (i, part) in p_h.iter_mut().enumerate() {
            *part = self.block(i, measured).column(axis).into();
        }
        let p_kk = p_h[measured][axis];
        let r = r.max(p_kk * T::lit(1.0 / LARGEST_CUT));
        let innovation_var = p_kk + r;
        let inverse = T::one() / innovation_var;
        let root = math::sqrt(inverse);
        let u = p_h.map(|part| part * root);
        for i in 0..B {
            for j in i..B {
                self.upper[i][j] -= u[i] * u[j].transpose();
            }
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
        Gain {
            column: p_h.map(|part| part * inverse),
            innovation_var,
        }
    }
}

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

    fn couplings(seed: u32) -> [Coupling<f64>; 5] {
        [(0, 0), (0, 2), (1, 0), (1, 2), (1, 3)].map(|(row, col)| Coupling {
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
        p.propagate(&couplings(seed));
        p
    }

    proptest! {
        #[test]
        fn propagation_is_the_dense_product(seed in 0..1000_u32) {
            let mut p = some_covariance(seed);
            let before = dense(&p);
            let couplings = couplings(seed + 77);
            let mut phi = Dense::identity();
            for c in &couplings {
                let mut view = phi.fixed_view_mut::<3, 3>(3 * c.row, 3 * c.col);
                view += c.block;
            }
            p.propagate(&couplings);
            prop_assert!((dense(&p) - phi * before * phi.transpose()).norm() < 1e-12);
            prop_assert_eq!(dense(&p), dense(&p).transpose());
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
