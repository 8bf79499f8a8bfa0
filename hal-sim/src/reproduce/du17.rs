//! \[Du17\]: what turning the IMU makes observable, and a zero-velocity filter that shows it.
//!
//! Ranks and combinations are those of [`crate::observability`]. The filter runs of Tables 1 and 2 are the core's own
//! fine filter with the paper's twelve states, closed loop, in f64, on simulated samples of an MTi-G-class IMU turned
//! about its Y or Z axis at 10 °/s. What the paper gives of its IMU is 3 °/√h and 1 °/s (\[Du16\] Table 3); accelerometers
//! are those of the maker's data sheet. The biases simulated are those that the paper's filter found in the last run of
//! each table, the only ones it calls observable; the runs' length is not given, and 300 s fits the drift of azimuth
//! that goes with the z biases not found (25.9°, 59.7° and 101.1° as r.m.s. of a ramp: 255 s, 303 s, 314 s).
//!
//! Not modelled: scale factors and misalignments, which turning brings out too (\[Du16\]), the turntable's ripple.

use frames::units::{DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR};
use frames::{Body, Nav, Rot, Sensor, Vec3};
use nalgebra::{Rotation3, SMatrix, Vector3};
use nav::earth::{Earth, EarthError};
use nav::fine::{FilterConfig, FineFilter};
use nav::increment::{ConingScullingCorrector, Sample};
use nav::model::PAPER;
use nav::noise::ImuNoise;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;

use super::{Context, Criterion, ReproduceError, Reproduction, Row};
use crate::observability::{Attitude, Axis, Matrix12, Observability, Seen, Segment, State, body_bias, dynamics};
use crate::plot::chart::{Axis as ChartAxis, Chart, Curve, figure};
use crate::sensors::{Stream, run_seed, stream};

/// Properties 1 to 5.
pub(super) const OBSERVABILITY: Reproduction = Reproduction {
    name: "du17-observability",
    what: "[Du17] Properties 1–5: rank of Q and observable combinations, at rest and turning about X, Y, Z",
    run: observability,
};

/// Tables 1 and 2, Figures 4 to 6 and 8 to 10.
pub(super) const ZUPT: Reproduction = Reproduction {
    name: "du17-zupt",
    what: "[Du17] Tables 1, 2, Figs. 4–6, 8–10: zero-velocity filter of an MTi-G, at rest and turning about Y, Z",
    run: zupt,
};

/// (36), (37).
pub(super) const ACCELERATION: Reproduction = Reproduction {
    name: "du17-acceleration",
    what: "[Du17] (36), (37): azimuth under horizontal acceleration",
    run: acceleration,
};

/// Calgary, about: the paper does not say, and it matters for nothing here.
const LATITUDE: f64 = 51.0 * DEG;
/// Rate of the paper's turntable, rad/s.
const RATE: f64 = 10.0 * DEG;

fn turning(axis: Axis) -> Segment {
    Segment {
        axis,
        rate: RATE,
        seconds: 36.0,
        acceleration: [0.0; 2],
    }
}

fn attitude(heading_deg: f64, pitch_deg: f64, roll_deg: f64) -> Attitude {
    Attitude {
        heading: heading_deg * DEG,
        pitch: pitch_deg * DEG,
        roll: roll_deg * DEG,
    }
}

fn analyse(attitude: &Attitude, segments: &[Segment]) -> Result<Observability, ReproduceError> {
    Observability::of(attitude, LATITUDE, segments).map_err(ReproduceError::failed)
}

/// Σ c x over the named states: 3, 4, 5 attitude; 6, 7, 8 accelerometers; 9, 10, 11 gyros; E, N, U each.
fn combination(terms: &[(usize, f64)]) -> State {
    let mut c = State::zeros();
    for (k, value) in terms {
        c[*k] = *value;
    }
    c
}

/// Heading of the cases below: none that makes a state special.
const HEADING_DEG: f64 = 30.0;

