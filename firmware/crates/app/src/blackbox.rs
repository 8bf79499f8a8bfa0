//! The black box: what a reset must not wipe out, kept in memory that no start initialises.
//!
//! ```text
//! slot 0      counters   starts since power-on, crashes in a row, how long that row is
//! slot 1      life       of the run under way: mode, time, heading σ, once a second
//! slot 2…9    records    the last 8 causes, each with mode, time, heading σ and how often in a row
//!
//! slot = 9 words │ their CRC-32, changed by magic and slot
//! ```
//!
//! Each slot stands for itself: a reset in the middle of a write costs that slot and no other. After power-on the words
//! are anybody's guess, and one guess of 2³² passes; so does what another program left there, unless it knew the magic,
//! which changes with the format.
//!
//! # The brake
//!
//! A crash is a reset by the watchdog that nobody asked for, by a panic, by a hard fault or by a supply that dips: a
//! motor that pulls it down does so at every start. After [`CRASHES`] of them, with no more than [`WITHIN_S`] of
//! running from the first to the last, the unit starts with the motor kept off, in [`Fault::BootLoop`]; a reset line or
//! a restart do not end that, the command `reset` and power-on do. The row ends where the unit gets aligned, or runs
//! for [`SOUND_S`] without a fault.
//!
//! | who | notes |
//! |---|---|
//! | [`supervisor`](crate::supervisor) | every fault as it enters that mode; life; sound running |
//! | the board's panic and hard fault handlers | by [`note`]: nothing but the memory is needed |
//! | [`BlackBox::start`] | what bit without anybody having noted why |

use drivers::crc::crc32;
use frames::units::DEG;
use frames::wording;

use crate::command::ModeName;
use crate::fault::{Fault, Task};
use crate::fixed_decimal::{deg, hex_digit};
use crate::hal::ResetCause;
use crate::nmea::{Sentence, SentenceBuilder};

pub use crate::fixed_decimal::seconds;

/// Crashes in a row after which the motor is kept off: one may be chance, a second one bad luck.
pub const CRASHES: u32 = 3;
/// Running time from the first crash of a row to its last, s: three starts that fail as late as they can, in homing.
pub const WITHIN_S: u32 = 300;
/// Running for so long without a fault ends the row, s.
pub const SOUND_S: u32 = 60;

/// Words of a slot, the last one its check sum.
pub const WORDS: usize = 10;
/// Records kept.
pub const RECORDS: usize = 8;
/// Slots there are.
pub const SLOTS: usize = 2 + RECORDS;

const COUNTERS: usize = 0;
const LIFE: usize = 1;
const FIRST: usize = 2;
/// "BBX" and the version of the format.
const MAGIC: u32 = 0x4242_5801;
/// Bytes of a file's name that are kept, the last ones.
const NAME: usize = 12;
/// In the place of a mode or a task: none.
const NONE: u8 = 0xFF;

/// A slot as it lies in memory.
pub type Slot = [u32; WORDS];

/// Memory that outlives a reset. What it holds after power-on does not matter.
pub trait Memory {
    /// A slot, below [`SLOTS`].
    fn read(&self, slot: usize) -> Slot;
    /// Replaces it. A reset on the way may leave some of the words.
    fn write(&mut self, slot: usize, words: &Slot);
}

impl<T: Memory + ?Sized> Memory for &mut T {
    fn read(&self, slot: usize) -> Slot {
        (**self).read(slot)
    }

    fn write(&mut self, slot: usize, words: &Slot) {
        (**self).write(slot, words);
    }
}

/// The end of a file's name as it is kept: three words of four bytes, zeros in front.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Name([u32; NAME / 4]);

impl Name {
    fn new(name: &str) -> Self {
        let mut words = [0_u32; NAME / 4];
        let begin = name.len().saturating_sub(NAME);
        for byte in name.bytes().skip(begin) {
            // The bytes move up by one place.
            let [a, b, c] = words;
            words = [a << 8 | b >> 24, b << 8 | c >> 24, c << 8 | u32::from(byte)];
        }
        Self(words)
    }

    fn bytes(&self) -> impl Iterator<Item = u8> {
        let [a, b, c] = self.0;
        let all = u128::from(a) << 64 | u128::from(b) << 32 | u128::from(c);
        (0..NAME)
            .rev()
            .map(move |k| (all >> (8 * k)) as u8)
            .filter(|byte| *byte != 0)
    }
}

wording!(Name, |self, say| {
    for byte in self.bytes() {
        say!("{}", char::from(byte));
    }
});

