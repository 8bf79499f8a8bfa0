use std::format;
use std::string::{String, ToString};
use std::vec::Vec;

use proptest::prelude::*;

use super::*;

/// Memory of a host, in which writes can be broken off.
#[derive(Debug, Clone, PartialEq)]
struct Ram {
    slots: [Slot; SLOTS],
    /// Words that are still written.
    words: usize,
}

impl Ram {
    fn filled(word: impl FnMut() -> u32) -> Self {
        let mut word = word;
        Self {
            slots: core::array::from_fn(|_| core::array::from_fn(|_| word())),
            words: usize::MAX,
        }
    }

    fn zeros() -> Self {
        Self::filled(|| 0)
    }
}

impl Memory for Ram {
    fn read(&self, slot: usize) -> Slot {
        self.slots[slot]
    }

    fn write(&mut self, slot: usize, words: &Slot) {
        for (to, from) in self.slots[slot].iter_mut().zip(words) {
            if self.words == 0 {
                return;
            }
            self.words -= 1;
            *to = *from;
        }
    }
}

const OVERRUN: Fault = Fault::TaskOverrun {
    task: Task::Motor,
    silent_ms: 21,
};

fn at(mode: ModeName, t_s: u32) -> Context {
    Context {
        mode: Some(mode),
        t_s,
        heading_sd: None,
    }
}

fn texts(memory: &impl Memory) -> Vec<String> {
    entries(memory).map(|entry| entry.to_string()).collect()
}

/// A run of the unit and how it ended: what `memory` says of it at the next start.
fn run(memory: &mut Ram, cause: ResetCause, body: impl FnOnce(&mut BlackBox<&mut Ram>)) {
    body(&mut BlackBox::start(memory, cause, 0));
}

#[test]
fn garbage_is_no_record() {
    for fill in [0, u32::MAX, 0xA5A5_A5A5, MAGIC] {
        let mut memory = Ram::filled(|| fill);
        assert_eq!(entries(&memory).count(), 0, "{fill:#x}");
        let started = BlackBox::start(&mut memory, ResetCause::PowerOn, 0);
        assert_eq!((started.start.before, started.brake()), (None, None));
        assert_eq!(started.counters.starts, 1);
    }
}

#[test]
fn a_fault_before_a_reset_is_told_after_it() {
    let mut memory = Ram::zeros();
    run(&mut memory, ResetCause::PowerOn, |blackbox| {
        blackbox.live(at(ModeName::Aligned, 1233));
        let context = Context {
            heading_sd: Some((0.31 * DEG) as f32),
            ..at(ModeName::Aligned, 1234)
        };
        blackbox.fault(&OVERRUN, context);
    });
    let started = BlackBox::start(&mut memory, ResetCause::Watchdog, 0);
    assert_eq!(
        started.started().to_string(),
        "started by watchdog; before: fault task-overrun motor in mode aligned after 1234 s, heading sd 0.31 deg"
    );
}

/// What ended a run, what is told of it, and whether it counts as a crash.
#[test]
fn every_end_of_a_run() {
    let mode = || at(ModeName::Fine, 80);
    type End = fn(&mut Ram);
    let noted: End = |memory| note(memory, Cause::panic("src/tasks.rs", 12), 81);
    let nothing: End = |_| ();
    for (row, (cause, end, told, crash)) in [
        (
            ResetCause::Watchdog,
            nothing,
            "watchdog; before: hang in mode fine after 80 s",
            true,
        ),
        (
            ResetCause::Software,
            noted,
            "software; before: panic at src/tasks.rs:12 in mode fine after 81 s",
            true,
        ),
        (
            ResetCause::Software,
            |memory| {
                note(
                    memory,
                    Cause::HardFault {
                        reasons: 0x8200,
                        at: 0x0800_1234,
                    },
                    81,
                );
            },
            "software; before: hard fault 0x00008200 at 0x08001234 in mode fine after 81 s",
            true,
        ),
        (
            ResetCause::BrownOut,
            nothing,
            "brown-out; before: brown-out in mode fine after 80 s",
            true,
        ),
        // A probe, an update.
        (ResetCause::Software, nothing, "software", false),
        (ResetCause::Pin, nothing, "reset line", false),
        (ResetCause::PowerOn, nothing, "power on", false),
    ]
    .into_iter()
    .enumerate()
    {
        let mut memory = Ram::zeros();
        run(&mut memory, ResetCause::PowerOn, |blackbox| blackbox.live(mode()));
        end(&mut memory);
        let started = BlackBox::start(&mut memory, cause, 0);
        assert_eq!(
            started.started().to_string(),
            std::format!("started by {told}"),
            "row {row}"
        );
        assert_eq!(started.counters.crashes, u32::from(crash), "row {row}");
    }
}

