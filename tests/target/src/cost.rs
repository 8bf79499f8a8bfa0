//! What is counted: the steps of the core, each as the unit runs it.

use core::cell::RefCell;
use core::hint::black_box;
use core::pin::pin;
use core::task::{Context, Poll, Waker};

use app::rotor::{Command, Config, Inputs, Rotor, Side, State};
use drivers::adis16495::{Adis16495, BURST_COMMAND, BURST_ID, BURST_LEN, BURST_WORDS, burst_crc};
use drivers::{Imu, Scale};
use embedded_hal::spi::{ErrorType, Operation};
use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::spi::SpiDevice;
use frames::{Real, Rot, Vec3, math, units::DEG};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use nav::aligner::Mode;
use nav::coarse::Coarse;
use nav::covariance::{Covariance, TransitionBlock};
use nav::earth::Earth;
use nav::fine::{FilterConfig, FineFilter};
use nav::increment::{Increment, Sample};
use nav::model::{BA, BG, DV, PAPER, PHI, ROBUST};

use crate::bits::{self, Core};
use crate::motion::{LATITUDE, Motion};

/// Counts the instructions of one call of a closure, in the mean over `calls`.
pub trait Counter {
    /// The mean, what it takes to call the closure taken off.
    fn mean(&mut self, calls: u32, body: &mut dyn FnMut()) -> u32;
}

/// A step's cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Line {
    /// What was counted.
    pub name: &'static str,
    /// Instructions.
    pub instructions: u32,
    /// The most that it may take, where there is a promise.
    pub limit: Option<u32>,
}

/// Counts everything. `core` must be new; `tell` gets the lines as they come.
pub fn count(counter: &mut impl Counter, core: &mut Core, tell: &mut impl FnMut(Line)) {
    filter(counter, tell);
    dense(counter, tell);
    scalars(counter, tell);
    samples(counter, core, tell);
    motor(counter, tell);
}

fn line(name: &'static str, instructions: u32) -> Line {
    Line {
        name,
        instructions,
        limit: None,
    }
}

fn limited(name: &'static str, instructions: u32, limit: u32) -> Line {
    Line {
        limit: Some(limit),
        ..line(name, instructions)
    }
}

/// What a second of a unit that turns by 20 °/s puts into Φ: the couplings of `nav::fine`, row and column first.
pub fn couplings() -> [(usize, usize, Matrix3<f32>); 5] {
    let c = Rot::<frames::Nav, frames::Nav, f32>::exp(Vec3::new(0.05, -0.08, 0.6)).matrix();
    let g = Vector3::new(0.0, 0.0, 9.8_f32).cross_matrix();
    [
        (DV, PHI, g),
        (DV, BG, g * c * -0.5),
        (DV, BA, c),
        (PHI, PHI, Vector3::new(0.0, 5.6e-5, 4.7e-5_f32).cross_matrix() * -1.0),
        (PHI, BG, c * -1.0),
    ]
}

/// Variances to start from, by block, SI.
pub fn prior() -> [Vector3<f32>; PAPER] {
    [
        Vector3::new(1e-5, 1e-5, 2.5),
        Vector3::repeat(1e-8),
        Vector3::repeat(2.4e-9),
        Vector3::repeat(1e-6),
    ]
}

/// Process noise of a second, by block of the diagonal, SI.
pub fn process_noise() -> [f32; PAPER] {
    [3.4e-11, 1e-8, 1e-14, 1e-14]
}

/// Variance of a velocity measurement, (m/s)². Wide enough that even the first one stays below
/// [`nav::covariance::LARGEST_CUT`]: dense filters know no such limit, and are to do the same.
pub const R: f32 = 1e-5;

/// One prediction and one measurement of three components with nav's covariance.
pub fn sparse_step(p: &mut Covariance<f32, PAPER>, couplings: &[TransitionBlock<f32>; 5], q: &[f32; PAPER]) {
    p.propagate(couplings);
    for (block, q) in q.iter().enumerate() {
        p.add(block, block, &(Matrix3::identity() * *q));
    }
    black_box(p.update_block(DV, [R; 3]));
}

/// A dense 12 × 12 matrix.
pub type Dense = SMatrix<f32, 12, 12>;

/// The same step as textbooks have it, by dense matrices: Φ P Φᵀ + Q, the gain by Cholesky, (I − K H) P.
pub fn dense_step(p: &mut Dense, phi: &Dense, q: &Dense, h: &SMatrix<f32, 3, 12>) {
    let predicted = phi * *p * phi.transpose() + q;
    let p_ht = predicted * h.transpose();
    let s = h * p_ht + Matrix3::identity() * R;
    if let Some(cholesky) = s.cholesky() {
        let gain = cholesky.solve(&p_ht.transpose()).transpose();
        *p = (Dense::identity() - gain * h) * predicted;
    }
}

