//! Commands on the serial line: a line of text in, an answer out.
//!
//! ```text
//! help                     what there is
//! status                   the status sentence, now
//! version                  of the program
//! hardware                 what was found of the hardware, and what was expected
//! align                    align from the beginning
//! calibrate                calibrate the gyros: from rest, better once aligned
//! deviation                keep what was found of the housing's gyro error; `deviation clear` forgets it
//! navigate                 dead reckoning from here: once aligned
//! stop                     stop the rotor and rest
//! selftest                 test, then rest: from rest only
//! reset                    forget the fault and start again
//! restart                  start the program anew
//! show                     the settings
//! set latitude 40.1        a setting: see [`Setting::ALL`]; `set talker HC`
//! save                     keep settings and calibration
//! faults                   the last faults and crashes, over resets; `faults clear` forgets them
//! log info                 error, warn, info or debug
//! record on                every sample between the sentences, for a replay; or off
//! ```
//!
//! How a line is read is [`parse`]'s and [`LineBuffer`]'s, and pure; [`run`] is the task, which executes commands and keeps the settings.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Instant, Timer};
use embedded_io_async::Read;
use embedded_storage_async::nor_flash::NorFlash;
use frames::units::{DEG, DEG_PER_HOUR};
use nav::deviation::Deviation;

use crate::alignment::{AGREE, DOUBT_US, INSTANT_US};
use crate::blackbox::{self, Memory};
use crate::command::Command;
use crate::hal::Supply;
use crate::nmea::{self, Sentence, SentenceBuilder};
use crate::nmea_in::{Fix, Place};
use crate::output::Port;
use crate::settings::{Group, Position, Settings, Source, Store, StoreError};
use crate::shared::Shared;
use crate::utc::Utc;

mod grammar;
mod hardware;

pub use grammar::{LONGEST, LineBuffer, LineError, Request, Setting, WORDS, Word, parse};

/// Seconds from one position that is kept to the next: the flash bears it for 38 years.
const KEEP_S: u64 = 60;
/// Closer than this to the one that is kept, rad, a position is the same: 0.01°, 1.1 km.
const KEEP_AWAY: f32 = (0.01 * DEG) as f32;
/// A deviation is worth keeping once its σ is below so much of that which the IMU's figures say.
const LEARNT: f32 = 0.5;

/// The task: takes lines from `rx`, answers them on `port`, keeps the settings.
///
/// Bytes that come while it saves wait in the receiver; what does not fit there spoils its line only.
pub async fn run<M: RawMutex, F: NorFlash>(
    shared: &Shared<M>,
    port: &Port<M>,
    mut rx: impl Read,
    mut store: Store<F>,
    mut records: impl Memory,
    mut supply: impl Supply,
) -> ! {
    let mut lines = LineBuffer::new();
    let mut keep = Keep::default();
    let mut bytes = [0; 16];
    loop {
        let count = rx.read(&mut bytes).await.unwrap_or(0);
        if count == 0 {
            // Noise, a wrong baud rate, bytes lost: the line is refused at its end. Not at once again: a receiver that
            // only fails must not keep the others from their work.
            lines.garble();
            Timer::after_millis(5).await;
        }
        for byte in bytes.iter().take(count) {
            if let Some(found) = lines.push(*byte) {
                match found {
                    Ok(Request::Fix(fix)) => handle_fix(shared, &mut store, &mut supply, &fix, &mut keep).await,
                    Ok(request) => execute(shared, port, &mut store, &mut records, &mut supply, request).await,
                    Err(error) => port.answer(nmea::answer(false, error.expected())).await,
                }
            }
        }
    }
}

/// A place that a receiver says and that is not the one kept.
#[derive(Default)]
struct Keep {
    /// The last such, and when it was said, µs.
    said: Option<(Place, u64)>,
    /// How many in a row have agreed with it, itself among them.
    agreed: u8,
    /// When the next one may be kept, µs.
    due_us: u64,
}