/// Why something was recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// A fault, by its [code](Fault::code).
    Fault {
        /// Below the number of [`Fault::NAMES`].
        code: u8,
        /// The task, of those that have one.
        task: Option<Task>,
    },
    /// The program gave up.
    Panic {
        /// End of the file's name.
        file: Name,
        /// Its line.
        line: u32,
    },
    /// The core gave up.
    HardFault {
        /// Its reasons: the CFSR.
        reasons: u32,
        /// Where the program was; zero where the stack does not tell.
        at: u32,
    },
    /// The watchdog bit, and nobody had noted why: the supervisor did not run.
    Hang,
    /// The supply dipped.
    BrownOut,
}

impl Cause {
    /// Of a panic.
    pub fn panic(file: &str, line: u32) -> Self {
        Self::Panic {
            file: Name::new(file),
            line,
        }
    }

    /// Whether a reset follows.
    fn is_fatal(&self) -> bool {
        match self {
            Self::Fault { task, .. } => task.is_some(),
            _ => true,
        }
    }

    /// Its name; of a fault that of its kind.
    pub fn name(&self) -> &'static str {
        self.words().0
    }

    /// The name, and after it what belongs to it.
    fn words(&self) -> (&'static str, &'static str) {
        match self {
            Self::Fault { code, task } => (
                Fault::NAMES.get(usize::from(*code)).copied().unwrap_or_default(),
                task.map_or("", Task::name),
            ),
            Self::Panic { .. } => ("panic", ""),
            Self::HardFault { .. } => ("hard-fault", ""),
            Self::Hang => ("hang", ""),
            Self::BrownOut => ("brown-out", ""),
        }
    }

    fn encode(&self) -> (u8, u8, [u32; 4]) {
        match *self {
            Self::Fault { code, task } => (0, code, [task.map_or(NONE.into(), |task| task.index() as u32), 0, 0, 0]),
            Self::Panic {
                file: Name([first, second, third]),
                line,
            } => (1, 0, [line, first, second, third]),
            Self::HardFault { reasons, at } => (2, 0, [reasons, at, 0, 0]),
            Self::Hang => (3, 0, [0; 4]),
            Self::BrownOut => (4, 0, [0; 4]),
        }
    }

    fn decode(kind: u8, code: u8, facts: [u32; 4]) -> Option<Self> {
        let [first, rest @ ..] = facts;
        Some(match kind {
            0 => Self::Fault {
                code,
                task: Task::ALL.get(first as usize).copied(),
            },
            1 => Self::Panic {
                file: Name(rest),
                line: first,
            },
            2 => Self::HardFault {
                reasons: first,
                at: rest[0],
            },
            3 => Self::Hang,
            4 => Self::BrownOut,
            _ => return None,
        })
    }
}

impl From<&Fault> for Cause {
    fn from(fault: &Fault) -> Self {
        Self::Fault {
            code: fault.code(),
            task: match fault {
                Fault::TaskOverrun { task, .. } => Some(*task),
                _ => None,
            },
        }
    }
}

/// State of the unit at the time of an entry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Context {
    /// Its mode.
    pub mode: Option<ModeName>,
    /// Since its start, s.
    pub t_s: u32,
    /// 1σ of the heading, rad, where there was one.
    pub heading_sd: Option<f32>,
}

/// A record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Entry {
    /// The start after which it happened, counted from power-on.
    pub start: u16,
    /// Why.
    pub cause: Cause,
    /// State of the unit then.
    pub context: Context,
    /// How often in a row; the rest is of the last time.
    pub count: u16,
}

impl Entry {
    /// As an answer on the serial line.
    #[inline(never)]
    pub(crate) fn answer(&self) -> Sentence {
        let mut line = SentenceBuilder::answer(true);
        let Context { mode, t_s, heading_sd } = self.context;
        line.words("start ");
        line.decimal(self.start.into(), 0);
        line.words(" ");
        // From 2²⁴ s on, which is half a year, it is off by some.
        line.decimal(t_s as f32, 0);
        line.words(" s ");
        let (name, of) = self.cause.words();
        line.words(name);
        match &self.cause {
            Cause::Panic { file, line: number } => {
                letters(&mut line, file.bytes());
                line.words(" ");
                line.decimal(*number as f32, 0);
            }
            Cause::HardFault { reasons, at } => {
                letters(&mut line, hex(*reasons));
                letters(&mut line, hex(*at));
            }
            _ if of.is_empty() => {}
            _ => {
                line.words(" ");
                line.words(of);
            }
        }
        if let Some(mode) = mode {
            line.words(" in ");
            line.words(mode.as_str());
        }
        if let Some(sd) = heading_sd {
            line.words(" sd ");
            line.decimal(sd / DEG as f32, 2);
        }
        if self.count > 1 {
            line.words(" x");
            line.decimal(self.count.into(), 0);
        }
        line.end()
    }
}

