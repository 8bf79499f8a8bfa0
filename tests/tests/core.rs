//! The core on simulated samples: rounding, compensation, gaps, any place and attitude.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test stops at the first surprise"
)]

use frames::Real;
use frames::units::{DEG, DEG_PER_SQRT_HOUR};
use hal_sim::align::{self, Angles, Method, Reading, Setup};
use hal_sim::config::Angle;
use hal_sim::scenario::Scenario;
use hal_sim::simulate::{self, Row, Simulation};
use nav::aligner::{Aligner, Event, Mode, NotReady, Restart};
use nav::increment::Sample;
use nav::model::{PAPER, ROBUST};
use proptest::prelude::*;

fn paper_sim() -> Scenario {
    Scenario::builtin("paper-sim").unwrap()
}

/// Feeds rows to an aligner in precision `T`, each changed by `change`, and reads the result.
fn align<T: Real, const B: usize>(
    scenario: &Scenario,
    rows: impl Iterator<Item = Row>,
    change: impl Fn(&mut Row),
) -> Aligner<T, B> {
    let mut aligner = Setup::of(scenario, Method::Robust).aligner::<T, B>().unwrap();
    for mut row in rows {
        change(&mut row);
        aligner.step(&align::cast(&row.sample), T::lit(row.encoder));
    }
    aligner
}

fn reading<T: Real, const B: usize>(aligner: &Aligner<T, B>) -> Reading {
    Reading::from_estimate(&aligner.estimate().unwrap())
}

#[test]
fn single_precision_is_enough() {
    for seed in 1..=5 {
        let scenario = paper_sim();
        let rows: Vec<_> = Simulation::new(&scenario, seed).unwrap().collect();
        let single = reading(&align::<f32, ROBUST>(&scenario, rows.iter().copied(), |_| ())).attitude;
        let double = reading(&align::<f64, ROBUST>(&scenario, rows.iter().copied(), |_| ())).attitude;
        let off = single.minus(&double);
        assert!(off.heading_deg.abs() <= 0.02, "{off:?}");
        assert!(off.pitch_deg.abs() <= 0.0005 && off.roll_deg.abs() <= 0.0005, "{off:?}");
    }
}

/// ½ Δθ × Δv is what makes the swing harmless: taken out of the samples beforehand, so that the core puts in no more
/// than was taken, it costs tenths of a degree to degrees, and the innovations show it.
#[test]
fn the_rotation_term_carries_the_heading() {
    let mut scenario = paper_sim();
    scenario.imu = hal_sim::unit::Unit::perfect();
    let truth = |simulation: &Simulation| Angles::from_attitude(&simulation.truth().attitude(300.0));
    let simulation = Simulation::new(&scenario, 1).unwrap();
    let expected = truth(&simulation);
    let with = reading(&align::<f64, PAPER>(&scenario, simulation.clone(), |_| ()))
        .attitude
        .minus(&expected);
    assert!(with.heading_deg.abs() < 0.001, "{with:?}");
    let aligner = align::<f64, PAPER>(&scenario, simulation, |row| {
        let Sample { dtheta_s, dv_s, .. } = row.sample;
        row.sample.dv_s = dv_s - dtheta_s.cross(dv_s) * 0.5;
    });
    let without = reading(&aligner).attitude.minus(&expected);
    assert!(without.heading_deg.abs() > 0.1, "{without:?}");
    assert!(
        matches!(aligner.not_ready(), Some(NotReady::Inconsistent { ratio }) if ratio > 100.0),
        "{:?}",
        aligner.not_ready()
    );
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let run = || {
        let result = simulate::run::<f32>(&paper_sim(), 42, Method::Stf, &mut ()).unwrap();
        format!("{result:?}")
    };
    assert_eq!(run(), run());
}

/// Any change of this figure is a change of the numerics and belongs in the changelog.
#[test]
fn golden_run() {
    let last = simulate::run::<f32>(&paper_sim(), 1, Method::Kf, &mut ())
        .unwrap()
        .last
        .unwrap();
    assert!(
        (last.reading.attitude.heading_deg - 336.063_804).abs() < 1e-4,
        "{:?}",
        last.reading.attitude
    );
}