/// The same, thriftier: P − K (P Hᵀ)ᵀ.
pub fn thrifty_dense_step(p: &mut Dense, phi: &Dense, q: &Dense, h: &SMatrix<f32, 3, 12>) {
    let predicted = phi * *p * phi.transpose() + q;
    let p_ht = predicted * h.transpose();
    let s = h * p_ht + Matrix3::identity() * R;
    if let Some(cholesky) = s.cholesky() {
        let gain = cholesky.solve(&p_ht.transpose()).transpose();
        *p = predicted - gain * p_ht.transpose();
    }
}

/// Φ, Q and H of [`dense_step`], from [`couplings`] and [`process_noise`].
pub fn dense_model() -> (Dense, Dense, SMatrix<f32, 3, 12>) {
    let mut phi = Dense::identity();
    for (row, col, block) in couplings() {
        let mut view = phi.fixed_view_mut::<3, 3>(3 * row, 3 * col);
        view += block;
    }
    let q = process_noise();
    let mut h = SMatrix::<f32, 3, 12>::zeros();
    h.fixed_view_mut::<3, 3>(0, 3 * DV).fill_with_identity();
    (
        phi,
        Dense::from_diagonal(&SVector::<f32, 12>::from_fn(|i, _| q[i / 3])),
        h,
    )
}

/// The couplings as nav takes them.
pub fn sparse_model() -> [TransitionBlock<f32>; 5] {
    couplings().map(|(row, col, block)| TransitionBlock { row, col, block })
}

fn increment() -> Increment {
    Increment {
        phi_s: Vec3::new(0.002, -0.003, 0.0175),
        dv_s: Vec3::new(0.02, -0.03, 0.49),
        dt: 0.05,
    }
}

/// The filter of fine alignment.
fn filter(counter: &mut impl Counter, tell: &mut impl FnMut(Line)) {
    let (model, q) = (black_box(sparse_model()), black_box(process_noise()));
    let mut p = Covariance::diagonal(prior());
    let propagate = counter.mean(1000, &mut || p.propagate(&model));
    let mut p = Covariance::diagonal(prior());
    let both = counter.mean(1000, &mut || sparse_step(black_box(&mut p), &model, &q));
    tell(line("covariance: Φ P Φᵀ", propagate));
    tell(limited(
        "covariance: prediction and three-component measurement",
        both,
        6000,
    ));

    let Ok(earth) = Earth::new(f32::lit(LATITUDE), 0.0) else {
        return;
    };
    if let Some((strapdown, measured)) = fine::<PAPER>(counter, &earth) {
        tell(line("strapdown and model, 12 states: one increment", strapdown));
        tell(limited(
            "fine filter, 12 states: prediction, measurement and feedback",
            measured,
            6000,
        ));
    }
    if let Some((strapdown, measured)) = fine::<ROBUST>(counter, &earth) {
        tell(line("strapdown and model, 45 states: one increment", strapdown));
        tell(line(
            "fine filter, 45 states: prediction, measurement and feedback",
            measured,
        ));
    }

    let increment = black_box(increment());
    let mut coarse = Coarse::<f32>::new();
    let coarse = counter.mean(1000, &mut || black_box(&mut coarse).push(&increment));
    tell(line("coarse alignment: one increment", coarse));
}

/// The fine filter with `B` blocks: one increment, and what a measurement takes beyond that.
fn fine<const B: usize>(counter: &mut impl Counter, earth: &Earth) -> Option<(u32, u32)> {
    let every = |measure_every| {
        let config = FilterConfig::<f32, B> {
            measure_every,
            ..FilterConfig::default()
        };
        FineFilter::new(config, *earth, Rot::identity(), None).ok()
    };
    let (mut never, mut always) = (every(1e9_f32)?, every(0.0)?);
    let increment = black_box(increment());
    let strapdown = counter.mean(1000, &mut || {
        black_box(never.step(&increment, 0.0));
    });
    always.close_loop();
    let measured = counter.mean(1000, &mut || {
        black_box(always.step(&increment, 0.0));
    });
    Some((strapdown, measured - strapdown))
}