impl Keep {
    /// Whether a place that is not the one kept is to be accepted: one alone may be what a receiver says that has just been
    /// switched on. 0°, 0° sharp never is, as receivers without a fix say it over and over.
    fn accepts(&mut self, place: Place, t_us: u64) -> bool {
        let before = self
            .said
            .filter(|(said, at_us)| said.is_near(&place, KEEP_AWAY) && t_us.saturating_sub(*at_us) <= DOUBT_US);
        if place.is_null() {
            self.said = None;
            return false;
        }
        match before {
            // Another sentence of the same instant.
            Some((_, at_us)) if t_us.saturating_sub(at_us) < INSTANT_US => return self.agreed >= AGREE,
            Some(_) => self.agreed = self.agreed.saturating_add(1),
            None => self.agreed = 1,
        }
        self.said = Some((place, t_us));
        self.agreed >= AGREE
    }
}

/// Passes on what a receiver says, and keeps time and place once they are accepted.
async fn handle_fix<M: RawMutex, F: NorFlash>(
    shared: &Shared<M>,
    store: &mut Store<F>,
    supply: &mut impl Supply,
    fix: &Fix,
    keep: &mut Keep,
) {
    // The alignment hears of the next one.
    let _ = shared.fixes.try_send(*fix);
    let Some(place) = fix.place else {
        return;
    };
    let Place { latitude, longitude } = place;
    let last = shared.settings().last_position;
    let kept = Place {
        latitude: last.latitude,
        longitude: last.longitude,
    };
    let is_kept = last.source == Source::Gnss && place.is_near(&kept, KEEP_AWAY);
    let now_us = Instant::now().as_micros();
    if is_kept {
        keep.said = None;
    } else if !keep.accepts(place, now_us) {
        return;
    }
    if let Some(said) = fix.time {
        shared.utc_is(Utc { said, t_us: now_us });
    }
    if is_kept || now_us < keep.due_us {
        return;
    }
    keep.due_us = now_us + KEEP_S * 1_000_000;
    let position = Position {
        latitude,
        longitude,
        height: last.height,
        source: Source::Gnss,
    };
    let received = Settings {
        last_position: position,
        ..shared.settings()
    };
    if received.validate(Group::LastPosition).is_err() {
        // Near a pole: no place to align at, and none to keep.
        return;
    }
    shared.change(|settings| settings.last_position = position);
    // What fails here fails at `save` as well, which says so.
    if supply.is_enough() {
        let _ = store.save_position(&position).await;
    }
}

async fn execute<M: RawMutex, F: NorFlash>(
    shared: &Shared<M>,
    port: &Port<M>,
    store: &mut Store<F>,
    records: &mut impl Memory,
    supply: &mut impl Supply,
    request: Request,
) {
    let (ok, text) = match request {
        Request::Help => {
            for word in &WORDS {
                let mut line = SentenceBuilder::answer(true);
                for text in [word.name, " - ", word.help] {
                    line.words(text);
                }
                port.answer(line.end()).await;
            }
            return;
        }
        Request::Show => {
            let settings = shared.settings();
            for setting in &grammar::SETTINGS {
                port.answer(setting.tell(&settings)).await;
            }
            if let Some(deviation) = &settings.deviation {
                port.answer(tell(deviation)).await;
            }
            let calibrated = settings.imu.calibration.is_some();
            (
                true,
                if calibrated {
                    "gyros calibrated"
                } else {
                    "gyros not calibrated"
                },
            )
        }
        Request::Faults => {
            for entry in blackbox::entries(records) {
                port.answer(entry.answer()).await;
            }
            (true, "no more faults")
        }
        Request::Deviation => match found(shared) {
            Ok(deviation) => {
                shared.change(|settings| settings.deviation = Some(deviation));
                port.answer(tell(&deviation)).await;
                (true, taken_up(Group::Installation))
            }
            Err(why) => (false, why),
        },
        Request::ClearDeviation => {
            shared.change(|settings| settings.deviation = None);
            (true, taken_up(Group::Installation))
        }
        Request::ClearFaults => {
            blackbox::clear(records);
            (true, "forgotten")
        }
        Request::Status => {
            port.status();
            return;
        }
        Request::Fix(_) => return,
        Request::Version => {
            let mut line = SentenceBuilder::answer(true);
            line.words("rotary-north ");
            line.words(shared.version());
            return port.answer(line.end()).await;
        }
        Request::Hardware => {
            let supply = [supply.is_enough(), supply.is_guarded()];
            for fact in hardware::FACTS {
                port.answer(hardware::tell(shared, supply, fact)).await;
            }
            (true, "no more facts")
        }
        Request::Record(on) => {
            shared.set_recording(on);
            (true, if on { "recording" } else { "not recording" })
        }
        Request::Log(level) => {
            shared.set_log_level(level);
            (true, level.name())
        }
        Request::Set(setting, value) => {
            let mut refused = None;
            shared.change(|settings| match setting.put(*settings, value) {
                Ok(changed) => *settings = changed,
                Err(invalid) => refused = Some(invalid),
            });
            if let Some(invalid) = refused {
                return port.answer(setting.expected(invalid)).await;
            }
            (true, taken_up(setting.group))
        }
        Request::Save => match save(store, supply, &shared.settings()).await {
            Ok(()) => (true, "saved"),
            Err(error) => (false, why(error)),
        },
        Request::Unit(command) => {
            let mode = shared.status.try_get().map(|status| status.mode);
            match mode {
                Some(mode) if !mode.takes(command) => (false, refusal(command)),
                _ if command == Command::Calibrate && !shared.clock().is_exact() => {
                    (false, "not by the chip's own clock")
                }
                _ if shared.commands.try_send(command).is_ok() => (true, done(command)),
                _ => (false, "expected some time between commands"),
            }
        }
    };
    port.answer(nmea::answer(ok, text)).await;
}

