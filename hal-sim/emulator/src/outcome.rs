//! How a run on the emulated part ended.

use hal_sim::align::Angles;
use hal_sim::unit_sim::ModeAt;
use serde::Serialize;

use crate::image::Footprint;
use crate::load::ModeLoad;
use crate::nmea::Received;
use crate::stack::Stack;

/// Number of σ beyond which a heading is not what the unit says of it.
pub const SIGMAS: f64 = 3.0;

/// A fault as the unit's log tells it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FaultSeen {
    /// When the line was read, s.
    pub t_s: f64,
    /// Its name and facts.
    pub text: String,
    /// Whether the bridge was off when the line was read.
    pub motor_off: bool,
}

/// A reset of the part.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ResetSeen {
    /// When, s.
    pub t_s: f64,
    /// Who asked for it.
    pub cause: String,
}

/// An estimate of the unit beside the truth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Moment {
    /// The instant it holds for, s: the end of the last sample before it was sent.
    pub t_s: f64,
    /// What the unit says, by `$PASHR`: in hundredths of a degree.
    pub reading: Angles,
    /// Its 1σ of that.
    pub sd: Angles,
    /// True attitude of the housing.
    pub truth: Angles,
    /// `reading − truth`.
    pub error: Angles,
}

impl Moment {
    /// The heading's error in σ.
    pub fn sigmas(&self) -> f64 {
        self.error.heading_deg / self.sd.heading_deg
    }
}

/// Where the emulator could not stand in for the part: each list must be empty.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Gaps {
    /// Addresses that no register covers.
    pub unmapped: Vec<String>,
    /// Accesses that the part refused.
    pub refused: Vec<String>,
    /// Interrupts that the core has no line for.
    pub unrouted: Vec<String>,
    /// What a model told of itself that its manual forbids.
    pub told: Vec<String>,
    /// Registers that no model stands behind, but for EXTICR of SYSCFG, which [`Part`](crate::part::Part) reads.
    pub unimplemented: Vec<String>,
}

impl Gaps {
    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.lists().iter().all(|(_, list)| list.is_empty())
    }

    /// The lists by name.
    pub fn lists(&self) -> [(&'static str, &[String]); 5] {
        [
            ("unmapped", &self.unmapped),
            ("refused", &self.refused),
            ("unrouted", &self.unrouted),
            ("told", &self.told),
            ("unimplemented", &self.unimplemented),
        ]
    }
}

/// What the core did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cost {
    /// Instructions executed by mode.
    pub load: Vec<ModeLoad>,
    /// Instructions executed in all.
    pub instructions: u64,
    /// The stack.
    pub stack: Stack,
    /// Flash and static RAM.
    pub footprint: Footprint,
}

/// What is to be made of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Aligned or navigating, the heading within [`SIGMAS`] of the truth.
    Aligned,
    /// Neither at the end.
    NotAligned,
    /// The same, and the heading is further off than its σ allows.
    BeyondSigma,
    /// The cable was wound past what it bears.
    WoundPast,
    /// The emulator could not stand in for the part: the rest is not to be trusted.
    Gaps,
}

/// What is lit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Lamps {
    /// Heading.
    pub green: bool,
    /// Motor.
    pub blue: bool,
    /// Fault.
    pub red: bool,
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Outcome {
    /// Scenario by name.
    pub scenario: String,
    /// Seed of the run.
    pub seed: u64,
    /// Virtual length, s.
    pub t_s: f64,
    /// What is to be made of it.
    pub verdict: Verdict,
    /// The unit's mode at the end.
    pub state: String,
    /// Modes in order, by the log.
    pub modes: Vec<ModeAt>,
    /// Faults in order, by the log.
    pub faults: Vec<FaultSeen>,
    /// Resets but the first one at power-up.
    pub resets: Vec<ResetSeen>,
    /// The last estimate.
    #[serde(rename = "final")]
    pub last: Option<Moment>,
    /// The lamps at the end.
    pub lamps: Lamps,
    /// Whether the cable was wound past what it bears.
    pub wound_past: bool,
    /// Least and greatest angle of the rotor, degrees.
    pub travel_deg: [f64; 2],
    /// Whether the bridge ever drove the motor between a reset and the unit's next word.
    pub driven_after_reset: bool,
    /// Samples that the IMU has latched at the unit's rate or another.
    pub samples: u64,
    /// Frames that the IMU refused because they came too soon.
    pub stall_violations: u32,
    /// What came over the serial line.
    pub serial: Received,
    /// What the emulator does not have.
    pub gaps: Gaps,
    /// What it cost.
    pub cost: Cost,
    /// What is in the settings' sectors at the end.
    #[serde(skip)]
    pub flash: Vec<u8>,
    /// Hash of the log and the serial line: equal runs have equal ones.
    pub trace: u64,
}

impl Outcome {
    pub(crate) fn judge(&self) -> Verdict {
        if !self.gaps.is_empty() {
            return Verdict::Gaps;
        }
        if self.wound_past {
            return Verdict::WoundPast;
        }
        match &self.last {
            Some(last) if matches!(self.state.as_str(), "aligned" | "navigating") => {
                if last.sigmas().abs() <= SIGMAS {
                    Verdict::Aligned
                } else {
                    Verdict::BeyondSigma
                }
            }
            _ => Verdict::NotAligned,
        }
    }

    /// When the unit first was in a mode, s.
    pub fn first(&self, mode: &str) -> Option<f64> {
        self.modes.iter().find(|at| at.mode == mode).map(|at| at.t_s)
    }
}
