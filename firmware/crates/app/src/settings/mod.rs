//! The unit's settings, and how they are kept over a power cut.
//!
//! | module | what |
//! |---|---|
//! | [`Settings`] | the values: meaning, unit, range, default |
//! | `codec` | values ⇄ bytes, with their ranges |
//! | `log` | records in flash: which one is the newest, where the next one goes |
//! | [`Store`] | the two together: load and save |
//!
//! Settings are in [`Group`]s, a record of its own each: saving one does not touch the others, and one that is damaged
//! does not take the others with it. Table of all values, format and guarantees: `docs/settings.md`.
//!
//! Not in here: what the motor learns about its ripple. It is 4 kB, and learned anew in the first two legs of every run,
//! before the alignment needs it.

mod codec;
mod log;
mod store;

use core::f32::consts::{FRAC_PI_2, PI, TAU};

use drivers::harmonics::{Harmonic, Harmonics};
use frames::units::{DEG, DEG_PER_SQRT_HOUR};
use frames::{Attitude, Body, Nav, Rot, Sensor, Vec3, wording};
use nav::aligner::AlignerConfig;
use nav::calibration::{Calibration, MAX_SCATTER};
use nav::deviation::Deviation;
use nav::fine::FilterConfig;
use nav::noise::ImuNoise;
use nav::rotor::RotorConfig;

use crate::nmea::Talker;
use crate::rotor::{self, MotorConfig};
use codec::Codec;

pub use codec::Invalid;
pub use store::{Origin, Report, Saved, Store, StoreError};

/// Rows of the table of bias over temperature.
pub const THERMAL_ROWS: usize = 6;
/// Letters of the unit's name.
pub const NAME: usize = 16;
/// Rows of the encoder's correction table.
pub const HARMONICS: usize = 8;
/// Greatest bias of a gyro, rad/s: 5.7 °/s, beyond the worst part meant.
const BIAS: f32 = 0.1;
/// Angle random walks of gyros that find north at all, rad/√s: 0.001 to 10 °/√h.
const ARW_LEAST: f32 = (0.001 * DEG_PER_SQRT_HOUR) as f32;
const ARW_MOST: f32 = (10.0 * DEG_PER_SQRT_HOUR) as f32;
/// Greatest misalignment, rad, and scale factor error.
const COLUMN: f32 = 0.05;

const fn deg(x: f64) -> f32 {
    (x * DEG) as f32
}

/// What is saved together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Group {
    /// Who the unit is.
    Identity,
    /// Where and how it is built in.
    Installation,
    /// The last good position.
    LastPosition,
    /// The rotor's reciprocation.
    Motion,
    /// The serial line's output.
    Output,
    /// The IMU's calibration.
    Imu,
    /// The gyros' bias over temperature.
    Thermal,
    /// The encoder.
    Encoder,
    /// The IMU's noise.
    Noise,
    /// The gyro error that is constant in the housing.
    Deviation,
}

/// Number of groups.
pub const GROUPS: usize = 10;

impl Group {
    /// All there are, in the order of [`Report::origins`].
    pub const ALL: [Self; GROUPS] = [
        Self::Identity,
        Self::Installation,
        Self::LastPosition,
        Self::Motion,
        Self::Output,
        Self::Imu,
        Self::Thermal,
        Self::Encoder,
        Self::Noise,
        Self::Deviation,
    ];

    /// For people.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Identity => "identity",
            Self::Installation => "installation",
            Self::LastPosition => "last-position",
            Self::Motion => "motion",
            Self::Output => "output",
            Self::Imu => "imu",
            Self::Thermal => "thermal",
            Self::Encoder => "encoder",
            Self::Noise => "noise",
            Self::Deviation => "deviation",
        }
    }

    /// Its key in flash. Never changed, never given to another group.
    pub const fn key(self) -> u8 {
        self as u8
    }

    /// The version written. A later one has more fields at its end.
    ///
    /// | group | version | |
    /// |---|---|---|
    /// | installation | 1 | position only |
    /// | | 2 | and mounting |
    /// | output | 1 | all but the talker |
    /// | | 2 | and talker |
    /// | noise | 1 | biases, walks, gyro instability, scale factors and misalignments of the gyros |
    /// | | 2 | and g-sensitivity, housing, accelerometers |
    pub const fn version(self) -> u8 {
        match self {
            Self::Installation | Self::Output | Self::Noise => 2,
            _ => 1,
        }
    }
}

wording!(Group, |self, say| {
    say!("{}", self.as_str());
});