fn observability(context: &mut Context<'_>) -> Result<Vec<Row>, ReproduceError> {
    context.tell("ranks");
    let beyond = "The paper says 11 for any tilt but zero. What counts is the axis alone: where a right angle of tilt makes \
                  it vertical the rank is 8, and where it makes it level, 10.";
    let cases = [
        ("Property 1", "at rest, level", Axis::None, 0.0, 0.0, 8.0),
        (
            "Property 1",
            "at rest, pitch 30°, roll 20°",
            Axis::None,
            30.0,
            20.0,
            8.0,
        ),
        ("Property 3", "about X, roll 0", Axis::X, 0.0, 0.0, 10.0),
        ("Property 3", "about X, roll 0, pitch 30°", Axis::X, 30.0, 0.0, 10.0),
        ("Property 3", "about X, roll 30°", Axis::X, 0.0, 30.0, 11.0),
        ("Property 4", "about Y, pitch 0", Axis::Y, 0.0, 0.0, 10.0),
        ("Property 4", "about Y, pitch 0, roll 30°", Axis::Y, 0.0, 30.0, 10.0),
        ("Property 4", "about Y, pitch 30°", Axis::Y, 30.0, 0.0, 11.0),
        ("Property 5", "about Z, level", Axis::Z, 0.0, 0.0, 8.0),
        ("Property 5", "about Z, pitch 30°", Axis::Z, 30.0, 0.0, 11.0),
        ("Property 5", "about Z, roll 30°", Axis::Z, 0.0, 30.0, 11.0),
        ("Property 5", "about Z, pitch 1°", Axis::Z, 1.0, 0.0, 11.0),
        ("Property 3", "about X, roll 90°", Axis::X, 0.0, 90.0, 11.0),
        ("Property 4", "about Y, pitch 90°", Axis::Y, 90.0, 0.0, 11.0),
        ("Property 5", "about Z, pitch 90°", Axis::Z, 90.0, 0.0, 11.0),
    ];
    let mut rows = Vec::new();
    let mut values = Vec::new();
    let mut clearest = (f64::INFINITY, 0.0_f64);
    for (property, what, axis, pitch, roll, rank) in cases {
        let found = analyse(&attitude(HEADING_DEG, pitch, roll), &[turning(axis)])?;
        let (counted, neglected) = found.gap();
        clearest = (clearest.0.min(counted), clearest.1.max(neglected));
        values.push((what, found.singular_values));
        rows.push(
            Row::new(
                format!("[Du17] {property}"),
                format!("rank of Q, {what}"),
                "",
                Some(rank),
                found.rank as f64,
                Criterion::Exact,
            )
            .remark_if_differs(beyond),
        );
    }
    let own = |quantity: &str, value| {
        Row::new("[Du17] (13)", quantity, "", None, value, Criterion::None)
            .remark("Of all the cases above, as parts of the largest singular value of the scaled Q.")
    };
    rows.push(own("smallest singular value that counts", clearest.0));
    rows.push(own("largest singular value that does not", clearest.1));
    rows.extend(combinations()?);
    singular_value_plots(context, &values)?;
    Ok(rows)
}

/// The printed combinations, and how far each is from what is observable.
fn combinations() -> Result<Vec<Row>, ReproduceError> {
    let earth = Earth::<f64>::new(LATITUDE, 0.0).map_err(ReproduceError::failed)?;
    let g = earth.gravity();
    let (sin, cos) = (HEADING_DEG * DEG).sin_cos();
    let level = [
        combination(&[(4, g), (6, 1.0)]),
        combination(&[(3, -g), (7, 1.0)]),
        combination(&[(8, 1.0)]),
    ];
    let gyros: Vec<State> = [9, 10, 11].map(|k| combination(&[(k, 1.0)])).into();
    let level_body = attitude(HEADING_DEG, 0.0, 0.0);
    let farthest = |found: &Observability, list: &[State]| list.iter().map(|c| found.distance(c)).fold(0.0, f64::max);
    let row = |property: &str, what: &str, distance| {
        Row::new(
            format!("[Du17] {property}"),
            format!("{what}: distance from the observable space"),
            "",
            Some(0.0),
            distance,
            Criterion::Absolute(1e-9),
        )
    };
    let rest = analyse(&level_body, &[turning(Axis::None)])?;
    let about = |axis| analyse(&level_body, &[turning(axis)]);
    let (x, y, z) = (about(Axis::X)?, about(Axis::Y)?, about(Axis::Z)?);
    let reversed = analyse(
        &level_body,
        &[Segment {
            rate: -RATE,
            ..turning(Axis::Z)
        }],
    )?;
    let printed = [combination(&[(6, RATE), (9, g)]), combination(&[(7, RATE), (10, g)])];
    let mut rows =
        vec![
        row("Property 1", "gε_N + γ_E, −gε_E + γ_N, γ_U, d_E, d_N", {
            farthest(&rest, &level).max(farthest(&rest, &gyros[..2]))
        }),
        row("Property 3", "those, sin A γ_E + cos A γ_N, d_U", {
            let along = combination(&[(6, sin), (7, cos)]);
            farthest(&x, &level).max(farthest(&x, &gyros)).max(x.distance(&along))
        }),
        row("Property 4", "those, −cos A γ_E + sin A γ_N, d_U", {
            let along = combination(&[(6, -cos), (7, sin)]);
            farthest(&y, &level).max(farthest(&y, &gyros)).max(y.distance(&along))
        }),
        row("Property 5", "gε_N + γ_E, −gε_E + γ_N, γ_U", farthest(&z, &level)),
        row("Property 5", "ωγ_E + g d_E, ωγ_N + g d_N, turning as in (31)", farthest(&z, &printed)).remark_if_differs(
            "With R of (31) they are ωγ_E − g d_E and ωγ_N − g d_N, by (20); the printed signs are those of the other \
             sense of turning, which (39) has.",
        ),
        row("Property 5", "the same, turning as in (39)", farthest(&reversed, &printed)),
    ];
    let tilted = attitude(HEADING_DEG, 20.0, 10.0);
    for (property, axis) in [
        ("Property 3", Axis::X),
        ("Property 4", Axis::Y),
        ("Property 5", Axis::Z),
    ] {
        let found = analyse(&tilted, &[turning(axis)])?;
        let alone = (0..12).filter(|k| found.state(*k) == Seen::Alone).count();
        rows.push(
            Row::new(
                format!("[Du17] {property}"),
                "errors observable by themselves, tilted".to_owned(),
                "",
                Some(11.0),
                alone as f64,
                Criterion::Exact,
            )
            .remark(match found.state(5) {
                Seen::Not => "Azimuth is the twelfth, and not observable in any combination.",
                Seen::Alone | Seen::Jointly => "Azimuth is observable.",
            }),
        );
    }
    let joint = (0..3)
        .filter(|k| x.seen(&body_bias(&level_body.c_nb(), *k)) == Seen::Jointly)
        .count();
    rows.push(
        Row::new(
            "[Du17] (24)",
            "accelerometer biases in the body's axes not observable alone, about X, roll 0",
            "",
            Some(1.0),
            joint as f64,
            Criterion::Exact,
        )
        .remark("That of the axis itself."),
    );
    Ok(rows)
}