/// A word of an answer.
fn letters(line: &mut SentenceBuilder, bytes: impl Iterator<Item = u8>) {
    line.words(" ");
    for byte in bytes {
        line.words(char::from(byte).encode_utf8(&mut [0; 2]));
    }
}

fn hex(word: u32) -> impl Iterator<Item = u8> {
    (0..8).rev().map(move |k| hex_digit((word >> (4 * k) & 15) as u8))
}

wording!(Entry, |self, say| {
    let (name, of) = self.cause.words();
    match &self.cause {
        Cause::Fault { task: None, .. } => say!("fault {}", name),
        Cause::Fault { .. } => say!("fault {} {}", name, of),
        Cause::Panic { file, line } => say!("panic at {}:{}", file, line),
        Cause::HardFault { reasons, at } => say!("hard fault {:#010x} at {:#010x}", reasons, at),
        Cause::Hang | Cause::BrownOut => say!("{}", name),
    }
    let Context { mode, t_s, heading_sd } = self.context;
    if let Some(mode) = mode {
        say!(" in mode {}", mode);
    }
    say!(" after {} s", t_s);
    if let Some(sd) = heading_sd {
        say!(", heading sd {} deg", deg(sd, 2));
    }
    if self.count > 1 {
        say!(", {} times in a row", self.count);
    }
});

/// How the unit came up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start {
    /// Why, by the board.
    pub cause: ResetCause,
    /// By command.
    pub asked: bool,
    /// What ended the run before, where that was a crash.
    pub before: Option<Entry>,
}

wording!(Start, |self, say| {
    say!("started by {}", self.cause);
    if self.asked {
        say!(", as asked");
    }
    if let Some(before) = &self.before {
        say!("; before: {}", before);
    }
});

/// What is counted over resets.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Counters {
    starts: u16,
    crashes: u32,
    /// Running time since the first of them, s.
    row_s: u32,
}

impl Counters {
    fn read(memory: &impl Memory) -> Self {
        let [starts, crashes, row_s, ..] = unsealed(memory, COUNTERS).unwrap_or_default();
        Self {
            starts: starts as u16,
            crashes,
            row_s,
        }
    }

    fn write(&self, memory: &mut impl Memory) {
        let words = [self.starts.into(), self.crashes, self.row_s, 0, 0, 0, 0, 0, 0];
        seal(memory, COUNTERS, &words);
    }
}

/// What is noted once a second, in case nobody can note anything at the end.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Life {
    start: u16,
    context: Context,
    /// A reset was asked for.
    asked: bool,
    /// A fault is latched.
    held: bool,
    /// The unit was told to rest.
    rests: bool,
}

const ASKED: u32 = 1;
const HELD: u32 = 1 << 1;
const RESTS: u32 = 1 << 2;

impl Life {
    fn read(memory: &impl Memory) -> Option<Self> {
        let [start, flags, mode, t_s, sd, ..] = unsealed(memory, LIFE)?;
        Some(Self {
            start: start as u16,
            asked: flags & ASKED != 0,
            held: flags & HELD != 0,
            rests: flags & RESTS != 0,
            context: context(mode as u8, t_s, sd),
        })
    }

    fn write(&self, memory: &mut impl Memory) {
        let (mode, t_s, sd) = packed(&self.context);
        let flag = |is, flag| if is { flag } else { 0 };
        let flags = flag(self.asked, ASKED) | flag(self.held, HELD) | flag(self.rests, RESTS);
        let words = [self.start.into(), flags, mode.into(), t_s, sd, 0, 0, 0, 0];
        seal(memory, LIFE, &words);
    }
}

/// Before anything was noted.
const NOTHING: Context = Context {
    mode: None,
    t_s: 0,
    heading_sd: None,
};

#[inline(never)]
fn context(mode: u8, t_s: u32, sd: u32) -> Context {
    let sd = f32::from_bits(sd);
    Context {
        mode: ModeName::ALL.get(usize::from(mode)).copied(),
        t_s,
        heading_sd: (!sd.is_nan()).then_some(sd),
    }
}

#[inline(never)]
fn packed(context: &Context) -> (u8, u32, u32) {
    (
        context.mode.map_or(NONE, |mode| mode as u8),
        context.t_s,
        context.heading_sd.unwrap_or(f32::NAN).to_bits(),
    )
}