#[test]
fn lost_samples_are_bridged_and_long_gaps_start_anew() {
    let scenario = paper_sim();
    let rows: Vec<_> = Simulation::new(&scenario, 7).unwrap().collect();
    // Every hundredth sample is missing.
    let mut aligner = Setup::of(&scenario, Method::Robust).aligner::<f32, ROBUST>().unwrap();
    let (mut lost, mut bridged) = (0, 0);
    let mut gap = 0.0;
    for (k, row) in rows.iter().enumerate() {
        if k % 100 == 57 {
            gap += row.sample.dt;
            lost += 1;
            continue;
        }
        let sample = Sample { gap, ..row.sample };
        gap = 0.0;
        let event = aligner.step(&align::cast(&sample), row.encoder as f32);
        bridged += usize::from(matches!(event, Some(Event::Bridged { .. })));
        assert!(!matches!(event, Some(Event::Restarted(_))), "{event:?}");
    }
    // A bridge may share its step with an event that says more.
    assert!(lost - bridged <= 2 && lost == 300, "{lost} {bridged}");
    let truth = Angles::from_attitude(&Simulation::new(&scenario, 7).unwrap().truth().attitude(300.0));
    let reading = reading(&aligner);
    let error = reading.attitude.minus(&truth);
    assert!(error.heading_deg.abs() < 3.0 * reading.sd.heading_deg, "{error:?}");
    assert!(error.pitch_deg.abs() < 0.01 && error.roll_deg.abs() < 0.01, "{error:?}");

    // Two seconds without data: nothing is left to stand on.
    let last = rows.last().unwrap();
    let event = aligner.step(
        &align::cast(&Sample {
            gap: 2.0,
            ..last.sample
        }),
        last.encoder as f32,
    );
    assert_eq!(event, Some(Event::Restarted(Restart::Gap { length: 2.0 })));
    assert_eq!(aligner.mode(), Mode::Settling);
}

#[test]
fn bad_samples_start_anew_and_never_reach_the_estimate() {
    let scenario = paper_sim();
    let mut rows = Simulation::new(&scenario, 8).unwrap();
    let mut aligner = Setup::of(&scenario, Method::Robust).aligner::<f32, ROBUST>().unwrap();
    for row in rows.by_ref().take(8_000) {
        aligner.step(&align::cast(&row.sample), row.encoder as f32);
    }
    assert_eq!(aligner.mode(), Mode::Aligned);
    let good: Sample<f32> = align::cast(&rows.next().unwrap().sample);
    for bad in [
        Sample { dt: 0.0, ..good },
        Sample { dt: f32::NAN, ..good },
        Sample { gap: -1.0, ..good },
        Sample {
            dtheta_s: good.dtheta_s * f32::INFINITY,
            ..good
        },
        Sample {
            dv_s: good.dv_s * f32::NAN,
            ..good
        },
    ] {
        let mut aligner = aligner.clone();
        assert_eq!(aligner.step(&bad, 0.0), Some(Event::Restarted(Restart::BadSample)));
        assert!(aligner.estimate().is_none());
        assert!(matches!(aligner.not_ready(), Some(NotReady::Collecting { .. })));
    }
    assert_eq!(
        aligner.step(&good, f32::NAN),
        Some(Event::Restarted(Restart::BadSample))
    );
}

/// In free fall there is no direction of gravity, and the aligner says so instead of dividing by it.
#[test]
fn free_fall_is_a_typed_refusal() {
    let mut aligner = Setup::of(&paper_sim(), Method::Robust)
        .aligner::<f32, ROBUST>()
        .unwrap();
    let sample = Sample {
        dtheta_s: frames::Vec3::new(0.0, 0.0, 3.5e-3),
        dv_s: frames::Vec3::zero(),
        dt: 0.01,
        gap: 0.0,
    };
    let restarted = (0..6_000).find_map(|_| aligner.step(&sample, 0.0));
    assert!(
        matches!(
            restarted,
            Some(Event::Restarted(Restart::Coarse(
                nav::coarse::CoarseError::Gravity { .. }
            )))
        ),
        "{restarted:?}"
    );
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    /// Any latitude that is accepted, any heading, tilt to 30°: the error is within what σ says.
    #[test]
    fn any_place_and_attitude(
        latitude_deg in -85.0..85.0_f64, heading_deg in 0.0..360.0_f64,
        pitch_deg in -22.0..22.0_f64, roll_deg in -22.0..22.0_f64, seed in 0..1_000_000_u64,
    ) {
        let mut scenario = paper_sim();
        scenario.place.latitude_deg = latitude_deg;
        scenario.swing.heading.centre_deg = Angle::Degrees(heading_deg);
        scenario.swing.pitch.centre_deg = Angle::Degrees(pitch_deg);
        scenario.swing.roll.centre_deg = Angle::Degrees(roll_deg);
        let result = simulate::run::<f32>(&scenario, seed, Method::Robust, &mut ()).unwrap();
        // Two headings that fit are reported as such, and neither is believed; nor is the wrong one of the two once
        // the innovations speak against it.
        prop_assume!(result.state == "aligned" || result.state == "fine");
        let last = result.last.unwrap();
        let (error, sd) = (last.error, last.reading.sd);
        prop_assert!(error.heading_deg.abs() < 5.0 * sd.heading_deg, "{error:?} {sd:?}");
        prop_assert!(error.pitch_deg.abs() < 5.0 * sd.pitch_deg, "{error:?} {sd:?}");
        prop_assert!(error.roll_deg.abs() < 5.0 * sd.roll_deg + 1e-4, "{error:?} {sd:?}");
        // Random walk over Earth's rate, as the simple formula has it, is the least that σ can be.
        let simple = hal_sim::monte_carlo::random_walk_limit_deg(&scenario);
        prop_assert!(sd.heading_deg > 0.95 * simple, "{sd:?} {simple}");
    }

    /// Hostile samples of any size: no panic, and no estimate that is not finite.
    #[test]
    fn any_samples(values in proptest::collection::vec(proptest::array::uniform8(proptest::num::f32::ANY), 1..40)) {
        let mut aligner = Setup::of(&paper_sim(), Method::Stf).aligner::<f32, PAPER>().unwrap();
        for row in Simulation::new(&paper_sim(), 3).unwrap().take(6_000) {
            aligner.step(&align::cast(&row.sample), row.encoder as f32);
        }
        for [a, b, c, d, e, f, dt, gap] in values {
            let sample = Sample {
                dtheta_s: frames::Vec3::new(a, b, c),
                dv_s: frames::Vec3::new(d, e, f),
                dt: dt.abs(),
                gap: if gap > 0.0 { gap } else { 0.0 },
            };
            aligner.step(&sample, a);
            if let Some(estimate) = aligner.estimate() {
                prop_assert!(estimate.c_nb.quaternion().iter().all(|q| q.is_finite()), "{estimate:?}");
            }
        }
    }
}

