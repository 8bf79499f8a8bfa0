//! The supervisor: steps the modes, carries out what they ask, watches the other tasks, feeds the watchdog.

use embassy_futures::select::{Either3, select3};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant, Ticker};

use crate::blackbox::{BlackBox, Context, Memory};
use crate::command::ModeName;
use crate::fault::{Fault, Task};
use crate::hal::{Cutoff, Watchdog};
use crate::log::Event;
use crate::mode::{Action, Goal, Input, State};
use crate::shared::Shared;

/// How long a task may be silent, and how often it is looked at.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `period_ms` | ms | refused by the ticker | 5; far below the watchdog's time |
/// | `sampling_ms` | ms | always a fault | 50: five periods of the samples, and the transfer |
/// | `motor_ms` | ms | always a fault | 20: while the encoder is started it checks in every 10, else every tick |
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

/// The task. Starts the unit, or leaves the motor off where `blackbox` says that it has crashed too often, or that a fault
/// is latched.
pub async fn run<M: RawMutex, C: Cutoff, W: Watchdog, B: Memory>(
    shared: &Shared<M>,
    mut cutoff: C,
    mut watchdog: W,
    mut blackbox: BlackBox<B>,
    config: SupervisorConfig,
) -> ! {
    for task in Task::ALL {
        shared.check_in(task);
    }
    let status = shared.status.sender();
    let mut state = State::new(blackbox.rests(), shared.clock());
    let mut ticker = Ticker::every(Duration::from_millis(u64::from(config.period_ms)));
    let mut input = match blackbox.brake() {
        Some(crashes) => Input::Fault(Fault::BootLoop { crashes }),
        None if blackbox.is_held() => Input::Fault(Fault::Held),
        None => Input::Start,
    };
    let mut shown = None;
    loop {
        let now_us = Instant::now().as_micros();
        let (next, actions) = state.step(&input, now_us);
        for action in actions {
            if let Action::Tell(Event::Fault(fault)) = &action {
                let context = context(shared, blackbox.run_s(now_us), state.mode.name());
                blackbox.fault(fault, context);
            }
            carry_out(shared, &mut cutoff, action);
        }
        keep(shared, &mut blackbox, &state, &next, now_us);
        if shown != Some(next.status()) {
            shown = Some(next.status());
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
                if (late.is_none() || state.brakes()) && !state.wants_reset() {
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

/// Keeps what a reset must not wipe out.
fn keep<M: RawMutex, B: Memory>(
    shared: &Shared<M>,
    blackbox: &mut BlackBox<B>,
    before: &State,
    now: &State,
    now_us: u64,
) {
    if blackbox.is_due(now_us, now.mode.name()) {
        blackbox.live(context(shared, blackbox.run_s(now_us), now.mode.name()));
    }
    if let Some(latched) = now.latched() {
        blackbox.hold(latched);
    }
    blackbox.rest(now.goal == Goal::Rest);
    if now.restarts {
        blackbox.asked();
    }
    if before.brakes() && !now.brakes() {
        blackbox.forgive();
    }
}

fn context<M: RawMutex>(shared: &Shared<M>, t_s: u32, mode: ModeName) -> Context {
    let has_heading = matches!(mode, ModeName::Fine | ModeName::Aligned | ModeName::Navigating);
    let navigation = shared.navigation.try_get().filter(|_| has_heading);
    Context {
        mode: Some(mode),
        t_s,
        heading_sd: navigation.and_then(|now| Some(now.estimate?.sd.heading)),
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
        Action::Tell(event) => {
            if let Some(end) = event.calibration_end() {
                shared.calibration.signal(end);
            }
            shared.log(&event);
        }
    }
}
