//! What a seed makes of a scenario, the same at every level that has a motor: the unit as built, and what its IMU is
//! exposed to.

use drivers::adis16495;
use frames::units::{ARC_SEC, DEG};
use frames::{Sensor, Vec3};
use nav::rotor::RotorState;
use rand::RngExt;

use crate::device::Motion;
use crate::plant::{Cable, Plant, PlantConfig};
use crate::scenario::Scenario;
use crate::sensors::{Imu, Measured, Stream, stream};
use crate::truth::Truth;

/// Spread of a motor's figures about those the firmware is told.
const MOTOR_SPREAD: f64 = 0.1;
/// Room beyond the schedule's travel that the cable has, rad.
const CABLE_ROOM: f64 = 15.0 * DEG;
/// Longest time between two samples that tell the base's acceleration, s.
const NEIGHBOURS_S: f64 = 0.02;

/// The unit's mechanics as drawn from the seed: the motor with its load.
#[derive(Debug, Clone, PartialEq)]
pub struct UnitModel {
    /// Its figures.
    pub plant: PlantConfig,
    /// Where the rotor stands at power-up, rad.
    pub angle: f64,
    /// Seed of the encoder's noise.
    pub encoder_seed: u64,
}

impl UnitModel {
    /// The motor the seed gives for a scenario: a home switch in the middle of the travel, a cable with some room.
    pub fn new(scenario: &Scenario, seed: u64) -> Self {
        let mut start = stream(seed, Stream::RotorStart);
        let mut made = stream(seed, Stream::Plant);
        let travel = scenario.rotor.travel_deg * DEG;
        let edge = 0.5 * travel;
        let plant = PlantConfig {
            cable: PlantConfig::default().cable.map(|cable| Cable {
                low: -CABLE_ROOM,
                high: travel + CABLE_ROOM,
                rest: edge,
                ..cable
            }),
            home_edge: edge,
            ..PlantConfig::default()
        }
        .varied(made.random(), MOTOR_SPREAD);
        Self {
            plant,
            angle: start.random_range(0.0..travel),
            encoder_seed: made.random(),
        }
    }

    /// The same motor with its encoder mounted anew: without an error of its own, and at `zero`, rad, where α is zero.
    pub fn remount_encoder(&mut self, zero: f64) {
        let turned = self.plant.encoder_zero - zero;
        // The windings stay where they are in the housing.
        self.plant.electrical_offset += f64::from(self.plant.pole_pairs) * turned;
        self.plant.encoder_zero = zero;
        self.plant.encoder_harmonics.clear();
    }

    /// The encoder's error as (order, amplitude in rad, phase in rad): that of the part, and what the scenario adds,
    /// which no table corrects.
    pub fn harmonics(&self, scenario: &Scenario) -> Vec<(u16, f64, f64)> {
        let left = scenario.encoder.harmonics.iter().map(|h| {
            (
                u16::try_from(h.order).unwrap_or(u16::MAX),
                h.amplitude_arcsec * ARC_SEC,
                h.phase_deg * DEG,
            )
        });
        self.plant.encoder_harmonics.iter().copied().chain(left).collect()
    }

    /// The motor, at rest.
    pub fn build(self) -> Plant {
        Plant::new(self.plant, self.angle, self.encoder_seed)
    }
}

/// What the IMU of a unit measures: the truth's motion with the rotor's, and its errors.
///
/// # One seed, one noise
///
/// The noise of a sample belongs to its place in time, one draw a nominal period since power-up. Two levels that start
/// sampling some milliseconds apart get the same noise for the same stretch of time, and can be compared run by run.
/// Samples of another rate, from a part that is still starting, have a generator of their own.
#[derive(Debug, Clone)]
pub struct SensorSampler {
    truth: Truth,
    period: f64,
    errors: Imu,
    starting: Imu,
    /// Samples drawn from `errors`.
    drawn: u64,
    /// End of the last of them and its place in time.
    last: Option<(f64, u64)>,
    /// Time of the last sample and the base's mean rate over it.
    base: Option<(f64, f64)>,
}