fn check(slot: usize, words: &[u32; WORDS - 1]) -> u32 {
    crc32(words.iter().flat_map(|word| word.to_le_bytes())) ^ MAGIC ^ slot as u32
}

#[inline(never)]
fn seal(memory: &mut impl Memory, slot: usize, words: &[u32; WORDS - 1]) {
    let [a, b, c, d, e, f, g, h, i] = *words;
    memory.write(slot, &[a, b, c, d, e, f, g, h, i, check(slot, words)]);
}

#[inline(never)]
fn unsealed(memory: &impl Memory, slot: usize) -> Option<[u32; WORDS - 1]> {
    let [a, b, c, d, e, f, g, h, i, sum] = memory.read(slot);
    let words = [a, b, c, d, e, f, g, h, i];
    (sum == check(slot, &words)).then_some(words)
}

#[inline(never)]
fn decoded(memory: &impl Memory, slot: usize) -> Option<Entry> {
    let [_, run, what, t_s, sd, facts @ ..] = unsealed(memory, slot)?;
    let [kind, code, mode, _] = what.to_le_bytes();
    Some(Entry {
        start: run as u16,
        count: (run >> 16) as u16,
        cause: Cause::decode(kind, code, facts)?,
        context: context(mode, t_s, sd),
    })
}

/// The number of the newest record; none comes twice, and each says the slot. Before the first: the one before it.
#[inline(never)]
fn newest(memory: &impl Memory) -> u32 {
    let mut newest = 0;
    for slot in FIRST..SLOTS {
        if let Some([number, ..]) = unsealed(memory, slot) {
            newest = newest.max(number);
        }
    }
    newest
}

const fn slot_of(number: u32) -> usize {
    FIRST + number as usize % RECORDS
}

/// Puts a record in. The same cause in the same mode as in the last one makes that one count on.
#[inline(never)]
fn put(memory: &mut impl Memory, cause: Cause, start: u16, context: &Context) {
    let mut number = newest(memory);
    let mut count = 1;
    match decoded(memory, slot_of(number)) {
        Some(last) if last.cause == cause && last.context.mode == context.mode => count = last.count.saturating_add(1),
        // From one on.
        _ => number = number.wrapping_add(1),
    }
    let (kind, code, [first, second, third, fourth]) = cause.encode();
    let (mode, t_s, sd) = packed(context);
    let run = u32::from(start) | u32::from(count) << 16;
    let what = u32::from_le_bytes([kind, code, mode, 0]);
    let words = [number, run, what, t_s, sd, first, second, third, fourth];
    seal(memory, slot_of(number), &words);
}

/// Notes what ends the program, from wherever that is. Mode and heading are those of the last second.
#[inline(never)]
pub fn note(memory: &mut impl Memory, cause: Cause, t_s: u32) {
    let start = Counters::read(memory).starts;
    let life = Life::read(memory).filter(|life| life.start == start);
    let mut context = life.map_or(NOTHING, |life| life.context);
    context.t_s = t_s;
    put(memory, cause, start, &context);
}

/// The records, the oldest first.
pub fn entries(memory: &impl Memory) -> impl Iterator<Item = Entry> {
    let newest = newest(memory);
    (1..=RECORDS as u32).filter_map(move |k| decoded(memory, slot_of(newest.wrapping_add(k))))
}

/// Whether the run under way, or the one that has just ended, asked for its reset.
pub fn is_asked(memory: &impl Memory) -> bool {
    Life::read(memory).is_some_and(|life| life.asked)
}

/// Forgets the records. Crashes in a row go on being counted.
pub fn clear(memory: &mut impl Memory) {
    for slot in FIRST..SLOTS {
        memory.write(slot, &[0; WORDS]);
    }
}

/// The box in the hands of a program that runs.
#[derive(Debug)]
pub struct BlackBox<M> {
    memory: M,
    counters: Counters,
    life: Life,
    start: Start,
    began_us: u64,
    /// Without a fault since, s.
    sound_s: Option<u32>,
}