/// The same step with dense matrices.
fn dense(counter: &mut impl Counter, tell: &mut impl FnMut(Line)) {
    let (phi, q, h) = black_box(dense_model());
    let prior = prior();
    let start = Dense::from_diagonal(&SVector::<f32, 12>::from_fn(|i, _| prior[i / 3][i % 3]));
    let mut p = start;
    let textbook = counter.mean(100, &mut || dense_step(black_box(&mut p), &phi, &q, &h));
    let mut p = start;
    let thrifty = counter.mean(100, &mut || thrifty_dense_step(black_box(&mut p), &phi, &q, &h));
    tell(line(
        "for comparison: the same by dense matrices (nalgebra), (I − K H) P",
        textbook,
    ));
    tell(line(
        "for comparison: the same by dense matrices (nalgebra), P − K (P Hᵀ)ᵀ",
        thrifty,
    ));
}

fn scalars(counter: &mut impl Counter, tell: &mut impl FnMut(Line)) {
    let mut x = 0.0_f32;
    let mut of = |f: fn(f32) -> f32| {
        x = 0.0;
        counter.mean(1000, &mut || {
            x += 0.01;
            black_box(f(black_box(x)));
        })
    };
    let idle = of(|x| x);
    let sin_cos = of(|x| {
        let (s, c) = math::sin_cos(x);
        s + c
    });
    let sqrt = of(math::sqrt);
    let atan2 = of(|x| math::atan2(x, 1.0));
    tell(line("sine and cosine", sin_cos - idle));
    tell(line("square root", sqrt - idle));
    tell(line("atan2", atan2 - idle));
}

/// A bus that answers every transfer at once with the same burst.
struct Bus {
    burst: [u8; BURST_LEN],
}

impl ErrorType for Bus {
    type Error = core::convert::Infallible;
}

impl SpiDevice for Bus {
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Self::Error> {
        for operation in operations {
            if let Operation::TransferInPlace(words) = operation {
                let length = words.len();
                words.copy_from_slice(&self.burst[..length]);
            }
        }
        Ok(())
    }
}

struct NoDelay;

impl DelayNs for NoDelay {
    async fn delay_ns(&mut self, _: u32) {}
}

/// The burst that holds this sample.
fn burst(sample: &Sample, scale: &Scale) -> [u8; BURST_LEN] {
    let mut words = [0_u16; BURST_WORDS];
    let of = |v: Vec3<frames::Sensor>, unit: f32| v.to_array().map(|x| (x / sample.dt / unit) as i32);
    let counts = [of(sample.dtheta_s, scale.rate), of(sample.dv_s, scale.force)];
    for (pair, count) in words[2..14].chunks_exact_mut(2).zip(counts.as_flattened()) {
        let count = count.cast_unsigned();
        [pair[0], pair[1]] = [(count & 0xFFFF) as u16, (count >> 16) as u16];
    }
    let crc = burst_crc(&words);
    let mut bytes = [0; BURST_LEN];
    let header = [BURST_COMMAND, BURST_ID, BURST_ID];
    let tail = [(crc & 0xFFFF) as u16, (crc >> 16) as u16];
    let all = header.iter().chain(&words).chain(&tail);
    for (pair, word) in bytes.chunks_exact_mut(2).zip(all) {
        pair.copy_from_slice(&word.to_be_bytes());
    }
    bytes
}

/// The output of a future that never waits.
fn ready<F: Future>(future: F) -> Option<F::Output> {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(output) => Some(output),
        Poll::Pending => None,
    }
}

/// The way of a sample, from the burst to the estimate, over a whole alignment.
fn samples(counter: &mut impl Counter, core: &mut Core, tell: &mut impl FnMut(Line)) {
    let Some(mut motion) = Motion::new() else { return };
    let mut imu = Adis16495::new(Bus { burst: [0; BURST_LEN] }, NoDelay);
    let scale = imu.scale();
    let first = motion.next_reading();
    let (mut spi, delay) = imu.release();
    spi.burst = burst(&first.sample, &scale);
    imu = Adis16495::new(spi, delay);
    let mut taken = None;
    let read = counter.mean(1000, &mut || {
        if let Some(Ok(raw)) = ready(imu.sample()) {
            taken = Some(black_box(scale.si(&raw).increments(first.sample.dt)));
        }
    });
    let right = taken.is_some_and(|(dtheta_s, dv_s)| {
        (dtheta_s - first.sample.dtheta_s).norm() < 1e-9 && (dv_s - first.sample.dv_s).norm() < 1e-6
    });
    if right {
        tell(line("IMU: burst to increments", read));
    }

    let (mut collecting, mut catching_up) = (0, 0);
    let (mut live, mut most, mut taken) = (0, 0, 0);
    for k in 0..bits::SAMPLES {
        let reading = motion.next_reading();
        let before = core.mode();
        let one = counter.mean(1, &mut || {
            black_box(core.step(&reading.sample, reading.alpha));
        });
        match (before, core.mode()) {
            (Mode::Settling | Mode::Coarse, _) => collecting = collecting.max(one),
            (Mode::CatchingUp, _) => catching_up = catching_up.max(one),
            (_, Mode::Fine | Mode::Aligned) if bits::SAMPLES - k <= 1000 => {
                live += one;
                taken += 1;
                most = most.max(one);
            }
            _ => {}
        }
    }
    tell(line("aligner: a sample while collecting, at most", collecting));
    tell(line("aligner: a sample while catching up, at most", catching_up));
    if let Some(mean) = u32::checked_div(live, taken) {
        tell(line("aligner: a sample once live, in the mean", mean));
        tell(line("aligner: a sample once live, at most", most));
        // A path that was not taken costs nothing: do not tell that.
        if right {
            tell(line("whole way of a sample once live, in the mean", read + mean));
        }
    }
    if core.estimate().is_some() {
        let estimate = counter.mean(100, &mut || {
            black_box(core.estimate());
        });
        tell(line("aligner: an estimate", estimate));
    }
}

