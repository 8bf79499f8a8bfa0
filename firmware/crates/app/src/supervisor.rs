//! The supervisor: steps the modes, carries out what they ask, watches the other tasks, feeds the watchdog.

use embassy_futures::select::{Either3, select3};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant, Ticker};

use crate::fault::{Fault, Task};
use crate::hal::{Cutoff, Watchdog};
use crate::mode::{Action, Input, State};
use crate::shared::Shared;

/// How long a task may be silent, and how often it is looked at.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `period_ms` | ms | refused by the ticker | 5; far below the watchdog's time |
/// | `sampling_ms` | ms | always a fault | 50: five periods of the samples, and the transfer |
/// | `motor_ms` | ms | always a fault | 5 ticks; 20 while the encoder is started |
/// | `alignment_ms` | ms | always a fault | 50: its longest step is 1 ms |
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SupervisorConfig {
    /// Period of the supervision.
    pub period_ms: u32,
    /// Longest silence of the sampling.
    pub sampling_ms: u32,
    /// Longest silence of the motor's loop.
    pub motor_ms: u32,
    /// Longest silence of the alignment.
    pub alignment_ms: u32,
}

impl Default for SupervisorConfig {
    fn default() -> Self {
        Self {
            period_ms: 5,
            sampling_ms: 50,
            motor_ms: 20,
            alignment_ms: 50,
        }
    }
}

impl SupervisorConfig {
    const fn limit_ms(&self, task: Task) -> u32 {
        match task {
            Task::Sampling => self.sampling_ms,
            Task::Motor => self.motor_ms,
            Task::Alignment => self.alignment_ms,
        }
    }
}

/// The task. Starts the unit.
pub async fn run<M: RawMutex, C: Cutoff, W: Watchdog>(
    shared: &Shared<M>,
    mut cutoff: C,
    mut watchdog: W,
    config: SupervisorConfig,
) -> ! {
    for task in Task::ALL {
        shared.check_in(task);
    }
    let status = shared.status.sender();
    let mut state = State::default();
    let mut ticker = Ticker::every(Duration::from_millis(u64::from(config.period_ms)));
    let mut input = Input::Start;
    loop {
        let (next, actions) = state.step(&input, Instant::now().as_micros());
        for action in actions {
            carry_out(shared, &mut cutoff, action);
        }
        if next.status() != state.status() || input == Input::Start {
            status.send(next.status());
        }
        state = next;
        input = match select3(shared.inputs.receive(), shared.commands.receive(), ticker.next()).await {
            Either3::First(input) => input,
            Either3::Second(command) => Input::Command(command),
            Either3::Third(()) => {
                let late = Task::ALL.into_iter().find_map(|task| {
                    let silent_ms = shared.silent_ms(task);
                    (silent_ms > config.limit_ms(task)).then_some(Fault::TaskOverrun { task, silent_ms })
                });
                let fault = late.or_else(|| shared.take_missed());
                if late.is_none() && !state.wants_reset() {
                    watchdog.feed();
                }
                match fault {
                    Some(fault) => {
                        shared.inhibit();
                        Input::Fault(fault)
                    }
                    None => Input::Tick,
                }
            }
        };
    }
}

fn carry_out<M: RawMutex>(shared: &Shared<M>, cutoff: &mut impl Cutoff, action: Action) {
    match action {
        Action::Cut => {
            shared.inhibit();
            cutoff.cut();
            shared.rotor.clear();
        }
        Action::Release => {
            shared.rotor.clear();
            shared.release();
        }
        Action::Rotor(command) => {
            // The motor takes all that waits at every tick; only a hanging one leaves them, and that is found.
            let _ = shared.rotor.try_send(command);
        }
        Action::StartImu => shared.imu_start.signal(()),
        Action::StartEncoder => shared.encoder_start.signal(()),
        Action::Job(job) => shared.job.signal(job),
        Action::Tell(event) => shared.log(&event),
    }
}
