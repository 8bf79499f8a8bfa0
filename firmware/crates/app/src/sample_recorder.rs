//! Where samples leave the alignment for the [record](crate::record), while one is wanted.

use embassy_sync::blocking_mutex::raw::RawMutex;
use nav::deviation::Deviation;
use nav::noise::ImuNoise;
use nav::rotor::RotorConfig;

use crate::record::{Header, Recorder, Taken};
use crate::sample::TimedSample;
use crate::settings::Position;
use crate::shared::Shared;

/// From one header to the next, µs.
const HEADER_EVERY_US: u64 = 1_000_000;

/// See the [module](self).
#[derive(Debug)]
pub struct SampleRecorder {
    recorder: Recorder,
    noise: ImuNoise,
    schedule: RotorConfig,
    /// What the aligner uses.
    place: Position,
    deviation: Option<Deviation>,
    /// When the next header is due; at once where there was none.
    header_us: Option<u64>,
    /// The aligner has started anew since its last sample.
    anew: bool,
    /// Samples that found no room on the way to the line.
    skipped: u16,
}

impl SampleRecorder {
    /// With the figures that the aligner has been given.
    pub const fn new(noise: ImuNoise, schedule: RotorConfig, place: Position) -> Self {
        Self {
            recorder: Recorder::new(),
            noise,
            schedule,
            place,
            deviation: None,
            header_us: None,
            anew: false,
            skipped: 0,
        }
    }

    /// The aligner starts anew with another deviation, at another place if one is given.
    pub fn aligns(&mut self, place: Option<Position>, deviation: Option<Deviation>) {
        self.place = place.unwrap_or(self.place);
        self.deviation = deviation;
        self.anew();
    }

    /// The aligner starts anew at another place.
    pub fn moves(&mut self, place: Position) {
        self.place = place;
        self.anew();
    }

    /// Where the aligner is, by what it has been given.
    pub const fn place(&self) -> &Position {
        &self.place
    }

    /// The aligner starts anew.
    pub fn anew(&mut self) {
        self.anew = true;
        self.header_us = None;
    }

    /// Hands over a sample, as [`Recorder::sample`] wants it. What finds no room is left out, and counted there.
    pub fn take<M: RawMutex>(&mut self, shared: &Shared<M>, sample: &TimedSample, taken: Taken) {
        let first = taken == Taken::Aligner && core::mem::take(&mut self.anew);
        let facts = shared.imu().filter(|_| shared.is_recording());
        let Some(facts) = facts else {
            self.header_us = None;
            return;
        };
        // Room for both, or the sample is skipped: its header would announce another one.
        if shared.room_for_frames() < 2 {
            self.skipped = self.skipped.saturating_add(1);
            return;
        }
        if self.skipped > 0 {
            self.recorder.skip(core::mem::take(&mut self.skipped));
        }
        if self.header_us.is_none_or(|due_us| sample.t_us >= due_us) {
            self.header_us = Some(sample.t_us + HEADER_EVERY_US);
            let header = Header {
                serial: shared.settings().identity.serial,
                imu: facts.identity,
                period: facts.period,
                scale: facts.scale,
                latitude: self.place.latitude,
                height: self.place.height,
                schedule: self.schedule,
                noise: self.noise,
                deviation: self.deviation,
                firmware: shared.version(),
            };
            shared.send_frame(self.recorder.header(sample.t_us, &header));
        }
        let taken = if first { Taken::AlignerAnew } else { taken };
        shared.send_frame(self.recorder.sample(sample, Some(taken)));
    }
}