#[test]
fn a_reset_by_command_is_no_crash() {
    let mut memory = Ram::zeros();
    run(&mut memory, ResetCause::PowerOn, |blackbox| {
        blackbox.live(at(ModeName::Aligned, 200));
        blackbox.asked();
    });
    let started = BlackBox::start(&mut memory, ResetCause::Watchdog, 0);
    assert_eq!(started.started().to_string(), "started by watchdog, as asked");
    assert_eq!(started.counters.crashes, 0);
    // Once: the next one was not asked for.
    let started = BlackBox::start(&mut memory, ResetCause::Watchdog, 0);
    assert_eq!((started.start.asked, started.counters.crashes), (false, 1));
}

#[test]
fn a_latched_fault_outlives_what_nobody_switched_on_and_rest_a_crash() {
    use ResetCause::{BrownOut, Pin, PowerOn, Software, Watchdog};
    for (cause, asks, held, rests) in [
        (Watchdog, false, true, true),
        (BrownOut, false, true, true),
        (Watchdog, true, true, false),
        // Without a record of a panic nobody knows why.
        (Software, false, true, false),
        (Pin, false, true, false),
        (PowerOn, false, false, false),
    ] {
        let mut memory = Ram::zeros();
        run(&mut memory, PowerOn, |unit| {
            unit.hold(true);
            unit.rest(true);
            if asks {
                unit.asked();
            }
        });
        run(&mut memory, cause, |unit| {
            assert_eq!((unit.is_held(), unit.rests()), (held, rests), "{cause:?}");
            unit.rest(false);
        });
        run(&mut memory, Watchdog, |unit| assert!(!unit.rests()));
    }
}

#[test]
fn the_last_eight_in_order_and_the_same_once() {
    let mut memory = Ram::zeros();
    run(&mut memory, ResetCause::PowerOn, |blackbox| {
        for k in 0..11 {
            // By twos: every one comes twice.
            let fault = if k % 2 == 0 {
                Fault::Driver
            } else {
                Fault::EncoderFrozen
            };
            blackbox.fault(&fault, at(ModeName::Coarse, 2 * k));
            blackbox.fault(&fault, at(ModeName::Coarse, 2 * k + 1));
        }
    });
    let expected: Vec<String> = (3..11)
        .map(|k| {
            let name = if k % 2 == 0 { "driver" } else { "encoder-frozen" };
            format!("fault {name} in mode coarse after {} s, 2 times in a row", 2 * k + 1)
        })
        .collect();
    assert_eq!(texts(&memory), expected);
    clear(&mut memory);
    assert_eq!(entries(&memory).count(), 0);
}

#[test]
fn a_broken_slot_costs_itself_only() {
    let mut memory = Ram::zeros();
    run(&mut memory, ResetCause::PowerOn, |blackbox| {
        for k in 0..RECORDS as u32 {
            blackbox.fault(&Fault::Driver, at(ModeName::ALL[k as usize], k));
        }
    });
    let whole = texts(&memory);
    assert_eq!(whole.len(), RECORDS);
    for slot in FIRST..SLOTS {
        for word in 0..WORDS {
            for bit in [0, 13, 31] {
                let mut broken = memory.clone();
                broken.slots[slot][word] ^= 1 << bit;
                let mut rest = whole.clone();
                // The first one has the number 1.
                rest.remove((slot - FIRST + RECORDS - 1) % RECORDS);
                assert_eq!(texts(&broken), rest);
                // The next one goes after the newest of the rest, and is the last.
                note(&mut broken, Cause::Hang, 9);
                assert!(texts(&broken).last().unwrap().starts_with("hang"));
            }
        }
    }
    // A slot is good in its own place only.
    memory.slots.swap(FIRST + 1, FIRST + 2);
    assert_eq!(texts(&memory), whole[2..]);
}

