//! Faults of the unit, and the rule for each: found within what time, and what happens next.
//!
//! Whatever the fault, the motor goes off first: whoever finds it raises it
//! ([`Shared::raise`](crate::shared::Shared::raise)), which inhibits the motor at once; the motor task executes that
//! at its next tick at the latest, and the supervisor cuts the outputs past it. Then it is reported, then
//! the [`Response`] of its [`Rule`] follows.
//!
//! Times are for the default configuration: 202.4 samples and 1000 ticks of the motor a second.

use drivers::mt6835::Warnings;
use drivers::{Channels, Error, SystemFlags};
use frames::wording;

use crate::fixed_decimal::fixed_decimal;
use crate::rotor::{Refused, RotorFault};
use crate::selftest::Failure;

/// A task of the unit that checks in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Task {
    /// [`crate::sampling::run`].
    Sampling,
    /// [`crate::motor::run`].
    Motor,
    /// [`crate::alignment::run`].
    Alignment,
}

impl Task {
    /// All of them, by index.
    pub const ALL: [Self; 3] = [Self::Sampling, Self::Motor, Self::Alignment];

    /// Its place in [`Task::ALL`].
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sampling => "sampling",
            Self::Motor => "motor",
            Self::Alignment => "alignment",
        }
    }
}

/// What is wrong, with the facts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// No data-ready edge.
    ImuSilent {
        /// How long it was waited for, µs.
        waited_us: u32,
    },
    /// Transfers from the IMU fail: check sum, header, bus.
    ImuTransfer {
        /// The last one's error.
        error: Error,
        /// How many in a row.
        in_row: u16,
    },
    /// Sensors at the end of their range.
    ImuSaturated {
        /// Which.
        channels: Channels,
        /// For how many samples.
        in_row: u16,
    },
    /// The data, or the count of the samples, stay as they are.
    ImuStuck {
        /// For how many samples.
        in_row: u16,
    },
    /// The IMU has restarted and lost its settings.
    ImuRestarted,
    /// The IMU reports a fault of its own.
    ImuFlags {
        /// Its flags.
        flags: SystemFlags,
    },
    /// The IMU is too hot to be trusted.
    OverTemperature {
        /// How hot, °C.
        temperature_c: f32,
    },
    /// The clocks of the IMU and of the unit disagree.
    Clock {
        /// Period of the samples as configured, µs.
        expected_us: f32,
        /// The same by the unit's clock, µs.
        measured_us: f32,
    },
    /// The encoder sends no usable angle.
    EncoderInvalid,
    /// The encoder repeats itself, or the rotor was stopped dead.
    EncoderFrozen,
    /// The encoder warns of its own readings.
    EncoderWarning {
        /// What of.
        warnings: Warnings,
    },
    /// The bridge reports a fault, or a line of it cannot be driven.
    Driver,
    /// The rotor is blocked, or does not keep up.
    Stall {
        /// [`RotorFault::Stall`] or [`RotorFault::Following`].
        rotor: RotorFault,
    },
    /// Any other fault of the rotor.
    Rotor(RotorFault),
    /// The rotor refuses what the modes ask of it.
    RotorRefused(Refused),
    /// A task has not checked in in time.
    TaskOverrun {
        /// Which.
        task: Task,
        /// Since when, ms.
        silent_ms: u32,
    },
    /// The self-test failed.
    SelfTest(Failure),
    /// The program has crashed at start after start: see [`crate::blackbox`].
    BootLoop {
        /// How often in a row.
        crashes: u32,
    },
    /// A fault was latched when the program was reset: it still is.
    Held,
}

/// What happens after the motor is off and the fault reported.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Response {
    /// After a while from the self-test on, so many times; then latched.
    Retry {
        /// How long after, ms.
        after_ms: u32,
        /// How many times between two successes.
        times: u8,
    },
    /// Off until a command resets the fault.
    Latch,
    /// The watchdog is no longer fed.
    Reset,
}

/// How a fault is dealt with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rule {
    /// Longest time from cause to detection, ms.
    pub within_ms: u32,
    /// What happens next.
    pub response: Response,
}