/// Who the unit is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Identity {
    /// Serial number, below 2²⁴; 0: none given.
    pub serial: u32,
    /// Name, ASCII, filled up with zeros.
    pub name: [u8; NAME],
}

/// Where a position comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Source {
    /// Nobody has said: the program's.
    #[default]
    Default,
    /// Entered by hand.
    Operator,
    /// A receiver of satellite navigation.
    Gnss,
}

/// A position: an alignment needs latitude and height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Position {
    /// Geodetic latitude, north positive, rad.
    pub latitude: f32,
    /// Longitude, east positive, rad: for navigation only.
    pub longitude: f32,
    /// Height above the ellipsoid, m.
    pub height: f32,
    /// Where it comes from.
    pub source: Source,
}

impl Default for Position {
    fn default() -> Self {
        Self {
            latitude: deg(40.0),
            longitude: 0.0,
            height: 0.0,
            source: Source::Default,
        }
    }
}

/// How the housing sits in the vehicle: the attitude that the housing has while the vehicle is level and heads north,
/// `C_b^v = Rz(−heading) Rx(pitch) Ry(roll)` as [`frames::Attitude`] has it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mounting {
    /// Housing's front clockwise of the vehicle's, rad.
    pub heading: f32,
    /// Housing's front above the vehicle's, rad.
    pub pitch: f32,
    /// Housing's right side below the vehicle's, rad.
    pub roll: f32,
}

impl Mounting {
    /// Attitude of the vehicle whose housing has the attitude `c_nb`. Its 1σ are about those of the housing.
    pub fn vehicle(&self, c_nb: &Rot<Nav, Body>) -> Attitude {
        let Self { heading, pitch, roll } = *self;
        let c_vb = Attitude { heading, pitch, roll }.to_rot();
        Attitude::from_rot(&(*c_nb * c_vb.inverse()).relabel())
    }
}

/// Where and how the unit is built in.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Installation {
    /// The position configured.
    pub position: Position,
    /// Housing in vehicle.
    pub mounting: Mounting,
}

/// What the [output](crate::output) does.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `period_ms` | ms | as fast as estimates come; refused by the line | 100 |
/// | `status_every` | cycles | status at changes of mode only | 10 |
/// | `fresh_ms` | ms | nothing is ever valid | 150: three estimates |
/// | `write_ms` | ms | every write is given up | 80: more than the longest cycle's 50 |
/// | `estimated_sd` | rad | never E | 10° |
/// | `rate_tau` | s | the median alone | 0.5 |
/// | `talker` | | HE | what the readers take |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutputConfig {
    /// Time from cycle to cycle; one that an estimate starts may come 10 % earlier.
    pub period_ms: u32,
    /// Cycles from one status sentence to the next.
    pub status_every: u32,
    /// Age beyond which an estimate is none.
    pub fresh_ms: u32,
    /// How long a write may take.
    pub write_ms: u32,
    /// Heading 1σ beyond which there is no estimated heading either, rad.
    pub estimated_sd: f32,
    /// Time constant of the rate of turn, s.
    pub rate_tau: f32,
    /// Under which name the sentences go out.
    pub talker: Talker,
}

impl Default for OutputConfig {
    fn default() -> Self {
        Self {
            period_ms: 100,
            status_every: 10,
            fresh_ms: 150,
            write_ms: 80,
            estimated_sd: (10.0 * DEG) as f32,
            rate_tau: 0.5,
            talker: Talker::He,
        }
    }
}

/// What the calibration of the IMU found.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Imu {
    /// The gyros' errors; `None`: not calibrated.
    pub calibration: Option<Calibration>,
    /// Temperature of the IMU when its biases were found, °C.
    pub temperature_c: f32,
}

/// One row of [`Thermal`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ThermalRow {
    /// Temperature, °C.
    pub temperature_c: f32,
    /// Bias at that temperature, rad/s.
    pub bias_s: [f32; 3],
}

/// The gyros' bias over temperature: rows of ascending temperature, at least 1 °C apart.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Thermal {
    /// Rows in use.
    pub used: u8,
    /// The rows.
    pub rows: [ThermalRow; THERMAL_ROWS],
}

