//! The alignment task: samples in, estimates out.
//!
//! While the fine filter works through its queue a sample costs a dozen filter steps and a measurement, half a
//! millisecond at 168 MHz; the bounded channel holds what comes in meanwhile.

use embassy_futures::select::{Either3, select3};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Timer};
use nav::aligner::{Align, Event};

use crate::fault::Task;
use crate::log::Alignment;
use crate::mode::{Input, Job};
use crate::selftest::{Inspection, InspectionConfig};
use crate::shared::{Navigation, Shared, TimedSample};

/// The task checks in at least this often when no samples come.
const IDLE: Duration = Duration::from_millis(10);

/// What the task does besides aligning; the aligner has its own figures.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `publish_every` | samples | every sample | 10: 20 a second |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlignmentConfig {
    /// Samples from one estimate put out to the next. An estimate costs about as much as a filter step.
    pub publish_every: u16,
    /// What the first samples are judged by.
    pub inspection: InspectionConfig,
}

impl Default for AlignmentConfig {
    fn default() -> Self {
        Self {
            publish_every: 10,
            inspection: InspectionConfig::default(),
        }
    }
}

/// The task's job with what belongs to it.
enum Work {
    Idle,
    Inspect(Inspection),
    Align {
        /// The aligner has not been told yet that what came before does not count.
        fresh: bool,
    },
}

/// The task. The aligner is the caller's: it is 40 kB, and belongs into a static.
pub async fn run<M: RawMutex>(shared: &Shared<M>, aligner: &mut dyn Align, config: AlignmentConfig) -> ! {
    let mut work = Work::Idle;
    let mut since_published = 0;
    loop {
        shared.check_in(Task::Alignment);
        let sample = match select3(shared.job.wait(), shared.next_sample(), Timer::after(IDLE)).await {
            Either3::First(job) => {
                // What waits was measured before.
                shared.forget_samples();
                work = match job {
                    Job::Idle => Work::Idle,
                    Job::Inspect => Work::Inspect(Inspection::new(config.inspection)),
                    Job::Align => Work::Align { fresh: true },
                };
                continue;
            }
            Either3::Second(sample) => sample,
            Either3::Third(()) => continue,
        };
        match &mut work {
            Work::Idle => {}
            Work::Inspect(inspection) => {
                if let Some(verdict) = inspection.push(&sample.sample) {
                    shared.tell(Input::Inspected(verdict));
                    work = Work::Idle;
                }
            }
            Work::Align { fresh } => {
                let Some(alpha) = sample.alpha else { continue };
                align(shared, aligner, &sample, alpha, core::mem::take(fresh));
                since_published += 1;
                if since_published >= config.publish_every {
                    since_published = 0;
                    shared.navigation.sender().send(Navigation {
                        t_us: sample.t_us,
                        mode: aligner.mode(),
                        estimate: aligner.estimate(),
                        not_ready: aligner.not_ready(),
                    });
                }
            }
        }
    }
}

fn align<M: RawMutex>(shared: &Shared<M>, aligner: &mut dyn Align, sample: &TimedSample, alpha: f32, fresh: bool) {
    let mut increments = sample.sample;
    if fresh {
        // A gap beyond what is bridged makes the aligner start anew, in place and without telling a reason that is
        // none. An aligner that has only settled may go on.
        increments.gap = 2.0 * aligner.longest_gap() + 1.0;
    }
    let told = aligner.step(&increments, alpha);
    if fresh && matches!(told, Some(Event::Restarted(_))) {
        return;
    }
    if let Some(event) = told {
        shared.tell(Input::Alignment(Alignment::from(&event)));
    }
}
