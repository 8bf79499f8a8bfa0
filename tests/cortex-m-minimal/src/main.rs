//! The core alone on a Cortex-M4F: samples in, heading out.
//!
//! `nav` and `frames` are all of this project that it takes. A loop that reads the IMU and the encoder is the rest; here
//! [`Imu`] stands in for them, a unit at rest whose rotor turns by its schedule. Run in QEMU, with a heading at the end:
//!
//! ```text
//! cd tests/cortex-m-minimal && cargo run --release
//! ```
#![no_std]
#![no_main]

use core::mem::MaybeUninit;

use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use frames::units::{DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, MICRO_G};
use frames::{Body, Nav, Rot, Sensor, Vec3};
use nav::aligner::{Aligner, AlignerConfig, AlignerError, Event};
use nav::earth::Earth;
use nav::fine::FilterConfig;
use nav::increment::Sample;
use nav::rotor::{RotorConfig, Schedule};
use panic_semihosting as _;
use static_cell::StaticCell;

/// Where the unit stands, rad: to 0.1° is enough.
const LATITUDE: f32 = (48.0 * DEG) as f32;
/// Between samples, s.
const DT: f32 = 0.01;
/// How long it aligns, s.
const SECONDS: u32 = 300;

/// 39 kB, most of it the queue of the first minute: in a static, and never on the stack.
static ALIGNER: StaticCell<Aligner> = StaticCell::new();

#[entry]
fn main() -> ! {
    let status = match align(ALIGNER.uninit()) {
        Ok(()) => debug::EXIT_SUCCESS,
        Err(error) => {
            hprintln!("{}", error);
            debug::EXIT_FAILURE
        }
    };
    debug::exit(status);
    loop {
        cortex_m::asm::nop();
    }
}

fn align(place: &mut MaybeUninit<Aligner>) -> Result<(), AlignerError> {
    // The rotor's figures tell the aligner how long its legs are; those of the IMU are the main paper's.
    let config = AlignerConfig::for_rotor(LATITUDE, 0.0, &RotorConfig::default(), FilterConfig::default());
    let aligner = Aligner::new_in(place, config)?;
    let mut imu = Imu::start(60.0)?;

    for k in 1..=SECONDS * 100 {
        let (sample, rotor_angle) = imu.read();
        match aligner.step(&sample, rotor_angle) {
            Some(Event::CoarseDone { .. }) => hprintln!("{:3} s  coarse alignment", k / 100),
            Some(event) => hprintln!("{:3} s  {:?}", k / 100, event),
            None => {}
        }
    }
    if let Some(estimate) = aligner.estimate() {
        let deg = |x: f32| x / DEG as f32;
        let (attitude, sd) = (estimate.attitude, estimate.sd);
        hprintln!(
            "heading {:.2} deg, sd {:.2}; true 60.00",
            deg(attitude.heading),
            deg(sd.heading)
        );
        hprintln!(
            "pitch {:.3} deg, roll {:.3}; true 0.200, -0.100",
            deg(attitude.pitch),
            deg(attitude.roll)
        );
    }
    Ok(())
}

/// Stands in for the IMU and the encoder: Earth's rate and gravity in the turning IMU, biases and noise.
struct Imu {
    earth: Earth<f32>,
    schedule: Schedule<f32>,
    c_bn: Rot<Body, Nav>,
    samples: u32,
    random: u32,
}

impl Imu {
    /// A housing at rest, its front pointing there, level but for 0.2° and −0.1°. More tilt of the rotor's axis lets in the
    /// bias of the z gyro, which turning about z does not modulate.
    fn start(heading_deg: f32) -> Result<Self, AlignerError> {
        let deg = |x: f32| x * DEG as f32;
        Ok(Self {
            earth: Earth::new(LATITUDE, 0.0).map_err(AlignerError::Earth)?,
            schedule: Schedule::new(RotorConfig::default()).map_err(|_| AlignerError::Times)?,
            c_bn: Rot::<Nav, Body>::from_yaw_pitch_roll(deg(-heading_deg), deg(0.2), deg(-0.1)).inverse(),
            samples: 0,
            random: 0x2545_F491,
        })
    }

    /// Uniform with a variance of one, each axis: a xorshift.
    fn noise(&mut self) -> Vec3<Sensor> {
        let mut draw = || {
            self.random ^= self.random << 13;
            self.random ^= self.random >> 17;
            self.random ^= self.random << 5;
            (self.random as f32 / 4_294_967_296.0 - 0.5) * 3.464_101_6
        };
        Vec3::new(draw(), draw(), draw())
    }

    /// What was turned and gained in speed over the last 10 ms, and the rotor's angle at their end.
    fn read(&mut self) -> (Sample, f32) {
        let period = self.schedule.period();
        let at = |samples: f32| {
            let t = samples * DT;
            self.schedule.at(t - period * (t / period) as u32 as f32).angle
        };
        let n = self.samples as f32;
        let (before, middle, after) = (at(n), at(n + 0.5), at(n + 1.0));
        self.samples += 1;
        // The rates of the middle, in the frame of the middle: 0.2° of turn in a sample leave 1e-6 of them.
        let c_sn = Rot::<Body, Sensor>::about_z(middle).inverse() * self.c_bn;
        let rotor = Vec3::new(0.0, 0.0, after - before);
        let gyro_bias = Vec3::new(8.0, -11.0, 6.0) * DEG_PER_HOUR as f32;
        let accel_bias = Vec3::new(-90.0, 60.0, 110.0) * MICRO_G as f32;
        // Random walks of 0.02 °/√h and 10 µg/√Hz; √DT = 0.1.
        let gyro_noise = self.noise() * (0.02 * DEG_PER_SQRT_HOUR * 0.1) as f32;
        let accel_noise = self.noise() * (10.0 * MICRO_G * 0.1) as f32;
        let sample = Sample {
            dtheta_s: rotor + (c_sn * self.earth.w_ie_n() + gyro_bias) * DT + gyro_noise,
            dv_s: (c_sn * -self.earth.g_n() + accel_bias) * DT + accel_noise,
            dt: DT,
            gap: 0.0,
        };
        (sample, after)
    }
}