impl Thermal {
    /// Bias at a temperature, rad/s: linear between the rows, as in the first and the last one beyond them; zero
    /// without rows. Beside the biases of a calibration it is the difference to that at the
    /// calibration's temperature that counts.
    pub fn bias_s(&self, temperature_c: f32) -> Vec3<Sensor> {
        let rows = self.rows.get(..usize::from(self.used)).unwrap_or(&self.rows);
        let after = rows.iter().position(|row| row.temperature_c >= temperature_c);
        let (a, b, share) = match (after, rows) {
            (_, []) => return Vec3::zero(),
            (Some(0), [row, ..]) | (None, [.., row]) => (row, row, 0.0),
            (Some(next), _) => match (rows.get(next - 1), rows.get(next)) {
                (Some(a), Some(b)) => {
                    let share = (temperature_c - a.temperature_c) / (b.temperature_c - a.temperature_c);
                    (a, b, share)
                }
                _ => return Vec3::zero(),
            },
        };
        let [x, y, z] = core::array::from_fn(|i| a.bias_s[i] + share * (b.bias_s[i] - a.bias_s[i]));
        Vec3::new(x, y, z)
    }
}

/// The encoder and the motor on its shaft.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Encoder {
    /// Corrected reading at rotor angle 0, rad.
    pub zero: f32,
    /// Electrical angle at reading zero, rad; `None`: to be found at the start.
    pub electrical_offset: Option<f32>,
    /// Correction of the reading.
    pub correction: Harmonics<HARMONICS>,
}

/// All settings. The default is what holds for a unit that nobody has set.
///
/// Ranges are in `docs/settings.md`, and in the [errors](Invalid).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// [`Group::Identity`].
    pub identity: Identity,
    /// [`Group::Installation`].
    pub installation: Installation,
    /// [`Group::LastPosition`].
    pub last_position: Position,
    /// [`Group::Motion`].
    pub motion: RotorConfig,
    /// [`Group::Output`].
    pub output: OutputConfig,
    /// [`Group::Imu`].
    pub imu: Imu,
    /// [`Group::Thermal`].
    pub thermal: Thermal,
    /// [`Group::Encoder`].
    pub encoder: Encoder,
    /// [`Group::Noise`]: what aligner and navigator take the IMU for.
    pub noise: ImuNoise,
    /// [`Group::Deviation`]: the gyro error that is constant in the housing, once it has been found.
    pub deviation: Option<Deviation>,
}

impl Default for Settings {
    // Once in the image, not at every place that begins with it.
    #[inline(never)]
    fn default() -> Self {
        Self {
            identity: Identity::default(),
            installation: Installation::default(),
            last_position: Position::default(),
            motion: RotorConfig::default(),
            output: OutputConfig::default(),
            imu: Imu::default(),
            thermal: Thermal::default(),
            encoder: Encoder::default(),
            noise: ImuNoise::default(),
            deviation: None,
        }
    }
}

impl Settings {
    /// The position to align with: the configured one where somebody has entered it, or else the last good one, or
    /// else the default.
    pub fn position(&self) -> Position {
        let configured = self.installation.position;
        if configured.source == Source::Default {
            self.last_position
        } else {
            configured
        }
    }

    /// The figures of a rotor built as `built`, with what the settings say of it.
    pub fn rotor(&self, built: rotor::Config) -> rotor::Config {
        rotor::Config {
            encoder_zero: self.encoder.zero,
            schedule: self.motion,
            motor: MotorConfig {
                electrical_offset: self.encoder.electrical_offset,
                ..built.motor
            },
            ..built
        }
    }

    /// The figures of an aligner whose filter is made as `filter`, with what the settings say of place, rotor and IMU.
    pub fn aligner<const B: usize>(&self, filter: FilterConfig<f32, B>) -> AlignerConfig<f32, B> {
        let Position { latitude, height, .. } = self.position();
        let filter = FilterConfig {
            noise: self.noise,
            ..filter
        };
        AlignerConfig::for_rotor(latitude, height, &self.motion, filter)
    }

    /// Whether every value of a group can be.
    ///
    /// # Errors
    /// [`Invalid`] with the first that cannot, and its range.
    pub fn validate(&self, group: Group) -> Result<(), Invalid> {
        self.walk(group, Codec::check()).map(|_| ())
    }

    /// Body of a group's record: how many bytes of `bytes` it takes.
    ///
    /// # Errors
    /// [`Invalid`]: nothing out of range is written.
    pub fn encode(&self, group: Group, bytes: &mut [u8]) -> Result<usize, Invalid> {
        self.walk(group, Codec::write(bytes))
    }

    /// A walk that changes nothing here: it is written once for all directions, hence the copy.
    fn walk(&self, group: Group, mut codec: Codec<'_>) -> Result<usize, Invalid> {
        let mut copy = *self;
        copy.fields(group, group.version(), &mut codec);
        codec.end()
    }

