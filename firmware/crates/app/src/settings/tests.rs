use proptest::prelude::*;

use super::*;
use crate::rotor;

/// Longest body without its version.
const FIELDS: usize = log::BUFFER - log::HEADER - 1;

/// Every group, with nothing at its default.
fn unusual() -> Settings {
    let mut settings = Settings {
        identity: Identity {
            serial: 4711,
            name: *b"North 7\0\0\0\0\0\0\0\0\0",
        },
        installation: Installation {
            position: Position {
                latitude: -0.6,
                longitude: 2.5,
                height: 812.0,
                source: Source::Operator,
            },
            mounting: Mounting {
                heading: 1.5,
                pitch: -0.1,
                roll: 0.2,
            },
        },
        last_position: Position {
            latitude: 0.9,
            longitude: -1.5,
            height: -3.0,
            source: Source::Gnss,
        },
        motion: RotorConfig {
            rate: deg(15.0),
            travel: deg(400.0),
            acceleration: deg(100.0),
        },
        output: OutputConfig {
            period_ms: 200,
            status_every: 5,
            fresh_ms: 300,
            write_ms: 100,
            estimated_sd: 0.1,
            rate_tau: 1.0,
            talker: Talker::Gp,
        },
        imu: Imu {
            calibration: Some(Calibration {
                bias_s: Vec3::new(1e-3, -2e-3, 3e-4),
                k_xz: 1e-4,
                k_yz: -2e-4,
                s_z: 3e-4,
                bias_sd: 1e-6,
                column_sd: 2e-6,
                scatter: 1.1,
                rest: 60.0,
                turn: 61.0,
                turned: 21.0,
            }),
            temperature_c: 31.5,
        },
        thermal: Thermal::default(),
        encoder: Encoder {
            zero: 1.25,
            electrical_offset: Some(-0.5),
            correction: Harmonics::new(core::array::from_fn(|i| Harmonic {
                order: i as u16,
                amplitude: 1e-4,
                phase: 0.1,
            }))
            .unwrap(),
        },
        noise: ImuNoise {
            gyro_bias_sd: 1e-4,
            accel_bias_sd: 2e-2,
            angle_random_walk: 3e-5,
            velocity_random_walk: 4e-4,
            gyro_instability_sd: 5e-6,
            gyro_instability_tau: 60.0,
            gyro_scale_factor_sd: 7e-4,
            gyro_misalignment_sd: 8e-4,
            gyro_g_sensitivity_sd: 9e-6,
            gyro_housing_sd: 1e-6,
            accel_scale_factor_sd: 2e-4,
            accel_misalignment_sd: 3e-4,
            accel_instability_sd: 4e-5,
            accel_instability_tau: 70.0,
        },
        deviation: Some(Deviation {
            rate_b: [1e-6, -2e-6],
            force_b: [0.3, -0.4],
            sd: 1e-7,
        }),
    };
    settings.thermal.used = 3;
    for (i, row) in settings.thermal.rows.iter_mut().take(3).enumerate() {
        *row = ThermalRow {
            temperature_c: 20.0 * i as f32,
            bias_s: [1e-4 * i as f32, -1e-4, 0.0],
        };
    }
    settings
}

#[test]
fn all_fields_come_back() {
    let (from, mut to) = (unusual(), Settings::default());
    for group in Group::ALL {
        let mut bytes = [0; FIELDS];
        let length = from.encode(group, &mut bytes).unwrap();
        // With the version in front, and something in hand.
        assert!(length < 128, "{group} {length}");
        to.decode(group, group.version(), &mut bytes[..length]).unwrap();
        // Nothing is taken of a record of another length.
        let whole = to;
        for wrong in [0, 1, length - 1, length + 1] {
            assert!(
                to.decode(group, group.version(), &mut bytes[..wrong]).is_err(),
                "{group} {wrong}"
            );
        }
        assert_eq!(to, whole);
        assert_eq!(from.encode(group, &mut bytes[..length - 1]), Err(Invalid::Length));
    }
    assert_eq!(to, from);
}

/// Noise of version 1 ends with the misalignments of the gyros.
#[test]
fn noise_of_version_1_keeps_the_new_fields() {
    let (from, mut bytes) = (unusual(), [0; FIELDS]);
    let length = from.encode(Group::Noise, &mut bytes).unwrap();
    let mut to = Settings::default();
    to.decode(Group::Noise, 1, &mut bytes[..length - 24]).unwrap();
    let noise = ImuNoise {
        gyro_g_sensitivity_sd: 0.0,
        gyro_housing_sd: 0.0,
        accel_scale_factor_sd: 0.0,
        accel_misalignment_sd: 0.0,
        accel_instability_sd: 0.0,
        accel_instability_tau: 100.0,
        ..from.noise
    };
    assert_eq!(to.noise, noise);
}

