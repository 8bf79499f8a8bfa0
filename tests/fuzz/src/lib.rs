//! Every parser of the unit and of the simulator, fed with whatever libFuzzer makes up.
//!
//! ```text
//! bytes ─► Feed ─► what the parser sees: as it is, or with a check sum that is right ─► parser ─► property
//! ```
//!
//! A target is a function of bytes. It must not panic, and it states what must hold of any answer: a line that is taken
//! can be said again in other words, a frame is taken if and only if a check sum that is computed here in another way is
//! right. An input behind a CRC would never be got through by chance, so a target makes frames that are sound as well.
//!
//! The targets run in three ways: by libFuzzer, one program each in `fuzz_targets`; by `cargo test`, on the corpus in the
//! repository; and by [`TARGETS`], wherever else.

pub mod console;
pub mod drivers;
mod feed;
pub mod logs;
pub mod settings;
pub mod toml;

pub use feed::Feed;

/// A target.
pub type Target = fn(&[u8]);

/// All of them by name, which is that of the program and of the folder in `corpus`.
pub const TARGETS: [(&str, Target); 15] = [
    ("adis16495_burst", drivers::adis16495_burst),
    ("adis16495_bus", drivers::adis16495_bus),
    ("console_bytes", console::bytes),
    ("console_line", console::line),
    ("icm42688_bus", drivers::icm42688_bus),
    ("icm42688_data", drivers::icm42688_data),
    ("log_csv", logs::csv),
    ("log_format", logs::format),
    ("log_record", logs::record),
    ("mt6835_angle", drivers::mt6835_angle),
    ("mt6835_bus", drivers::mt6835_bus),
    ("scenario_toml", toml::scenario),
    ("settings_flash", settings::flash),
    ("settings_group", settings::group),
    ("unit_toml", toml::unit),
];

/// CRC-32/ISO-HDLC bit by bit, as in the catalogue: not the one that is tested.
pub fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |sum, byte| {
        (0..8).fold(sum ^ u32::from(*byte), |sum, _| {
            if sum & 1 == 1 { sum >> 1 ^ 0xEDB8_8320 } else { sum >> 1 }
        })
    })
}

/// CRC-8 of the encoder bit by bit, as in the catalogue.
pub fn crc8(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| {
        (0..8).fold(
            sum ^ byte,
            |sum, _| if sum & 0x80 == 0 { sum << 1 } else { sum << 1 ^ 0x07 },
        )
    })
}