fn singular_value_plots(context: &mut Context<'_>, cases: &[(&str, [f64; 12])]) -> Result<(), ReproduceError> {
    let rows: Vec<Vec<f64>> = (0..12)
        .map(|k| {
            core::iter::once((k + 1) as f64)
                .chain(cases.iter().map(|c| c.1[k]))
                .collect()
        })
        .collect();
    let header: Vec<String> = core::iter::once("k".to_owned())
        .chain(cases.iter().map(|c| format!("\"{}\"", c.0)))
        .collect();
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    context.csv("singular-values.csv", &header, rows.iter().map(Vec::as_slice))?;
    // How fast the eleventh grows with the tilt.
    let tilts: Vec<f64> = (0..61).map(|k| 1e-3 * 90e3_f64.powf(f64::from(k) / 60.0)).collect();
    let mut curves = Vec::new();
    for (colour, (axis, label)) in [
        (Axis::X, "about X, roll"),
        (Axis::Y, "about Y, pitch"),
        (Axis::Z, "about Z, pitch"),
    ]
    .into_iter()
    .enumerate()
    {
        let mut points = Vec::new();
        for tilt in &tilts {
            let (pitch, roll) = if axis == Axis::X { (0.0, *tilt) } else { (*tilt, 0.0) };
            let found = analyse(&attitude(HEADING_DEG, pitch, roll), &[turning(axis)])?;
            points.push((*tilt, found.singular_values[10] / found.singular_values[0]));
        }
        curves.push(Curve {
            label: label.to_owned(),
            points,
            thin: false,
            colour,
        });
    }
    let chart = Chart {
        title: "eleventh singular value of the scaled Q, as a part of the largest",
        x: ChartAxis::log("tilt (°)"),
        y: ChartAxis::log("part").within(1e-7, 1.0),
        curves,
    };
    context.plot("singular-values.svg", |width| {
        figure(width, core::slice::from_ref(&chart))
    })
}

/// One IMU, as simulated and as its filter has it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Imu {
    /// rad/s.
    gyro_bias: Vector3<f64>,
    /// m/s².
    accel_bias: Vector3<f64>,
    noise: ImuNoise<f64>,
}

/// An MTi-G with these biases: °/h and m/s².
fn mti_g(gyro_deg_h: [f64; 3], accel: [f64; 3]) -> Imu {
    Imu {
        gyro_bias: Vector3::from(gyro_deg_h) * DEG_PER_HOUR,
        accel_bias: Vector3::from(accel),
        noise: ImuNoise {
            // [Du16] Table 3.
            gyro_bias_sd: 3600.0 * DEG_PER_HOUR,
            angle_random_walk: 3.0 * DEG_PER_SQRT_HOUR,
            // Xsens, MTi-G data sheet: 0.002 m/s²/√Hz.
            velocity_random_walk: 0.002,
            // Loose, as the paper's is: at rest it finds biases of 0.1 and 0.2 m/s² that are not there.
            accel_bias_sd: 0.1,
            // Assumed: what the estimates of the runs differ by.
            gyro_instability_sd: 20.0 * DEG_PER_HOUR,
            gyro_instability_tau: 300.0,
            ..ImuNoise::default()
        },
    }
}