#[test]
fn a_write_that_breaks_off_costs_its_slot() {
    let mut before = Ram::zeros();
    run(&mut before, ResetCause::PowerOn, |blackbox| {
        blackbox.live(at(ModeName::Coarse, 40));
        blackbox.fault(&Fault::Driver, at(ModeName::Coarse, 41));
    });
    for words in 0..WORDS {
        let mut memory = Ram {
            words,
            ..before.clone()
        };
        note(&mut memory, Cause::Hang, 42);
        assert_eq!(texts(&memory), texts(&before), "{words}");
    }
}

/// Runs in a row, each with its length, how it went and how it ended: after which of them the brake is on.
#[test]
fn the_brake() {
    use ModeName::{Aligned, Coarse, Fault as Faulted, Homing, Idle, SelfTest};
    use ResetCause::{BrownOut, Pin, PowerOn, Software, Watchdog};
    // Length, mode and end of each run.
    type Runs = &'static [(u32, ModeName, ResetCause)];
    let table: [(&str, Runs, &[bool]); 10] = [
        (
            "three in a row",
            &[(0, SelfTest, Watchdog); 4],
            &[false, false, true, true],
        ),
        ("by the supply", &[(2, Homing, BrownOut); 3], &[false, false, true]),
        ("no crashes", &[(2, Homing, Pin); 4], &[false; 4]),
        ("updates", &[(2, Homing, Software); 4], &[false; 4]),
        (
            "aligned between",
            &[
                (1, Homing, Watchdog),
                (1, Homing, Watchdog),
                (1, Aligned, Watchdog),
                (1, Homing, Watchdog),
            ],
            &[false; 4],
        ),
        (
            "sound for a minute",
            &[
                (1, Homing, Watchdog),
                (1, Homing, Watchdog),
                (61, Coarse, Watchdog),
                (1, Homing, Watchdog),
            ],
            &[false; 4],
        ),
        (
            "at rest is sound as well",
            &[(1, Homing, Watchdog), (1, Homing, Watchdog), (61, Idle, Watchdog)],
            &[false; 3],
        ),
        (
            "in a fault is not",
            &[(1, Homing, Watchdog), (1, Homing, Watchdog), (250, Faulted, Watchdog)],
            &[false, false, true],
        ),
        (
            "too long for a row",
            &[
                (1, Homing, Watchdog),
                (200, Faulted, Watchdog),
                (200, Faulted, Watchdog),
                (1, Homing, Watchdog),
                (1, Homing, Watchdog),
            ],
            &[false, false, false, false, true],
        ),
        (
            "only power-on takes it off",
            &[
                (1, Homing, Watchdog),
                (1, Homing, Watchdog),
                (1, Homing, Watchdog),
                (1, Faulted, Pin),
                (1, Faulted, PowerOn),
                (1, Homing, Watchdog),
            ],
            &[false, false, true, true, false, false],
        ),
    ];
    for (name, runs, expected) in table {
        let mut memory = Ram::zeros();
        let mut cause = PowerOn;
        let mut braked = Vec::new();
        for (length, mode, end) in runs {
            run(&mut memory, cause, |blackbox| {
                for t_s in 0..=*length {
                    blackbox.live(at(*mode, t_s));
                }
            });
            cause = *end;
            // What the next start would find.
            braked.push(BlackBox::start(&mut memory.clone(), cause, 0).brake().is_some());
        }
        assert_eq!(braked, expected, "{name}");
    }
}

#[test]
fn a_panic_is_a_crash_and_forgiving_ends_the_row() {
    let mut memory = Ram::zeros();
    let mut cause = ResetCause::PowerOn;
    for _ in 0..CRASHES {
        run(&mut memory, cause, |_| ());
        note(&mut memory, Cause::panic("x.rs", 1), 0);
        cause = ResetCause::Software;
    }
    run(&mut memory, cause, |blackbox| {
        assert_eq!(blackbox.brake(), Some(CRASHES));
        blackbox.forgive();
    });
    assert_eq!(BlackBox::start(&mut memory, ResetCause::Watchdog, 0).brake(), None);
    assert_eq!(texts(&memory)[0], "panic at x.rs:1 after 0 s, 3 times in a row");
}