/// A motor's tick, on a rotor that does as it is told.
fn motor(counter: &mut impl Counter, tell: &mut impl FnMut(Line)) {
    let mut config = Config {
        encoder_zero: 1.0,
        ..Config::default()
    };
    config.motor.electrical_offset = Some(0.5);
    let (dt, degree) = (config.dt(), f32::lit(DEG));
    let Ok(rotor) = Rotor::new(config) else { return };
    let rotor = RefCell::new(rotor);
    let (mut angle, mut ticks) = (100.0 * degree, 0_u32);
    let mut tick = |counter: &mut dyn FnMut(&mut dyn FnMut()) -> u32| {
        ticks += 1;
        // The last bits of an encoder never rest; one that does is taken for dead.
        let noise = if ticks.is_multiple_of(2) { 3e-6 } else { 0.0 };
        let inputs = Inputs {
            reading: Some(math::wrap_two_pi(angle + config.encoder_zero + noise)),
            home: Some(if angle < 180.0 * degree {
                Side::Below
            } else {
                Side::Above
            }),
            driver_fault: false,
        };
        let mut outputs = None;
        let cost = counter(&mut || outputs = Some(rotor.borrow_mut().tick(black_box(&inputs))));
        if let Some(s) = outputs.and_then(|o| o.set_point) {
            angle = s.angle + (s.rate + 0.5 * s.acceleration * dt) * dt;
        }
        cost
    };
    let mut uncounted = |f: &mut dyn FnMut()| {
        f();
        0
    };
    for command in [Command::Home, Command::Run] {
        for _ in 0..10 {
            tick(&mut uncounted);
        }
        if rotor.borrow_mut().command(command).is_err() {
            return;
        }
        for _ in 0..20_000 {
            tick(&mut uncounted);
            match *rotor.borrow().state() {
                State::Off => break,
                State::Running(run) if run.on_schedule() => break,
                _ => {}
            }
        }
    }
    // A whole period of the schedule and more: both legs, both turn-arounds.
    let (mut sum, mut most) = (0, 0);
    const TICKS: u32 = 40_000;
    for _ in 0..TICKS {
        let one = tick(&mut |f| counter.mean(1, f));
        sum += one;
        most = most.max(one);
    }
    if matches!(*rotor.borrow().state(), State::Running(run) if run.on_schedule()) {
        tell(limited("motor: a tick, in the mean", sum / TICKS, 1500));
        tell(limited("motor: a tick, at most", most, 1500));
    }
}

#[cfg(test)]
mod tests {
    /// What is counted is built as the unit is: level, link-time optimisation, and the level of each crate that is in both.
    #[test]
    fn the_profile_is_the_units() {
        let release = |manifest: &str| -> Vec<String> {
            let sections = manifest.split("\n[");
            let ours = sections.filter(|section| {
                let name = section.lines().next().unwrap_or_default().trim_end_matches(']');
                [
                    "profile.release",
                    "profile.release.package.app",
                    "profile.release.package.drivers",
                ]
                .contains(&name)
            });
            let lines = ours.flat_map(|section| section.lines().map(str::trim).map(str::to_owned));
            lines
                .filter(|line| !line.is_empty() && !line.starts_with('#'))
                .collect()
        };
        let (unit, here) = (include_str!("../../../Cargo.toml"), include_str!("../Cargo.toml"));
        assert_eq!(release(here), release(unit));
        assert!(release(here).iter().any(|line| line == "opt-level = \"z\""));
    }
}