#[test]
fn keys_are_for_ever() {
    let keys = Group::ALL.map(|group| (group.as_str(), group.key()));
    assert_eq!(
        keys,
        [
            ("identity", 0),
            ("installation", 1),
            ("last-position", 2),
            ("motion", 3),
            ("output", 4),
            ("imu", 5),
            ("thermal", 6),
            ("encoder", 7),
            ("noise", 8),
            ("deviation", 9)
        ]
    );
    assert!(usize::from(Group::Deviation.key()) < log::KEYS);
}

#[test]
fn the_defaults_are_good_and_those_of_the_parts() {
    let settings = Settings::default();
    for group in Group::ALL {
        assert_eq!(settings.validate(group), Ok(()));
    }
    assert_eq!(settings.motion, rotor::Config::default().schedule);
    assert_eq!(settings.output, OutputConfig::default());
    assert_eq!(settings.encoder.zero, rotor::Config::default().encoder_zero);
}

/// What the settings take, the rotor takes.
#[test]
fn every_corner_of_the_motion_has_room() {
    for rate in [5.0, 45.0] {
        for travel in [270.0, 520.0] {
            for acceleration in [50.0, 1000.0] {
                let settings = Settings {
                    motion: RotorConfig {
                        rate: deg(rate),
                        travel: deg(travel),
                        acceleration: deg(acceleration),
                    },
                    ..Settings::default()
                };
                assert_eq!(settings.validate(Group::Motion), Ok(()));
                let config = rotor::Config {
                    schedule: settings.motion,
                    ..rotor::Config::default()
                };
                assert!(config.validate().is_ok(), "{rate} {travel} {acceleration}");
            }
        }
    }
}

#[test]
fn what_cannot_be_is_refused_with_its_range() {
    type Change = fn(&mut Settings);
    let cases: [(Group, Change, &str); 17] = [
        (
            Group::Identity,
            |s| s.identity.serial = 1 << 24,
            "serial number must be between 0 and 16777215",
        ),
        (
            Group::Identity,
            |s| s.identity.name = *b"North*7\0\0\0\0\0\0\0\0\0",
            "name must be printable ASCII without $ * , ! and \\",
        ),
        (
            Group::Identity,
            |s| s.identity.name[15] = b'x',
            "name must be printable ASCII without $ * , ! and \\",
        ),
        (
            Group::Installation,
            |s| s.installation.position.latitude = 1.5,
            "latitude must be between -1.4835298 and 1.4835298",
        ),
        (
            Group::Installation,
            |s| s.installation.mounting.pitch = 2.0,
            "mounting pitch must be between -1.5707964 and 1.5707964",
        ),
        (
            Group::LastPosition,
            |s| s.last_position.height = f32::NAN,
            "height must be between -12000 and 30000",
        ),
        (
            Group::Motion,
            |s| s.motion.rate = 0.0,
            "rotor rate must be between 0.08726646 and 0.7853982",
        ),
        (
            Group::Output,
            |s| s.output.period_ms = 0,
            "output period_ms must be between 50 and 10000",
        ),
        (
            Group::Imu,
            |s| s.imu.calibration.as_mut().unwrap().bias_s = Vec3::new(0.0, 0.0, 0.2),
            "gyro bias must be between -0.1 and 0.1",
        ),
        (
            Group::Imu,
            |s| s.imu.calibration.as_mut().unwrap().k_yz = f32::INFINITY,
            "gyro column must be between -0.05 and 0.05",
        ),
        (
            Group::Thermal,
            |s| s.thermal.rows[2].temperature_c = 20.5,
            "thermal temperature must be between 21 and 125",
        ),
        (
            Group::Thermal,
            |s| s.thermal.used = 7,
            "thermal rows must be between 0 and 6",
        ),
        (
            Group::Encoder,
            |s| s.encoder.zero = -0.1,
            "encoder zero must be between 0 and 6.2831855",
        ),
        (
            Group::Encoder,
            |s| s.encoder.electrical_offset = Some(f32::NAN),
            "electrical offset must be between -6.2831855 and 6.2831855",
        ),
        (
            Group::Encoder,
            |s| {
                let rows = [Harmonic {
                    order: 1,
                    amplitude: 0.11,
                    phase: 0.0,
                }; HARMONICS];
                s.encoder.correction = Harmonics::new(rows).unwrap();
            },
            "harmonic amplitude must be between -0.1 and 0.1",
        ),
        (
            Group::Noise,
            |s| s.noise.gyro_bias_sd = -0.1,
            "gyro bias sd must be between 0 and 0.1",
        ),
        (
            Group::Noise,
            |s| s.noise.angle_random_walk = 0.0,
            "angle random walk must be between 0.0000002908882 and 0.002908882",
        ),
    ];
    for (group, change, text) in cases {
        let mut settings = unusual();
        change(&mut settings);
        let error = settings.validate(group).unwrap_err();
        assert_eq!(settings.encode(group, &mut [0; FIELDS]), Err(error));
        assert_eq!(std::format!("{error}"), text);
    }
}