/// One test of a table.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Test {
    name: &'static str,
    axis: Axis,
    pitch_deg: f64,
    /// Roll, pitch, azimuth (°), accelerometers X, Y, Z (m/s²), gyros X, Y, Z (°/h), as published.
    published: [f64; 9],
}

/// State of one run at one time: errors of roll, pitch, azimuth (°), estimates of the biases (m/s², °/h).
#[derive(Debug, Clone, Copy, PartialEq)]
struct Point {
    t: f64,
    values: [f64; 9],
}

/// Length of a run, s, and rate of its samples, Hz.
const SECONDS: f64 = 300.0;
const SAMPLES_HZ: f64 = 100.0;
/// 1σ of the attitude that the turntable's initialisation leaves between table and IMU, rad.
const START_SD: f64 = 0.5 * DEG;
/// Runs a test.
const RUNS: u64 = 20;

/// A body at rest, its sensor turning about an axis of the body: exact increments, then the core's filter.
struct Turntable {
    earth: Earth<f64>,
    /// `C_b^n`.
    c_nb: Rot<Nav, Body, f64>,
    axis: Vector3<f64>,
    rate: f64,
    imu: Imu,
}

impl Turntable {
    fn new(test: &Test, imu: Imu) -> Result<Self, EarthError> {
        let (axis, rate) = match test.axis {
            Axis::None => (Vector3::z(), 0.0),
            Axis::X => (Vector3::x(), RATE),
            Axis::Y => (Vector3::y(), RATE),
            Axis::Z => (Vector3::z(), RATE),
        };
        Ok(Self {
            earth: Earth::new(LATITUDE, 0.0)?,
            c_nb: Rot::from_yaw_pitch_roll(0.0, test.pitch_deg * DEG, 0.0),
            axis,
            rate,
            imu,
        })
    }

    /// `C_s^b` at a time.
    fn c_bs(&self, t: f64) -> Rot<Body, Sensor, f64> {
        let turn = Rotation3::from_axis_angle(&nalgebra::Unit::new_unchecked(self.axis), self.rate * t);
        Rot::from_matrix(turn.matrix())
    }

    /// ∫ over dt from t of a vector that is constant in n, resolved in s.
    fn held(&self, v_n: Vec3<Nav, f64>, t: f64, dt: f64) -> Vector3<f64> {
        let c_ns = self.c_nb * self.c_bs(t);
        let start = (c_ns.inverse() * v_n).vector();
        // R(−ωτ) v = v cos ωτ + v × u sin ωτ + u (u·v)(1 − cos ωτ), integrated.
        let angle = self.rate * dt;
        let (first, second) = if angle == 0.0 {
            (dt, 0.0)
        } else {
            (angle.sin() / self.rate, (1.0 - angle.cos()) / self.rate)
        };
        let along = self.axis * self.axis.dot(&start);
        start * first + start.cross(&self.axis) * second + along * (dt - first)
    }

    fn run(&self, seed: u64) -> Result<Vec<Point>, ReproduceError> {
        let normal = |rng: &mut ChaCha8Rng| -> f64 { rng.sample(StandardNormal) };
        let vector = |rng: &mut ChaCha8Rng| Vector3::from_fn(|_, _| normal(rng));
        let mut walks = (stream(seed, Stream::AngleWalk), stream(seed, Stream::VelocityWalk));
        let mut instability = stream(seed, Stream::GyroInstability);
        let noise = self.imu.noise;
        let start_error = vector(&mut stream(seed, Stream::Motion)) * START_SD;
        let c_ns = self.c_nb * self.c_bs(0.0);
        let started = Rot::<Nav, Nav, f64>::exp(Vec3::from_vector(start_error)) * c_ns;
        let config = FilterConfig::<f64, PAPER> {
            noise,
            velocity_sd: 0.01,
            measure_every: 0.1,
            tilt_sd: START_SD,
            heading_sd: START_SD,
            ..FilterConfig::default()
        };
        let mut filter = FineFilter::new(config, self.earth, started, None).map_err(ReproduceError::failed)?;
        filter.close_loop();
        let mut corrector = ConingScullingCorrector::new();
        let dt = SAMPLES_HZ.recip();
        let f_n = -self.earth.g_n();
        let keep = (-dt / noise.gyro_instability_tau).exp();
        let mut drift = vector(&mut instability) * noise.gyro_instability_sd;
        let truth = frames::Attitude::from_rot(&self.c_nb);
        let mut points = Vec::new();
        let samples = (SECONDS * SAMPLES_HZ) as u32;
        for k in 0..samples {
            let t = f64::from(k) * dt;
            let turned = self.axis * (self.rate * dt) + self.held(self.earth.w_ie_n(), t, dt);
            let gyro = turned
                + (self.imu.gyro_bias + drift) * dt
                + vector(&mut walks.0) * (noise.angle_random_walk * dt.sqrt());
            let accel = self.held(f_n, t, dt)
                + self.imu.accel_bias * dt
                + vector(&mut walks.1) * (noise.velocity_random_walk * dt.sqrt());
            drift = drift * keep + vector(&mut instability) * (noise.gyro_instability_sd * (1.0 - keep * keep).sqrt());
            let sample = Sample {
                dtheta_s: Vec3::from_vector(gyro),
                dv_s: Vec3::from_vector(accel),
                dt,
                gap: 0.0,
            };
            filter.step(&corrector.increment(&sample), 0.0);
            if (k + 1) % 100 != 0 {
                continue;
            }
            let t = t + dt;
            let solution = filter.solution();
            let found = frames::Attitude::from_rot(&(solution.c_ns.get() * self.c_bs(t).inverse()));
            let off = |found: f64, truth: f64| frames::math::wrap_pi(found - truth) / DEG;
            let [ax, ay, az] = solution.corrections.accel_bias_s.to_array();
            let [gx, gy, gz] = solution.corrections.gyro_bias_s.to_array().map(|g| g / DEG_PER_HOUR);
            points.push(Point {
                t,
                values: [
                    off(found.roll, truth.roll),
                    off(found.pitch, truth.pitch),
                    off(found.heading, truth.heading),
                    ax,
                    ay,
                    az,
                    gx,
                    gy,
                    gz,
                ],
            });
        }
        Ok(points)
    }
}