const fn retry(within_ms: u32, after_ms: u32, times: u8) -> Rule {
    Rule {
        within_ms,
        response: Response::Retry { after_ms, times },
    }
}

const fn latch(within_ms: u32) -> Rule {
    Rule {
        within_ms,
        response: Response::Latch,
    }
}

impl Fault {
    /// The rule for it.
    ///
    /// | fault | within | why | then |
    /// |---|---|---|---|
    /// | IMU silent | 35 ms | 5 periods of 4.94 ms, and up to one before the first | IMU reset, 3 tries |
    /// | transfer, stuck count | 20 ms | 3 in a row | IMU reset, 3 tries |
    /// | saturated | 30 ms | 5 in a row | 3 tries |
    /// | stuck data | 55 ms | 10 in a row: noise never repeats 6 × 32 bits | IMU reset, 3 tries |
    /// | restarted, flags | 10 ms | the next sample | IMU reset, 3 tries |
    /// | over-temperature | 55 ms | 10 in a row | every 10 s, 30 tries |
    /// | clock | 700 ms | a window of 64 samples begun anew and filled | latched: heading would be wrong unseen |
    /// | encoder | 30 ms | 3 bad readings of 1 ms | 3 tries, homing anew |
    /// | encoder frozen | 80 ms | 20 equal readings, not counting the 50 ms of a turning point | 3 tries, homing anew |
    /// | encoder warning | 30 ms | 20 in a row | 3 tries |
    /// | driver | 2 ms | every tick | 3 tries: heat goes away, a short does not |
    /// | stall | 300 ms | 50 ms at the voltage limit, or 2° behind at 20 °/s and the time to get there | 1 try |
    /// | home switch on the wrong side | 20 s | the rotor must pass the edge: a leg of 18 s | latched |
    /// | calibration or search without end | 60 s | what the modes give them | latched |
    /// | other rotor faults | 300 ms | each tick; the calibration's by its phases | latched |
    /// | task overrun | 65 ms | 50 ms for sampling and alignment, 20 for the motor, and the supervisor's period | reset |
    /// | self-test | 10 s | its timeout | 3 tries |
    /// | boot loop, held | 5 ms | at the start, before anything else | latched |
    pub const fn rule(&self) -> Rule {
        match self {
            Self::ImuSilent { .. } => retry(35, 500, 3),
            Self::ImuTransfer { .. } => retry(20, 500, 3),
            Self::ImuSaturated { .. } => retry(30, 1000, 3),
            Self::ImuStuck { .. } => retry(55, 500, 3),
            Self::ImuRestarted | Self::ImuFlags { .. } => retry(10, 500, 3),
            Self::OverTemperature { .. } => retry(55, 10_000, 30),
            Self::Clock { .. } => latch(700),
            Self::EncoderInvalid | Self::EncoderWarning { .. } => retry(30, 500, 3),
            Self::EncoderFrozen => retry(80, 500, 3),
            Self::Driver => retry(2, 1000, 3),
            Self::Stall { .. } => retry(300, 2000, 1),
            Self::Rotor(RotorFault::HomeMismatch { .. }) => latch(20_000),
            Self::Rotor(RotorFault::Endless) => latch(60_000),
            Self::Rotor(_) | Self::RotorRefused(_) => latch(300),
            Self::TaskOverrun { .. } => Rule {
                within_ms: 65,
                response: Response::Reset,
            },
            Self::SelfTest(_) => retry(10_000, 1000, 3),
            Self::BootLoop { .. } | Self::Held => latch(5),
        }
    }

    /// Names of the kinds, by their [code](Self::code). New ones go to the end: records of an older program may be read.
    pub const NAMES: [&'static str; 19] = [
        "imu-silent",
        "imu-transfer",
        "imu-saturated",
        "imu-stuck",
        "imu-restarted",
        "imu-flags",
        "over-temperature",
        "clock",
        "encoder-invalid",
        "encoder-frozen",
        "encoder-warning",
        "driver",
        "stall",
        "rotor",
        "rotor-refused",
        "task-overrun",
        "self-test",
        "boot-loop",
        "held",
    ];