#[test]
fn answers_fit_a_sentence() {
    for (cause, expected) in [
        (
            Cause::from(&Fault::TaskOverrun {
                task: Task::Alignment,
                silent_ms: 51,
            }),
            "$PRNSA,ok,start 12 12345 s task-overrun alignment in calibrating sd 0.31 x9*",
        ),
        (
            Cause::panic("firmware/crates/app/src/sampling.rs", 485),
            "$PRNSA,ok,start 12 12345 s panic /sampling.rs 485 in calibrating sd 0.31 x9*",
        ),
        (
            Cause::HardFault {
                reasons: 0x0000_8200,
                at: 0x0800_12AF,
            },
            "$PRNSA,ok,start 12 12345 s hard-fault 00008200 080012AF in calibrating sd 0.3*",
        ),
    ] {
        let entry = Entry {
            start: 12,
            cause,
            context: Context {
                heading_sd: Some((0.31 * DEG) as f32),
                ..at(ModeName::Calibrating, 12_345)
            },
            count: 9,
        };
        let answer = entry.answer();
        assert_eq!(&answer.as_str()[..expected.len()], expected);
    }
}

#[test]
fn every_fault_has_its_own_name_and_a_row_in_the_docs() {
    let docs = include_str!("../../../../../docs/faults.md");
    for (k, name) in Fault::NAMES.iter().enumerate() {
        assert_eq!(Fault::NAMES.iter().position(|other| other == name), Some(k));
        assert!(docs.contains(&format!("\n| `{name}` | ")), "{name}");
    }
}

fn any_cause() -> impl Strategy<Value = Cause> {
    prop_oneof![
        (0..Fault::NAMES.len() as u8, proptest::option::of(0..3_usize)).prop_map(|(code, task)| Cause::Fault {
            code,
            task: task.map(|task| Task::ALL[task]),
        }),
        (any::<String>(), any::<u32>()).prop_map(|(file, line)| Cause::panic(&file, line)),
        (any::<u32>(), any::<u32>()).prop_map(|(reasons, at)| Cause::HardFault { reasons, at }),
        Just(Cause::Hang),
        Just(Cause::BrownOut),
    ]
}

proptest! {
    /// Whatever is put in comes out, and has a line.
    #[test]
    fn what_is_put_in_comes_out(
        cause in any_cause(), mode in proptest::option::of(0..ModeName::ALL.len()), t_s in any::<u32>(),
        sd in proptest::option::of(0.0..4.0_f32), start in any::<u16>(),
    ) {
        let entry = Entry {
            start,
            cause,
            context: Context { mode: mode.map(|mode| ModeName::ALL[mode]), t_s, heading_sd: sd },
            count: 1,
        };
        let mut memory = Ram::zeros();
        put(&mut memory, cause, start, &entry.context);
        prop_assert_eq!(entries(&memory).collect::<Vec<_>>(), [entry]);
        prop_assert!(entry.answer().as_str().is_ascii());
    }

    /// No garbage is taken for anything, and it does no harm.
    #[test]
    fn garbage_does_no_harm(words in proptest::collection::vec(any::<u32>(), SLOTS * WORDS), cause in 0..6_usize) {
        let mut words = words.into_iter();
        let mut memory = Ram::filled(|| words.next().unwrap_or_default());
        let cause = [
            ResetCause::PowerOn, ResetCause::BrownOut, ResetCause::Watchdog, ResetCause::Pin, ResetCause::Software,
            ResetCause::Unknown,
        ][cause];
        prop_assert_eq!(entries(&memory).count(), 0);
        let mut started = BlackBox::start(&mut memory, cause, 0);
        prop_assert_eq!(started.brake(), None);
        started.live(at(ModeName::Homing, 7));
        started.fault(&OVERRUN, at(ModeName::Homing, 7));
        prop_assert_eq!(entries(&memory).last().map(|entry| entry.cause), Some(Cause::from(&OVERRUN)));
    }
}