const QUANTITIES: [(&str, &str); 9] = [
    ("roll", "°"),
    ("pitch", "°"),
    ("azimuth", "°"),
    ("accelerometer X", "m/s²"),
    ("accelerometer Y", "m/s²"),
    ("accelerometer Z", "m/s²"),
    ("gyro X", "°/h"),
    ("gyro Y", "°/h"),
    ("gyro Z", "°/h"),
];

/// A table: its tests, the biases simulated and the figures that go with it.
struct Table {
    name: &'static str,
    figures: [&'static str; 3],
    imu: Imu,
    tests: [Test; 3],
}

fn tables() -> [Table; 2] {
    [
        Table {
            name: "Table 1",
            figures: ["fig04", "fig05", "fig06"],
            imu: mti_g([777.1, -1804.9, 1096.7], [-0.011, -0.007, 0.008]),
            tests: [
                Test {
                    name: "at rest",
                    axis: Axis::None,
                    pitch_deg: 0.0,
                    published: [0.71, 1.24, 25.91, 0.112, 0.223, 0.009, 683.1, -1786.7, 495.9],
                },
                Test {
                    name: "about Y, pitch 0",
                    axis: Axis::Y,
                    pitch_deg: 0.0,
                    published: [0.07, 0.11, 0.78, -0.010, 0.007, 0.007, 748.2, -1802.1, 1165.2],
                },
                Test {
                    name: "about Y, pitch 30°",
                    axis: Axis::Y,
                    pitch_deg: 30.0,
                    published: [0.08, 0.08, 2.02, -0.011, -0.007, 0.008, 777.1, -1804.9, 1096.7],
                },
            ],
        },
        Table {
            name: "Table 2",
            figures: ["fig08", "fig09", "fig10"],
            imu: mti_g([776.1, 1056.4, 1766.0], [-0.012, 0.008, 0.010]),
            tests: [
                Test {
                    name: "at rest",
                    axis: Axis::None,
                    pitch_deg: 0.0,
                    published: [0.39, 0.34, 59.7, 0.033, -0.039, 0.006, 653.6, 1028.1, 538.3],
                },
                Test {
                    name: "about Z, pitch 0",
                    axis: Axis::Z,
                    pitch_deg: 0.0,
                    published: [0.82, 0.85, 101.13, 0.076, 0.170, 0.011, 442.9, 531.6, -243.4],
                },
                Test {
                    name: "about Z, pitch 30°",
                    axis: Axis::Z,
                    pitch_deg: 30.0,
                    published: [0.08, 0.08, 2.96, -0.012, 0.008, 0.010, 776.1, 1056.4, 1766.0],
                },
            ],
        },
    ]
}

/// R.m.s. of the attitude errors over runs and time, mean and spread of the runs' last estimates.
fn summary(runs: &[Vec<Point>], quantity: usize) -> (f64, f64) {
    let n = runs.len() as f64;
    if quantity < 3 {
        let all: Vec<f64> = runs.iter().flatten().map(|p| p.values[quantity].powi(2)).collect();
        return ((all.iter().sum::<f64>() / all.len() as f64).sqrt(), 0.0);
    }
    let last = || runs.iter().filter_map(|run| run.last()).map(|p| p.values[quantity]);
    let mean = last().sum::<f64>() / n;
    let variance = last().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    (mean, variance.sqrt())
}

fn zupt(context: &mut Context<'_>) -> Result<Vec<Row>, ReproduceError> {
    let mut rows = Vec::new();
    for table in tables() {
        let mut shown = Vec::new();
        for test in &table.tests {
            context.tell(&format!("{}, {}: {RUNS} runs of {SECONDS} s", table.name, test.name));
            let turntable = Turntable::new(test, table.imu).map_err(ReproduceError::failed)?;
            let runs: Vec<Vec<Point>> = (0..RUNS)
                .into_par_iter()
                .map(|run| turntable.run(run_seed(context.seed, run)))
                .collect::<Result<_, _>>()?;
            rows.extend(test_rows(&table, test, &runs)?);
            shown.push((test.name, runs.into_iter().next().unwrap_or_default()));
        }
        estimates(context, &table, &shown)?;
    }
    Ok(rows)
}

fn test_rows(table: &Table, test: &Test, runs: &[Vec<Point>]) -> Result<Vec<Row>, ReproduceError> {
    let body = attitude(0.0, test.pitch_deg, 0.0);
    let found = analyse(&body, &[turning(test.axis)])?;
    let c_nb = body.c_nb();
    let mut rows = Vec::new();
    for (k, (name, unit)) in QUANTITIES.iter().enumerate() {
        let (ours, spread) = summary(runs, k);
        let source = format!("[Du17] {}", table.name);
        let published = Some(test.published[k]);
        if k < 3 {
            let settled = found.rank == 11 || (test.axis == Axis::Y);
            let row = Row::new(
                source,
                format!("{name}, r.m.s. error, {}", test.name),
                unit,
                published,
                ours,
                Criterion::Factor(3.0),
            );
            rows.push(row.remark_if_differs(if settled {
                "Noise of the IMU and the first seconds, until the biases are found, decide; the paper gives neither the \
                 filter's start nor the table's own vibration."
            } else {
                "Not observable: where the filter starts decides, which the paper does not give."
            }));
            continue;
        }
        let seen = found.seen(&body_bias(&c_nb, k - 3));
        let alone = seen == Seen::Alone;
        let close = if k < 6 { 0.02 } else { 60.0 };
        let row = Row::new(
            source,
            format!("{name}, estimate, {}", test.name),
            unit,
            published,
            ours,
            if alone {
                Criterion::Absolute(close)
            } else {
                Criterion::None
            },
        );
        let truth = if k < 6 {
            table.imu.accel_bias[k - 3]
        } else {
            table.imu.gyro_bias[k - 6] / DEG_PER_HOUR
        };
        rows.push(if alone {
            row.remark_if_differs(format!(
                "Observable, and found: {truth} simulated, 1σ of the runs {spread:.3}. The paper's own runs differ by as \
                 much where it is observable in both."
            ))
        } else {
            row.remark(
                "Not observable by itself: what the filter calls it depends on where it starts, here at zero, and both \
                 are only shown beside each other.",
            )
        });
    }
    Ok(rows)
}

/// Figures 4 to 6 and 8 to 10: one run of each test.
fn estimates(context: &mut Context<'_>, table: &Table, runs: &[(&str, Vec<Point>)]) -> Result<(), ReproduceError> {
    let labels = ["error (°)", "estimate (m/s²)", "estimate (°/h)"];
    let titles: Vec<Vec<String>> = (0..3)
        .map(|f| (0..3).map(|k| QUANTITIES[3 * f + k].0.to_owned()).collect())
        .collect();
    for (f, file) in table.figures.iter().enumerate() {
        let charts: Vec<Chart<'_>> = (0..3)
            .map(|k| Chart {
                title: &titles[f][k],
                x: ChartAxis::linear("time (s)"),
                y: ChartAxis::linear(labels[f]),
                curves: runs
                    .iter()
                    .enumerate()
                    .map(|(colour, (name, points))| Curve {
                        label: (*name).to_owned(),
                        points: points.iter().map(|p| (p.t, p.values[3 * f + k])).collect(),
                        thin: false,
                        colour,
                    })
                    .collect(),
            })
            .collect();
        context.plot(&format!("{file}.svg"), |width| figure(width, &charts))?;
    }
    for (name, points) in runs {
        let rows: Vec<Vec<f64>> = points
            .iter()
            .map(|p| core::iter::once(p.t).chain(p.values).collect())
            .collect();
        let file = format!("{} {name}.csv", table.name)
            .to_lowercase()
            .replace([' ', ','], "-");
        let file = file.replace("--", "-").replace('°', "");
        let header = [
            "t_s",
            "roll_error_deg",
            "pitch_error_deg",
            "azimuth_error_deg",
            "accel_x_m_s2",
            "accel_y_m_s2",
            "accel_z_m_s2",
            "gyro_x_deg_h",
            "gyro_y_deg_h",
            "gyro_z_deg_h",
        ];
        context.csv(&file, &header, rows.iter().map(Vec::as_slice))?;
    }
    Ok(())
}

/// What a turn-on leaves, for the covariance under acceleration: δv, ε, γ, d.
fn turn_on(imu: &Imu) -> State {
    let noise = &imu.noise;
    State::from_fn(|k, _| match k {
        0..3 => 0.01,
        3 | 4 => START_SD,
        5 => 20.0 * DEG,
        6..9 => noise.accel_bias_sd,
        _ => noise.gyro_bias_sd,
    })
}

/// When acceleration begins, how long it lasts, s, and what it is, m/s², north.
const PUSH: (f64, f64, f64) = (120.0, 10.0, 1.0);

/// 1σ of azimuth over time, degrees: covariance of a filter with velocity measured at 10 Hz to 0.05 m/s.
fn azimuth_sd(body: &Attitude, axis: Axis, imu: &Imu) -> Result<Vec<(f64, f64)>, EarthError> {
    let earth = Earth::<f64>::new(LATITUDE, 0.0)?;
    let dt = 0.1;
    let (begins, lasts, size) = PUSH;
    let still = turning(axis);
    let pushed = Segment {
        acceleration: [0.0, size],
        ..still
    };
    let [phi, phi_pushed] = [still, pushed].map(|s| (dynamics(body, &earth, &s) * dt).exp());
    let walk = State::from_fn(|k, _| match k {
        0..3 => imu.noise.velocity_random_walk.powi(2),
        3..6 => imu.noise.angle_random_walk.powi(2),
        _ => 0.0,
    });
    let q = Matrix12::from_diagonal(&(walk * dt));
    let r = SMatrix::<f64, 3, 3>::identity() * 0.05_f64.powi(2);
    let mut p = Matrix12::from_diagonal(&turn_on(imu).map(|sd| sd * sd));
    let mut points = Vec::new();
    for k in 0..1600_u32 {
        let t = f64::from(k) * dt;
        let accelerates = t >= begins && t < begins + lasts;
        let phi = if accelerates { &phi_pushed } else { &phi };
        p = phi * p * phi.transpose() + q;
        let cross = p.fixed_columns::<3>(0).clone_owned();
        let s = p.fixed_view::<3, 3>(0, 0) + r;
        let Some(inverse) = s.try_inverse() else { break };
        p -= cross * inverse * cross.transpose();
        p = (p + p.transpose()) * 0.5;
        points.push((t + dt, p[(5, 5)].max(0.0).sqrt() / DEG));
    }
    Ok(points)
}

fn acceleration(context: &mut Context<'_>) -> Result<Vec<Row>, ReproduceError> {
    context.tell("ranks and azimuth under acceleration");
    let pushed = |axis, acceleration| Segment {
        acceleration,
        ..turning(axis)
    };
    let body = attitude(HEADING_DEG, 30.0, 0.0);
    let constant = "Under one constant acceleration the attitude error about f itself moves no velocity, [f ×] having rank \
                    two: the roll and pitch that the paper takes as known by turning are so only at another acceleration.";
    let mut rows = Vec::new();
    for (name, axis) in [("Y", Axis::Y), ("Z", Axis::Z)] {
        let always = analyse(&body, &[pushed(axis, [0.5, 1.0])])?;
        let then = analyse(&body, &[turning(axis), pushed(axis, [0.5, 1.0])])?;
        let row = |what: &str, rank: usize| {
            Row::new(
                "[Du17] (36), (37)",
                format!("rank of Q, about {name}, pitch 30°, {what}"),
                "",
                Some(12.0),
                rank as f64,
                Criterion::Exact,
            )
        };
        rows.push(row("accelerating all the time", always.rank).remark_if_differs(constant));
        rows.push(row("at rest, then accelerating", then.rank).remark_if_differs(constant));
    }
    let rest = analyse(&body, &[turning(Axis::None), pushed(Axis::None, [0.5, 1.0])])?;
    rows.push(
        Row::new(
            "[Du17] (36), (37)",
            "rank of Q, not turning, at rest, then accelerating",
            "",
            None,
            rest.rank as f64,
            Criterion::None,
        )
        .remark("What is left out are level accelerometer biases, with the tilt."),
    );
    let imu = mti_g([0.0; 3], [0.0; 3]);
    let mut curves = Vec::new();
    let cases = [
        ("not turning", Axis::None),
        ("about Y, pitch 30°", Axis::Y),
        ("about Z, pitch 30°", Axis::Z),
    ];
    for (colour, (name, axis)) in cases.into_iter().enumerate() {
        let points = azimuth_sd(&body, axis, &imu).map_err(ReproduceError::failed)?;
        let at = |t: f64| {
            let near = points.iter().min_by(|a, b| (a.0 - t).abs().total_cmp(&(b.0 - t).abs()));
            near.map_or(f64::NAN, |p| p.1)
        };
        let (begins, lasts, _) = PUSH;
        for (when, t) in [("before", begins), ("after", begins + lasts)] {
            rows.push(
                Row::new(
                    "[Du17] (36), (37)",
                    format!("azimuth 1σ {when} 10 s of 1 m/s², {name}"),
                    "°",
                    None,
                    at(t),
                    Criterion::None,
                )
                .remark(
                    "The paper gives no number: azimuth starts at 20° 1σ, velocity is measured to 0.05 m/s at 10 Hz.",
                ),
            );
        }
        curves.push(Curve {
            label: name.to_owned(),
            points,
            thin: false,
            colour,
        });
    }
    let chart = Chart {
        title: "azimuth 1σ; 10 s of 1 m/s² north from 120 s on",
        x: ChartAxis::linear("time (s)"),
        y: ChartAxis::log("1σ (°)"),
        curves,
    };
    context.plot("azimuth.svg", |width| figure(width, core::slice::from_ref(&chart)))?;
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dynamics_are_those_of_the_paper() {
        let earth = Earth::<f64>::new(LATITUDE, 0.0).unwrap();
        let pushed = Segment {
            acceleration: [0.5, 2.0],
            ..turning(Axis::X)
        };
        let f = dynamics(&attitude(HEADING_DEG, 0.0, 0.0), &earth, &pushed);
        let (g, w) = (earth.gravity(), earth.w_ie_n());
        let expect = |i, j, value: f64| assert!((f[(i, j)] - value).abs() < 1e-12, "{i} {j}: {} {value}", f[(i, j)]);
        // (36), (37).
        expect(0, 1, 2.0 * w.z());
        expect(0, 2, -2.0 * w.y());
        expect(0, 4, g);
        expect(0, 5, -2.0);
        expect(0, 6, 1.0);
        expect(1, 0, -2.0 * w.z());
        expect(1, 3, -g);
        expect(1, 5, 0.5);
        // (21).
        let (sin, cos) = (HEADING_DEG * DEG).sin_cos();
        for block in [6, 9] {
            expect(block, block + 2, -RATE * sin);
            expect(block + 1, block + 2, -RATE * cos);
            expect(block + 2, block, RATE * sin);
            expect(block, block + 1, 0.0);
        }
        expect(4, 10, 1.0);
    }

    #[test]
    fn held_is_the_integral() {
        for test in tables().iter().flat_map(|t| t.tests) {
            let turntable = Turntable::new(&test, mti_g([0.0; 3], [0.0; 3])).unwrap();
            let t = 12.3;
            let held = turntable.held(Vec3::new(1.0, 2.0, 3.0), t, 0.01);
            let parts = 1000;
            let mut sum = Vector3::zeros();
            for k in 0..parts {
                let at = t + 0.01 * (f64::from(k) + 0.5) / f64::from(parts);
                let c = turntable.c_nb * turntable.c_bs(at);
                sum += (c.inverse() * Vec3::new(1.0, 2.0, 3.0)).vector() * (0.01 / f64::from(parts));
            }
            assert!((held - sum).norm() < 1e-10, "{} {held} {sum}", test.name);
        }
    }

    #[test]
    fn turning_finds_what_rest_does_not() {
        let [_, table] = tables();
        let [rest, level, tilted] = table.tests.map(|test| {
            let turntable = Turntable::new(&test, table.imu).unwrap();
            (0..4).map(|seed| turntable.run(seed).unwrap()).collect::<Vec<_>>()
        });
        let truth = table.imu.gyro_bias.z / DEG_PER_HOUR;
        let z = |runs: &[Vec<Point>]| (summary(runs, 8).0 - truth).abs();
        assert!(z(&tilted) < 60.0, "{}", z(&tilted));
        assert!(z(&level) > 500.0 && z(&rest) > 500.0, "{} {}", z(&level), z(&rest));
        for angle in [0, 1] {
            assert!(summary(&tilted, angle).0 < 0.15);
            assert!(summary(&rest, angle).0 > 0.2 && summary(&level, angle).0 > 0.2);
        }
        assert!(summary(&tilted, 2).0 < 3.0 && summary(&rest, 2).0 > 20.0);
    }

    #[test]
    fn acceleration_tells_azimuth() {
        let imu = mti_g([0.0; 3], [0.0; 3]);
        let points = azimuth_sd(&attitude(HEADING_DEG, 30.0, 0.0), Axis::Y, &imu).unwrap();
        let at = |t: f64| points.iter().find(|p| p.0 >= t).unwrap().1;
        assert!(at(115.0) > 19.0 && at(131.0) < 2.0, "{} {}", at(115.0), at(131.0));
    }
}
