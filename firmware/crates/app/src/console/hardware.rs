//! The command `hardware`: fact by fact what was found, and what was expected.
//!
//! It measures nothing itself: self-test, motor calibration, homing and sampling have. What none of them has measured since the
//! start is `not measured`.

use embassy_sync::blocking_mutex::raw::RawMutex;
use frames::units::{DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, PPM};

use crate::nmea::{Sentence, SentenceBuilder};
use crate::rotor::Side;
use crate::selftest::InspectionConfig;
use crate::shared::Shared;

/// The facts, in the order of bringing up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fact {
    Clock,
    Supply,
    BrownOut,
    Imu,
    Period,
    Samples,
    Force,
    Rate,
    Noise,
    Delay,
    Encoder,
    Eccentricity,
    Home,
    Homed,
    Offset,
    Motor,
}

pub(super) static FACTS: [Fact; 16] = [
    Fact::Clock,
    Fact::Supply,
    Fact::BrownOut,
    Fact::Imu,
    Fact::Period,
    Fact::Samples,
    Fact::Force,
    Fact::Rate,
    Fact::Noise,
    Fact::Delay,
    Fact::Encoder,
    Fact::Eccentricity,
    Fact::Home,
    Fact::Homed,
    Fact::Offset,
    Fact::Motor,
];

const NOT_MEASURED: &str = "not measured";

/// The line of a fact. `supply` says whether it is enough, and whether the brown-out level guards it.
pub(super) fn tell<M: RawMutex>(shared: &Shared<M>, [enough, guarded]: [bool; 2], fact: Fact) -> Sentence {
    let (measured, settings) = (shared.measured(), shared.settings());
    let (imu, counts) = (shared.imu(), shared.sample_counts());
    let inspection = InspectionConfig::for_imu(&settings.noise);
    let mut line = SentenceBuilder::answer(true);
    match fact {
        Fact::Clock => line.words(if shared.clock().is_exact() {
            "clock crystal - as expected"
        } else {
            "clock the chip's own - expected a crystal"
        }),
        Fact::Supply => line.words(if enough {
            "supply above 2.8 V - as expected"
        } else {
            "supply below 2.8 V - expected above"
        }),
        Fact::BrownOut => line.words(if guarded {
            "brown-out level 3 - as expected"
        } else {
            "brown-out level below 3 - expected 3"
        }),
        Fact::Imu => {
            line.words("imu ");
            match imu {
                Some(facts) => {
                    line.count(facts.identity.product.into());
                    line.words(" - as expected");
                }
                None => line.words(NOT_MEASURED),
            }
        }
        Fact::Period => {
            let nominal = imu.map(|facts| facts.period);
            let of = nominal.zip(measured.period);
            line.found("imu period ", of.map(|(_, found)| found * 1e6), 1, " us");
            if let Some((nominal, found)) = of {
                line.found(" - expected ", Some(nominal * 1e6), 1, "");
                line.found(" off ", Some((found / nominal - 1.0) / PPM as f32), 0, " ppm");
            }
        }
        Fact::Samples => {
            line.words("samples lost ");
            line.count(counts.tally.lost);
            line.words(" of ");
            line.count(counts.tally.received);
            line.words(" - expected 0");
        }
        Fact::Force => {
            line.found("force ", measured.found.map(|found| found.gravity), 3, " m/s2");
            line.found(" - expected ", Some(inspection.gravity), 1, "");
        }
        Fact::Rate => {
            let scale = DEG_PER_HOUR as f32;
            line.found("rate ", measured.found.map(|found| found.rate / scale), 0, " deg/h");
            line.found(
                " - expected at rest below ",
                Some(inspection.rest_rate_max / scale),
                0,
                "",
            );
        }
        Fact::Noise => {
            let scale = DEG_PER_SQRT_HOUR as f32;
            let noise = measured.found.map(|found| found.noise / scale);
            line.found("gyro noise ", noise, 3, " deg/sqrt(h)");
            line.found(" - expected ", Some(settings.noise.angle_random_walk / scale), 3, "");
        }
        Fact::Delay => {
            let delay = measured.delay;
            line.found("imu delay ", delay.map(|found| found.delay * 1e3), 2, " ms");
            if let Some(found) = delay {
                line.found(" sd ", Some(found.sd * 1e3), 2, " - expected 0.00");
            }
        }
        Fact::Encoder => line.words(match measured.encoder {
            Some(true) => "encoder answers - as expected",
            Some(false) => "encoder does not answer - expected an answer",
            None => "encoder not measured",
        }),
        Fact::Eccentricity => line.words("encoder eccentricity not measured"),
        Fact::Home => line.words(match measured.home {
            Some(Some(Side::Below)) => "home switch below - expected below or above",
            Some(Some(Side::Above)) => "home switch above - expected below or above",
            Some(None) => "home switch none - expected below or above",
            None => "home switch not measured",
        }),
        Fact::Homed => line.found("homed at ", measured.homed.map(|angle| angle / DEG as f32), 2, " deg"),
        Fact::Offset => {
            let offset = settings.encoder.electrical_offset.map(|angle| angle / DEG as f32);
            line.found("motor offset ", offset, 2, " deg");
            if offset.is_some() {
                line.words(" - direction and pole pairs as expected");
            }
        }
        Fact::Motor => line.words("motor resistance and torque constant not measured"),
    }
    line.end()
}

impl SentenceBuilder {
    /// A figure between words, or that it was not measured.
    #[inline(never)]
    fn found(&mut self, name: &str, value: Option<f32>, decimals: usize, unit: &str) {
        self.words(name);
        match value {
            Some(value) => {
                self.decimal(value, decimals);
                self.words(unit);
            }
            None => self.words(NOT_MEASURED),
        }
    }
}