    /// Takes a group over from the body of a record of this version or an earlier one. `bytes` is left as it was.
    ///
    /// # Errors
    /// [`Invalid`]; the group is then as before.
    pub fn decode(&mut self, group: Group, version: u8, bytes: &mut [u8]) -> Result<(), Invalid> {
        let mut codec = Codec::read(bytes);
        let mut new = *self;
        new.fields(group, version, &mut codec);
        codec.end()?;
        *self = new;
        Ok(())
    }

    /// Every field of a group, with its range. What an earlier version did not have keeps its value.
    fn fields(&mut self, group: Group, version: u8, c: &mut Codec<'_>) {
        match group {
            Group::Identity => {
                c.count("serial number", &mut self.identity.serial, 0, 0xFF_FFFF);
                c.text("name", &mut self.identity.name);
            }
            Group::Installation => {
                position(&mut self.installation.position, c);
                if version >= 2 {
                    let Mounting { heading, pitch, roll } = &mut self.installation.mounting;
                    c.number("mounting heading", heading, -PI, PI);
                    c.number("mounting pitch", pitch, -FRAC_PI_2, FRAC_PI_2);
                    c.number("mounting roll", roll, -PI, PI);
                }
            }
            Group::LastPosition => position(&mut self.last_position, c),
            Group::Motion => {
                let RotorConfig {
                    rate,
                    travel,
                    acceleration,
                } = &mut self.motion;
                // Within these, every combination has room for its ramps and for the home switch.
                c.number("rotor rate", rate, deg(5.0), deg(45.0));
                c.number("rotor travel", travel, deg(270.0), deg(520.0));
                c.number("rotor acceleration", acceleration, deg(50.0), deg(1000.0));
            }
            Group::Output => {
                let o = &mut self.output;
                // A cycle takes 10 ms of the line, 22 with all there is in it.
                c.count("output period_ms", &mut o.period_ms, 50, 10_000);
                c.count("output status_every", &mut o.status_every, 0, 1000);
                c.count("output fresh_ms", &mut o.fresh_ms, 60, 1000);
                c.count("output write_ms", &mut o.write_ms, 40, 1000);
                c.number("output estimated_sd", &mut o.estimated_sd, 0.0, PI);
                c.number("output rate_tau", &mut o.rate_tau, 0.0, 60.0);
                if version >= 2 {
                    let mut talker = o.talker as u8;
                    c.byte("output talker", &mut talker, Talker::ALL.len() as u8 - 1);
                    o.talker = Talker::ALL.get(usize::from(talker)).copied().unwrap_or_default();
                }
            }
            Group::Imu => self.imu.fields(c),
            Group::Thermal => {
                let Thermal { used, rows } = &mut self.thermal;
                c.byte("thermal rows", used, THERMAL_ROWS as u8);
                let mut low = -60.0;
                for row in rows.iter_mut().take(usize::from(*used)) {
                    c.number("thermal temperature", &mut row.temperature_c, low, 125.0);
                    low = row.temperature_c + 1.0;
                    c.numbers("thermal bias", &mut row.bias_s, BIAS);
                }
            }
            Group::Encoder => self.encoder.fields(c),
            Group::Noise => noise(&mut self.noise, version, c),
            Group::Deviation => deviation(&mut self.deviation, c),
        }
    }
}

fn position(position: &mut Position, c: &mut Codec<'_>) {
    // As nav::earth has them.
    c.number("latitude", &mut position.latitude, deg(-85.0), deg(85.0));
    c.number("longitude", &mut position.longitude, -PI, PI);
    c.number("height", &mut position.height, -12_000.0, 30_000.0);
    let mut source = position.source as u8;
    c.byte("position source", &mut source, Source::Gnss as u8);
    position.source = match source {
        1 => Source::Operator,
        2 => Source::Gnss,
        _ => Source::Default,
    };
}