impl<M: Memory> BlackBox<M> {
    /// Opens it, once after each reset and before anything can fail, and closes the run before. `now_us` is the
    /// unit's clock, from which the time of this run is counted.
    #[inline(never)]
    pub fn start(mut memory: M, cause: ResetCause, now_us: u64) -> Self {
        let mut counters = Counters::read(&memory);
        let life = Life::read(&memory).filter(|life| life.start == counters.starts);
        let ran_s = life.map_or(0, |life| life.context.t_s);
        let last = |memory: &M| {
            let entry = decoded(memory, slot_of(newest(memory)))?;
            (entry.start == counters.starts && entry.cause.is_fatal()).then_some(entry)
        };
        let asked = cause == ResetCause::Watchdog && life.is_some_and(|life| life.asked);
        let noted = last(&memory);
        let crashed = match cause {
            ResetCause::Watchdog => !asked,
            ResetCause::Software => noted.is_some(),
            ResetCause::BrownOut => true,
            ResetCause::PowerOn | ResetCause::Pin | ResetCause::Unknown => false,
        };
        let mut before = None;
        if crashed {
            if cause == ResetCause::BrownOut {
                note(&mut memory, Cause::BrownOut, ran_s);
            } else if noted.is_none() {
                note(&mut memory, Cause::Hang, ran_s);
            }
            before = last(&memory);
            if counters.crashes > 0 {
                counters.row_s = counters.row_s.saturating_add(ran_s);
            }
            if counters.row_s > WITHIN_S {
                (counters.crashes, counters.row_s) = (0, 0);
            }
            counters.crashes = counters.crashes.saturating_add(1);
        }
        if cause == ResetCause::PowerOn {
            (counters.crashes, counters.row_s) = (0, 0);
        }
        counters.starts = counters.starts.wrapping_add(1);
        counters.write(&mut memory);
        let life = Life {
            start: counters.starts,
            context: NOTHING,
            asked: false,
            held: cause != ResetCause::PowerOn && life.is_some_and(|life| life.held),
            rests: crashed && life.is_some_and(|life| life.rests),
        };
        life.write(&mut memory);
        let start = Start { cause, asked, before };
        Self {
            memory,
            counters,
            life,
            start,
            began_us: now_us,
            sound_s: None,
        }
    }

    /// Since the start, s.
    pub fn run_s(&self, now_us: u64) -> u32 {
        seconds(now_us.saturating_sub(self.began_us))
    }

    /// How the unit came up.
    pub fn started(&self) -> &Start {
        &self.start
    }

    /// Crashes in a row, where they are too many for the motor to be let go.
    pub fn brake(&self) -> Option<u32> {
        (self.counters.crashes >= CRASHES).then_some(self.counters.crashes)
    }

    /// Whether a fault was latched before the reset, whatever it was by, and nobody has said otherwise since.
    pub fn is_held(&self) -> bool {
        self.life.held
    }

    /// A fault is latched, or none is any more.
    pub fn hold(&mut self, held: bool) {
        if self.life.held != held {
            self.life.held = held;
            self.life.write(&mut self.memory);
        }
    }

    /// Whether the unit was told to rest before a crash, and is to go on with that: whoever stopped it may have a hand in
    /// it. A start that somebody wants leads to alignment.
    pub fn rests(&self) -> bool {
        self.life.rests
    }

    /// It is commanded to rest, or is not any more.
    pub fn rest(&mut self, rests: bool) {
        if self.life.rests != rests {
            self.life.rests = rests;
            self.life.write(&mut self.memory);
        }
    }

    /// Notes a fault.
    #[inline(never)]
    pub fn fault(&mut self, fault: &Fault, context: Context) {
        put(&mut self.memory, fault.into(), self.counters.starts, &context);
    }

    /// Whether [`BlackBox::live`] has something to note: a second has gone by, or the mode is another one.
    pub fn is_due(&self, now_us: u64, mode: ModeName) -> bool {
        self.life.context.t_s != self.run_s(now_us) || self.life.context.mode != Some(mode)
    }

    /// Notes what the unit is doing, see [`BlackBox::is_due`].
    #[inline(never)]
    pub fn live(&mut self, context: Context) {
        self.life.context = context;
        self.life.write(&mut self.memory);
        match context.mode {
            Some(ModeName::Aligned | ModeName::Navigating) => self.forgive(),
            Some(ModeName::Fault) | None => self.sound_s = None,
            Some(_) => {
                let since = *self.sound_s.get_or_insert(context.t_s);
                if context.t_s.saturating_sub(since) >= SOUND_S {
                    self.forgive();
                }
            }
        }
    }

    /// A reset is about to come, by command: no crash.
    pub fn asked(&mut self) {
        if !self.life.asked {
            self.life.asked = true;
            self.life.write(&mut self.memory);
        }
    }

    /// The crashes so far are history.
    pub fn forgive(&mut self) {
        if self.counters.crashes > 0 {
            (self.counters.crashes, self.counters.row_s) = (0, 0);
            self.counters.write(&mut self.memory);
        }
    }
}

#[cfg(test)]
mod tests;