/// The gyro error of the housing as the alignment has found it, where that is worth keeping.
fn found<M: RawMutex>(shared: &Shared<M>) -> Result<Deviation, &'static str> {
    let navigation = shared.navigation.try_get();
    let found = navigation.and_then(|navigation| navigation.deviation);
    let found = found.ok_or("nothing found: align then turn the base through four headings")?;
    // At one heading σ stays what the figures of the IMU say.
    if found.sd < LEARNT * shared.settings().noise.gyro_housing_sd {
        Ok(found)
    } else {
        Err("not found yet: turn the base through four headings")
    }
}

fn tell(deviation: &Deviation) -> Sentence {
    let [x, y] = deviation.rate_b;
    let mut line = SentenceBuilder::answer(true);
    for (word, rate) in [("deviation ", x), (" ", y), (" deg/h sd ", deviation.sd)] {
        line.words(word);
        line.decimal(rate / DEG_PER_HOUR as f32, 3);
    }
    line.end()
}

/// All that a command or a calibration may have changed.
async fn save<F: NorFlash>(
    store: &mut Store<F>,
    supply: &mut impl Supply,
    settings: &Settings,
) -> Result<(), StoreError> {
    for group in [
        Group::Installation,
        Group::Motion,
        Group::Output,
        Group::Identity,
        Group::Imu,
        Group::Encoder,
        Group::Noise,
        Group::Deviation,
    ] {
        if !supply.is_enough() {
            return Err(StoreError::Supply);
        }
        store.save(settings, group).await?;
    }
    Ok(())
}

/// Why nothing was saved, in words that fit an answer.
const fn why(error: StoreError) -> &'static str {
    match error {
        StoreError::Invalid(_) => "not saved: a value is out of range",
        StoreError::Newer { .. } => "not saved: the settings are a later program's",
        StoreError::Flash => "not saved: the flash reports an error",
        StoreError::Full => "not saved: no room",
        StoreError::Worn => "not saved: the flash is worn out",
        StoreError::Supply => "not saved: the supply is below 2.8 V",
        StoreError::NotNow => "not saved: no room before a restart",
    }
}

/// When a setting acts.
const fn taken_up(group: Group) -> &'static str {
    match group {
        Group::Installation => "set - align takes it up and save keeps it",
        _ => "set - save it then restart",
    }
}

/// What a command brings about.
const fn done(command: Command) -> &'static str {
    match command {
        Command::Stop => "the rotor stops",
        Command::Align => "aligning",
        Command::Calibrate => "calibrating: keep the base still for 3 minutes",
        Command::Navigate => "navigating",
        Command::SelfTest => "testing",
        Command::ResetFault => "starting again",
        Command::Restart => "restarting",
    }
}

/// When a command makes sense.
const fn refusal(command: Command) -> &'static str {
    match command {
        Command::Stop | Command::Align | Command::Restart => "not now: wait, or reset the fault",
        Command::Calibrate => "only from rest or once aligned: stop first",
        Command::Navigate => "only once aligned",
        Command::SelfTest => "only from rest: stop first",
        Command::ResetFault => "there is no fault",
    }
}