fn noise(noise: &mut ImuNoise, version: u8, c: &mut Codec<'_>) {
    let ImuNoise {
        gyro_bias_sd,
        accel_bias_sd,
        angle_random_walk,
        velocity_random_walk,
        gyro_instability_sd,
        gyro_instability_tau,
        gyro_scale_factor_sd,
        gyro_misalignment_sd,
        gyro_g_sensitivity_sd,
        gyro_housing_sd,
        accel_scale_factor_sd,
        accel_misalignment_sd,
        accel_instability_sd,
        accel_instability_tau,
    } = noise;
    c.number("gyro bias sd", gyro_bias_sd, 0.0, BIAS);
    c.number("accelerometer bias sd", accel_bias_sd, 0.0, 1.0);
    c.number("angle random walk", angle_random_walk, ARW_LEAST, ARW_MOST);
    c.number("velocity random walk", velocity_random_walk, 0.0, 0.1);
    c.number("gyro instability", gyro_instability_sd, 0.0, BIAS);
    // Without an instability it says nothing; where there is one, the filter needs it.
    c.number("gyro instability time", gyro_instability_tau, 0.1, 1e6);
    c.number("gyro scale factor sd", gyro_scale_factor_sd, 0.0, COLUMN);
    c.number("gyro misalignment sd", gyro_misalignment_sd, 0.0, COLUMN);
    if version >= 2 {
        c.number("gyro g-sensitivity sd", gyro_g_sensitivity_sd, 0.0, BIAS);
        c.number("gyro housing sd", gyro_housing_sd, 0.0, BIAS);
        c.number("accelerometer scale factor sd", accel_scale_factor_sd, 0.0, COLUMN);
        c.number("accelerometer misalignment sd", accel_misalignment_sd, 0.0, COLUMN);
        c.number("accelerometer instability", accel_instability_sd, 0.0, 1.0);
        c.number("accelerometer instability time", accel_instability_tau, 0.1, 1e6);
    }
}

fn deviation(deviation: &mut Option<Deviation>, c: &mut Codec<'_>) {
    let mut known = u8::from(deviation.is_some());
    c.byte("deviation", &mut known, 1);
    let mut found = deviation.unwrap_or(Deviation {
        rate_b: [0.0; 2],
        force_b: [0.0; 2],
        sd: 1.0,
    });
    if known == 1 {
        c.numbers("deviation", &mut found.rate_b, BIAS);
        c.numbers("deviation force", &mut found.force_b, 100.0);
        c.number("deviation sd", &mut found.sd, f32::MIN_POSITIVE, BIAS);
    }
    *deviation = (known == 1).then_some(found);
}

impl Imu {
    fn fields(&mut self, c: &mut Codec<'_>) {
        let mut known = u8::from(self.calibration.is_some());
        c.byte("calibration", &mut known, 1);
        c.number("calibration temperature", &mut self.temperature_c, -60.0, 125.0);
        if known == 0 {
            self.calibration = None;
            return;
        }
        let mut found = self.calibration.unwrap_or(Calibration {
            bias_s: Vec3::zero(),
            k_xz: 0.0,
            k_yz: 0.0,
            s_z: 0.0,
            bias_sd: 0.0,
            column_sd: 0.0,
            scatter: 0.0,
            rest: 0.0,
            turn: 0.0,
            turned: 0.0,
        });
        let mut bias = [found.bias_s.x(), found.bias_s.y(), found.bias_s.z()];
        c.numbers("gyro bias", &mut bias, BIAS);
        let [x, y, z] = bias;
        found.bias_s = Vec3::new(x, y, z);
        for value in [&mut found.k_xz, &mut found.k_yz, &mut found.s_z] {
            c.number("gyro column", value, -COLUMN, COLUMN);
        }
        c.number("gyro bias sd", &mut found.bias_sd, 0.0, BIAS);
        c.number("gyro column sd", &mut found.column_sd, 0.0, COLUMN);
        c.number("scatter", &mut found.scatter, 0.0, MAX_SCATTER as f32);
        c.number("rest", &mut found.rest, 0.0, 3600.0);
        c.number("turn", &mut found.turn, 0.0, 3600.0);
        c.number("turned", &mut found.turned, 0.0, 1e4);
        self.calibration = Some(found);
    }
}

impl Encoder {
    fn fields(&mut self, c: &mut Codec<'_>) {
        c.number("encoder zero", &mut self.zero, 0.0, TAU);
        let mut known = u8::from(self.electrical_offset.is_some());
        let mut offset = self.electrical_offset.unwrap_or_default();
        c.byte("electrical offset known", &mut known, 1);
        c.number("electrical offset", &mut offset, -TAU, TAU);
        self.electrical_offset = (known == 1).then_some(offset);
        let mut rows = *self.correction.rows();
        for Harmonic {
            order,
            amplitude,
            phase,
        } in &mut rows
        {
            let mut count = u32::from(*order);
            c.count("harmonic order", &mut count, 0, 0xFFFF);
            // Within its range; else the whole is refused.
            *order = count as u16;
            c.number("harmonic amplitude", amplitude, -0.1, 0.1);
            c.number("harmonic phase", phase, -TAU, TAU);
        }
        match Harmonics::new(rows) {
            Ok(correction) => self.correction = correction,
            Err(_) => c.refuse(Invalid::OutOfRange {
                name: "sum of harmonic order x amplitude",
                low: 0.0,
                high: 1.0,
            }),
        }
    }
}

#[cfg(test)]
mod tests;
