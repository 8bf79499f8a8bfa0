//! One prediction and one three-component measurement of twelve states, f32, on this host, beside the crates that one
//! would otherwise take: `cargo bench` in this folder.
//!
//! All start from the same P and take the same Φ, Q, H and R; that they come to the same P is checked first.
//! minikalman and adskalman also move the state, which is a product of twelve by three more.
#![allow(
    non_snake_case,
    clippy::unwrap_used,
    reason = "names of the peers' traits; a benchmark stops at the first surprise"
)]

use adskalman::{CovarianceUpdateMethod, KalmanFilterNoControl, StateAndCovariance, TransitionModelLinearNoControl};
use divan::Bencher;
use minikalman::prelude::*;
use minikalman::regular::builder::KalmanFilterBuilder;
use nalgebra::{Const, Matrix3, SMatrix, SVector, Vector3};
use nav::covariance::Covariance;
use nav::model::PAPER;
use target_check::cost::{self, Dense};

type H = SMatrix<f32, 3, 12>;

fn dense_prior() -> Dense {
    let prior = cost::prior();
    Dense::from_diagonal(&SVector::<f32, 12>::from_fn(|i, _| prior[i / 3][i % 3]))
}

/// The model as adskalman takes it.
struct Model {
    phi: Dense,
    phi_t: Dense,
    q: Dense,
    h: H,
    ht: SMatrix<f32, 12, 3>,
    r: Matrix3<f32>,
}

impl Model {
    fn new() -> Self {
        let (phi, q, h) = cost::dense_model();
        Self {
            phi,
            phi_t: phi.transpose(),
            q,
            h,
            ht: h.transpose(),
            r: Matrix3::identity() * cost::R,
        }
    }
}

impl TransitionModelLinearNoControl<f32, Const<12>> for Model {
    fn F(&self) -> &Dense {
        &self.phi
    }
    fn FT(&self) -> &Dense {
        &self.phi_t
    }
    fn Q(&self) -> &Dense {
        &self.q
    }
}

impl adskalman::ObservationModel<f32, Const<12>, Const<3>> for Model {
    fn H(&self) -> &H {
        &self.h
    }
    fn HT(&self) -> &SMatrix<f32, 12, 3> {
        &self.ht
    }
    fn R(&self) -> &Matrix3<f32> {
        &self.r
    }
    fn predict_observation(&self, state: &SVector<f32, 12>) -> Vector3<f32> {
        self.h * state
    }
}

fn adskalman_step(
    model: &Model,
    state: &StateAndCovariance<f32, Const<12>>,
    method: CovarianceUpdateMethod,
) -> StateAndCovariance<f32, Const<12>> {
    KalmanFilterNoControl::new(model, model)
        .step_with_options(state, &Vector3::zeros(), method)
        .unwrap()
}

/// A filter of minikalman and its measurement, ready for a step.
macro_rules! minikalman {
    ($filter:ident, $measurement:ident) => {
        let builder = KalmanFilterBuilder::<12, f32>::default();
        let mut $filter = builder.build();
        let mut $measurement = builder.observations().build::<3>();
        let (phi, q, h) = cost::dense_model();
        let p = dense_prior();
        for i in 0..12 {
            for j in 0..12 {
                $filter.state_transition_mut().as_matrix_mut().set(i, j, phi[(i, j)]);
                $filter.direct_process_noise_mut().as_matrix_mut().set(i, j, q[(i, j)]);
                $filter.estimate_covariance_mut().as_matrix_mut().set(i, j, p[(i, j)]);
            }
        }
        for i in 0..3 {
            for j in 0..12 {
                $measurement
                    .observation_matrix_mut()
                    .as_matrix_mut()
                    .set(i, j, h[(i, j)]);
            }
            for j in 0..3 {
                let r = if i == j { cost::R } else { 0.0 };
                $measurement
                    .measurement_noise_covariance_mut()
                    .as_matrix_mut()
                    .set(i, j, r);
            }
        }
    };
}

#[divan::bench]
fn nav_blocks(bencher: Bencher<'_, '_>) {
    let (model, q) = (cost::sparse_model(), cost::process_noise());
    let mut p = Covariance::<f32, PAPER>::diagonal(cost::prior());
    bencher.bench_local(|| cost::sparse_step(divan::black_box(&mut p), &model, &q));
}

#[divan::bench]
fn nalgebra_textbook(bencher: Bencher<'_, '_>) {
    let (phi, q, h) = cost::dense_model();
    let mut p = dense_prior();
    bencher.bench_local(|| cost::dense_step(divan::black_box(&mut p), &phi, &q, &h));
}

#[divan::bench]
fn nalgebra_thrifty(bencher: Bencher<'_, '_>) {
    let (phi, q, h) = cost::dense_model();
    let mut p = dense_prior();
    bencher.bench_local(|| cost::thrifty_dense_step(divan::black_box(&mut p), &phi, &q, &h));
}

#[divan::bench]
fn adskalman_optimal(bencher: Bencher<'_, '_>) {
    let model = Model::new();
    let state = StateAndCovariance::new(SVector::zeros(), dense_prior());
    bencher.bench_local(|| adskalman_step(&model, divan::black_box(&state), CovarianceUpdateMethod::OptimalKalman));
}

#[divan::bench]
fn adskalman_joseph(bencher: Bencher<'_, '_>) {
    let model = Model::new();
    let state = StateAndCovariance::new(SVector::zeros(), dense_prior());
    bencher.bench_local(|| adskalman_step(&model, divan::black_box(&state), CovarianceUpdateMethod::JosephForm));
}

#[divan::bench]
fn minikalman_regular(bencher: Bencher<'_, '_>) {
    minikalman!(filter, measurement);
    bencher.bench_local(|| {
        divan::black_box(&mut filter).predict();
        filter.correct(&mut measurement);
    });
}

/// All come to the same P after one step, as far as f32 goes.
fn agree() {
    let mut blocks = Covariance::<f32, PAPER>::diagonal(cost::prior());
    cost::sparse_step(&mut blocks, &cost::sparse_model(), &cost::process_noise());
    let blocks = Dense::from_fn(|i, j| blocks.block(i / 3, j / 3)[(i % 3, j % 3)]);
    let (phi, q, h) = cost::dense_model();
    let (mut textbook, mut thrifty) = (dense_prior(), dense_prior());
    cost::dense_step(&mut textbook, &phi, &q, &h);
    cost::thrifty_dense_step(&mut thrifty, &phi, &q, &h);
    let start = StateAndCovariance::new(SVector::zeros(), dense_prior());
    let ads = adskalman_step(&Model::new(), &start, CovarianceUpdateMethod::JosephForm);
    minikalman!(filter, measurement);
    filter.predict();
    filter.correct(&mut measurement);
    let mini = Dense::from_fn(|i, j| filter.estimate_covariance().as_matrix().get(i, j));
    let sd = |i: usize| blocks[(i, i)].powf(0.5);
    for (name, p) in [
        ("textbook", textbook),
        ("thrifty", thrifty),
        ("adskalman", *ads.covariance()),
        ("minikalman", mini),
    ] {
        for i in 0..12 {
            for j in 0..12 {
                let off = (p[(i, j)] - blocks[(i, j)]).abs() / (sd(i) * sd(j));
                assert!(off < 1e-3, "{name} ({i}, {j}): {off}");
            }
        }
    }
}

fn main() {
    agree();
    divan::main();
}