/// At 64° north with the rotor's axis tilted by 20° a z bias of 15 °/h and one of −6 °/h explain the same samples, with
/// headings 67° apart.
#[test]
fn a_second_solution_is_seen() {
    let mut scenario = paper_sim();
    scenario.place.latitude_deg = 64.529_245;
    scenario.swing.heading.centre_deg = Angle::Degrees(34.889_592);
    scenario.swing.roll.centre_deg = Angle::Degrees(19.619_529);
    let simulation = Simulation::new(&scenario, 221_438).unwrap();
    let truth = Angles::from_attitude(&simulation.truth().attitude(300.0));
    let aligner = align::<f32, PAPER>(&scenario, simulation, |_| ());
    let Some(NotReady::Ambiguous {
        heading_offset,
        gyro_bias_z,
    }) = aligner.not_ready()
    else {
        panic!("{:?}", aligner.not_ready())
    };
    let found = reading(&aligner);
    let other = found.attitude.heading_deg + f64::from(heading_offset) / DEG;
    let nearest = |heading_deg: f64| Angles { heading_deg, ..truth }.minus(&truth).heading_deg.abs();
    assert!(
        nearest(other).min(nearest(found.attitude.heading_deg)) < 5.0,
        "{other} {found:?} {truth:?}"
    );
    assert!(
        (f64::from(gyro_bias_z) / frames::units::DEG_PER_HOUR - 15.3).abs() < 1.0,
        "{gyro_bias_z}"
    );
    // With Earth's rate for a state the right one of the two is found: the swing tells them apart.
    let robust = reading(&align::<f32, ROBUST>(
        &scenario,
        Simulation::new(&scenario, 221_438).unwrap(),
        |_| (),
    ));
    let error = robust.attitude.minus(&truth).heading_deg;
    assert!(error.abs() < 3.0 * robust.sd.heading_deg, "{robust:?} {truth:?}");
}

/// Sample rates that do and do not divide into the filter's 20 Hz.
#[test]
fn any_sample_rate() {
    for rate_hz in [10.0, 30.0, 50.0, 75.0, 200.0, 202.4, 1000.0] {
        let mut scenario = paper_sim();
        scenario.run.rate_hz = rate_hz;
        let result = simulate::run::<f32>(&scenario, 21, Method::Robust, &mut ()).unwrap();
        assert_eq!(result.state, "aligned", "{rate_hz} Hz: {:?}", result.reason);
        let last = result.last.unwrap();
        assert!(
            last.error.heading_deg.abs() < 4.0 * last.reading.sd.heading_deg,
            "{rate_hz} Hz: {last:?}"
        );
        assert!(
            (last.reading.sd.heading_deg - 0.353).abs() < 0.01,
            "{rate_hz} Hz: {last:?}"
        );
    }
}

#[test]
fn poles_are_refused() {
    let mut setup = Setup::of(&paper_sim(), Method::Robust);
    setup.latitude_deg = 86.0;
    let error = setup.aligner::<f32, ROBUST>().err().map(|e| e.to_string());
    assert!(error.is_some_and(|e| e.contains("between -85 and 85")));
    assert!((setup.latitude_deg * DEG).is_finite());
}

/// The figure that σ rests on is told where it is not the configured one: 1000 differences scatter it by 5 %.
#[test]
fn a_random_walk_that_was_measured_is_told() {
    for (told, measured) in [(0.02, true), (0.09, false)] {
        let mut scenario = paper_sim();
        scenario.run.duration_s = 70.0;
        scenario.imu.angle_random_walk_deg_sqrt_h = 0.09;
        scenario.told = Some(hal_sim::unit::Unit {
            angle_random_walk_deg_sqrt_h: told,
            ..scenario.imu.clone()
        });
        let rows = Simulation::new(&scenario, 7).unwrap();
        let walk = align::<f32, ROBUST>(&scenario, rows, |_| ()).measured_walk();
        assert_eq!(walk.is_some(), measured, "{walk:?}");
        if let Some(walk) = walk {
            let figure = f64::from(walk) / DEG_PER_SQRT_HOUR;
            assert!((figure / 0.09 - 1.0).abs() < 0.15, "{figure}");
        }
    }
}