impl SensorSampler {
    /// The IMU the seed gives for a scenario, on the base that moves as `truth`.
    pub fn new(scenario: &Scenario, seed: u64, truth: &Truth) -> Self {
        let base_periods = u32::from(adis16495::Config::default().dec_rate) + 1;
        let errors = Imu::new(scenario, seed);
        Self {
            truth: truth.clone(),
            period: f64::from(base_periods) / f64::from(adis16495::BASE_RATE_HZ),
            starting: errors.clone(),
            errors,
            drawn: 0,
            last: None,
            base: None,
        }
    }

    /// The sample over `t0..t1`, s, where the rotor went from `from` to `to`. The base's angular acceleration acts on
    /// the rotor by its inertia.
    pub fn sample(
        &mut self,
        (t0, from): (f64, RotorState<f64>),
        (t1, to): (f64, RotorState<f64>),
        plant: &mut Plant,
    ) -> Measured {
        let dt = t1 - t0;
        let (dtheta_s, dv_s) = self.truth.increment_driven((t0, from), (t1, to));
        // The housing's own turning takes the rotor along by its friction and its inertia against it.
        let rate = (dtheta_s.z() - (to.angle - from.angle)) / dt;
        if let Some((t, before)) = self.base
            && t1 - t < NEIGHBOURS_S
        {
            plant.load = -plant.config().inertia * (rate - before) / (t1 - t);
        }
        self.base = Some((t1, rate));
        self.errors.rotor_at(0.5 * (from.angle + to.angle));
        self.measure(t1, dt, dtheta_s, dv_s)
    }

    fn measure(&mut self, t1: f64, dt: f64, dtheta_s: Vec3<Sensor, f64>, dv_s: Vec3<Sensor, f64>) -> Measured {
        if dt < 0.5 * self.period {
            return self.starting.measure(dtheta_s, dv_s, dt);
        }
        let place = match self.last {
            // Counted on from the last one: a rounded time must not fall into its neighbour's place.
            Some((t, place)) => place + ((t1 - t) / self.period).round().max(1.0) as u64,
            None => (t1 / self.period) as u64,
        };
        while self.drawn < place {
            self.drawn += 1;
            // The motion as it is now: a bandwidth has nothing to catch up with.
            let part = self.period / dt;
            self.errors.measure(dtheta_s * part, dv_s * part, self.period);
        }
        self.last = Some((t1, place));
        self.drawn += 1;
        self.errors.measure(dtheta_s, dv_s, dt)
    }
}

/// A sample as the mean an IMU's model is given.
pub fn motion(measured: &Measured, dt: f64) -> Motion {
    Motion {
        rate: (measured.dtheta_s / dt).to_array(),
        force: (measured.dv_s / dt).to_array(),
        temperature_c: measured.temperature_c,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_noise_of_a_sample_belongs_to_its_time() {
        let scenario = Scenario::builtin("paper-sim").unwrap();
        let truth = Truth::new(&scenario, 3).unwrap();
        let noise = |first: f64, samples: u32| {
            let mut sampler = SensorSampler::new(&scenario, 3, &truth);
            let mut plant = UnitModel::new(&scenario, 3).build();
            let rest = RotorState {
                angle: plant.angle(),
                rate: 0.0,
                acceleration: 0.0,
            };
            (0..samples)
                .map(|k| {
                    let t0 = first + f64::from(k) * sampler.period;
                    let t1 = t0 + sampler.period;
                    let (exact, _) = truth.increment_driven((t0, rest), (t1, rest));
                    let measured = sampler.sample((t0, rest), (t1, rest), &mut plant);
                    (measured.dtheta_s - exact).x()
                })
                .collect::<Vec<_>>()
        };
        let period = SensorSampler::new(&scenario, 3, &truth).period;
        let (early, late) = (noise(1.0, 200), noise(1.0 + 100.2 * period, 100));
        for (a, b) in early[100..].iter().zip(&late) {
            assert!((a - b).abs() < 1e-9, "{a} {b}");
        }
    }
}