#[test]
fn bias_over_temperature() {
    let near = |thermal: &Thermal, t: f32, x: f32| (thermal.bias_s(t).x() - x).abs() < 1e-9;
    let none = Thermal::default();
    assert!(near(&none, 20.0, 0.0));
    let some = unusual().thermal;
    for (t, x) in [
        (-40.0, 0.0),
        (0.0, 0.0),
        (5.0, 2.5e-5),
        (20.0, 1e-4),
        (39.0, 1.95e-4),
        (90.0, 2e-4),
    ] {
        assert!(near(&some, t, x), "{t}");
    }
    assert_eq!(some.bias_s(f32::NAN).y(), -1e-4);
}

#[test]
fn the_position_used() {
    let mut settings = unusual();
    assert_eq!(settings.position(), settings.installation.position);
    settings.installation.position.source = Source::Default;
    assert_eq!(settings.position(), settings.last_position);
    assert_eq!(Settings::default().position(), Position::default());
}

/// What those who use the settings want of them, by their own checks and not by the walk's.
fn usable(settings: &Settings) -> bool {
    let position = |p: &Position| nav::earth::Earth::new(p.latitude, p.height).is_ok();
    let Mounting { heading, pitch, roll } = settings.installation.mounting;
    let config = settings.rotor(rotor::Config::default());
    let calibrated = settings.imu.calibration.is_none_or(|c| {
        let column = c.k_xz.abs().max(c.k_yz.abs()).max(c.s_z.abs());
        c.bias_s.norm() < 0.2 && column < 0.1 && c.bias_sd >= 0.0 && c.column_sd >= 0.0 && c.scatter.is_finite()
    });
    let rows = settings.thermal.rows.get(..usize::from(settings.thermal.used));
    position(&settings.installation.position)
        && position(&settings.last_position)
        && [heading, pitch, roll].iter().all(|angle| angle.abs() < 3.2)
        && config.validate().is_ok()
        && settings.output.period_ms >= 50
        && settings.output.write_ms < 1001
        && settings.output.estimated_sd >= 0.0
        && settings.output.rate_tau >= 0.0
        && calibrated
        && rows.is_some_and(|rows| rows.is_sorted_by(|a, b| a.temperature_c < b.temperature_c))
        && (-99..199).all(|t| settings.thermal.bias_s(t as f32).norm() < 0.2)
        && core::str::from_utf8(&settings.identity.name).is_ok_and(str::is_ascii)
}

proptest! {
    /// Whatever a record holds: no panic, and only values that pass.
    #[test]
    fn any_bytes_are_refused_or_good(
        group in 0..GROUPS,
        version in 0_u8..4,
        mut bytes in proptest::collection::vec(any::<u8>(), 0..130),
    ) {
        let group = Group::ALL[group];
        let mut settings = unusual();
        match settings.decode(group, version, &mut bytes) {
            Ok(()) => {
                prop_assert!(usable(&settings), "{:?}", settings);
                prop_assert_eq!(settings.validate(group), Ok(()));
            }
            Err(_) => prop_assert_eq!(settings, unusual()),
        }
    }

    /// The same of records that are nearly right: of random bytes alone hardly any has the right length.
    #[test]
    fn any_change_is_refused_or_good(group in 0..GROUPS, at in 0..128_usize, to in any::<[u8; 4]>()) {
        let group = Group::ALL[group];
        let mut bytes = [0; FIELDS];
        let length = unusual().encode(group, &mut bytes).unwrap();
        let at = at % length;
        for (old, new) in bytes[at..length].iter_mut().zip(to) {
            *old = new;
        }
        let mut settings = unusual();
        match settings.decode(group, group.version(), &mut bytes[..length]) {
            Ok(()) => {
                prop_assert!(usable(&settings), "{:?}", settings);
                prop_assert_eq!(settings.validate(group), Ok(()));
            }
            Err(_) => prop_assert_eq!(settings, unusual()),
        }
    }
}