    /// Number of its kind, the same for all facts.
    pub const fn code(&self) -> u8 {
        match self {
            Self::ImuSilent { .. } => 0,
            Self::ImuTransfer { .. } => 1,
            Self::ImuSaturated { .. } => 2,
            Self::ImuStuck { .. } => 3,
            Self::ImuRestarted => 4,
            Self::ImuFlags { .. } => 5,
            Self::OverTemperature { .. } => 6,
            Self::Clock { .. } => 7,
            Self::EncoderInvalid => 8,
            Self::EncoderFrozen => 9,
            Self::EncoderWarning { .. } => 10,
            Self::Driver => 11,
            Self::Stall { .. } => 12,
            Self::Rotor(_) => 13,
            Self::RotorRefused(_) => 14,
            Self::TaskOverrun { .. } => 15,
            Self::SelfTest(_) => 16,
            Self::BootLoop { .. } => 17,
            Self::Held => 18,
        }
    }

    /// Whether the unit has begun with it, and only waits to be told to go on.
    pub const fn brakes(&self) -> bool {
        matches!(self, Self::BootLoop { .. } | Self::Held)
    }

    /// Short name of its kind.
    pub const fn name(&self) -> &'static str {
        Self::NAMES[self.code() as usize]
    }
}

impl From<RotorFault> for Fault {
    fn from(rotor: RotorFault) -> Self {
        match rotor {
            RotorFault::Driver => Self::Driver,
            RotorFault::EncoderInvalid => Self::EncoderInvalid,
            RotorFault::EncoderFrozen => Self::EncoderFrozen,
            RotorFault::Stall { .. } | RotorFault::Following { .. } => Self::Stall { rotor },
            _ => Self::Rotor(rotor),
        }
    }
}

wording!(Fault, |self, say| {
    match *self {
        Self::ImuSilent { waited_us } => say!(
            "no data-ready for {} us: check the line and the IMU's supply",
            waited_us
        ),
        Self::ImuTransfer { error, in_row } => say!("{} transfers from the IMU failed: {}", in_row, error),
        Self::ImuSaturated { channels, in_row } => say!(
            "{} at the end of range for {} samples: the unit moves too fast",
            channels,
            in_row
        ),
        Self::ImuStuck { in_row } => say!("the IMU repeats one sample, {} times", in_row),
        Self::ImuRestarted => say!("the IMU has restarted: check its supply"),
        Self::ImuFlags { flags } => say!("the IMU reports {:#06x}", flags.bits()),
        Self::OverTemperature { temperature_c } => {
            say!("the IMU is at {} degC: let it cool", fixed_decimal(temperature_c, 0));
        }
        Self::Clock {
            expected_us,
            measured_us,
        } => say!(
            "samples come every {} us instead of {}: check the crystal and DEC_RATE",
            fixed_decimal(measured_us, 1),
            fixed_decimal(expected_us, 1)
        ),
        Self::EncoderInvalid => say!("{}", RotorFault::EncoderInvalid),
        Self::EncoderFrozen => say!("{}", RotorFault::EncoderFrozen),
        Self::EncoderWarning { warnings } => say!(
            "the encoder warns ({:#05b}): check magnet, distance and supply",
            warnings.bits()
        ),
        Self::Driver => say!("{}", RotorFault::Driver),
        Self::Stall { rotor } | Self::Rotor(rotor) => say!("{}", rotor),
        Self::RotorRefused(refused) => say!("{}", refused),
        Self::TaskOverrun { task, silent_ms } => {
            say!("task {} silent for {} ms: the unit will reset", task.name(), silent_ms);
        }
        Self::SelfTest(failure) => say!("{}", failure),
        Self::BootLoop { crashes } => say!(
            "{} crashes in a row: the motor stays off until reset by command",
            crashes
        ),
        Self::Held => {
            say!("latched before the reset, see the command faults: the motor stays off until reset by command")
        }
    }
});

impl core::error::Error for Fault {}
