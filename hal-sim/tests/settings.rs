//! The settings over power cuts, damage, time and other programs, on a simulated flash.
#![allow(clippy::unwrap_used, reason = "tests")]

use app::hal::Supply;
use app::nmea::Talker;
use app::settings::{
    Group, Imu, Invalid, Mounting, Origin, OutputConfig, Report, Saved, Settings, Source, Store, StoreError,
};
use drivers::crc::crc32;
use drivers::harmonics::{Harmonic, Harmonics};
use embassy_futures::block_on;
use embassy_time::{Duration, Instant, with_timeout};
use frames::Vec3;
use hal_sim::device::flash::{ENDURANCE, ERASE_STEPS, ERASE_US, Flash, PROGRAM_US, SECTOR, SECTORS};
use nav::calibration::Calibration;
use nav::deviation::Deviation;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Deserialize;

/// A record's fields, as they are in flash.
fn body(settings: &Settings, group: Group) -> Vec<u8> {
    let mut bytes = [0; 244];
    let length = settings.encode(group, &mut bytes).unwrap();
    bytes[..length].to_vec()
}

/// Gives a group other values, of every size its record may have.
fn change(settings: &mut Settings, group: Group, rng: &mut ChaCha8Rng) {
    let some = |rng: &mut ChaCha8Rng, most: f32| rng.random_range(-most..=most);
    match group {
        Group::Identity => settings.identity.serial = rng.random_range(0..1 << 24),
        Group::Installation => {
            settings.installation.position.latitude = some(rng, 1.4);
            settings.installation.position.source = Source::Operator;
            settings.installation.mounting.heading = some(rng, 3.1);
        }
        Group::LastPosition => {
            settings.last_position.latitude = some(rng, 1.4);
            settings.last_position.height = some(rng, 9000.0);
            settings.last_position.source = Source::Gnss;
        }
        Group::Motion => settings.motion.rate = rng.random_range(0.1..0.7),
        Group::Output => {
            settings.output.period_ms = rng.random_range(50..10_000);
            settings.output.talker = Talker::ALL[rng.random_range(0..Talker::ALL.len())];
        }
        Group::Imu => {
            settings.imu = Imu {
                calibration: rng.random_bool(0.8).then(|| Calibration {
                    bias_s: Vec3::new(some(rng, 0.1), some(rng, 0.1), some(rng, 0.1)),
                    k_xz: some(rng, 0.05),
                    k_yz: some(rng, 0.05),
                    s_z: some(rng, 0.05),
                    bias_sd: 1e-6,
                    column_sd: 1e-6,
                    scatter: 1.0,
                    rest: 60.0,
                    turn: 60.0,
                    turned: 21.0,
                }),
                temperature_c: some(rng, 60.0),
            }
        }
        Group::Thermal => {
            settings.thermal.used = rng.random_range(1..=6);
            for (i, row) in settings.thermal.rows.iter_mut().enumerate() {
                row.temperature_c = 10.0 * i as f32 - some(rng, 4.0);
                row.bias_s = [some(rng, 0.1), some(rng, 0.1), some(rng, 0.1)];
            }
            // What is not used is not kept.
            let used = usize::from(settings.thermal.used);
            for row in settings.thermal.rows.iter_mut().skip(used) {
                *row = app::settings::ThermalRow::default();
            }
        }
        Group::Encoder => {
            settings.encoder.zero = rng.random_range(0.0..6.0);
            settings.encoder.electrical_offset = rng.random_bool(0.5).then_some(some(rng, 6.0));
            settings.encoder.correction = Harmonics::new(std::array::from_fn(|i| Harmonic {
                order: i as u16,
                amplitude: some(rng, 1e-3),
                phase: some(rng, 3.0),
            }))
            .unwrap();
        }
        Group::Deviation => {
            settings.deviation = rng.random_bool(0.8).then(|| Deviation {
                rate_b: [some(rng, 0.1), some(rng, 0.1)],
                force_b: [some(rng, 10.0), some(rng, 10.0)],
                sd: 1e-6,
            });
        }
        Group::Noise => {
            settings.noise.angle_random_walk = rng.random_range(1e-6..1e-4);
            settings.noise.gyro_misalignment_sd = rng.random_range(0.0..0.05);
        }
    }
}

/// Mostly the position, as in life: the others stay behind and must be taken along.
fn any_group(rng: &mut ChaCha8Rng) -> Group {
    if rng.random_bool(0.99) {
        Group::LastPosition
    } else {
        Group::ALL[rng.random_range(0..Group::ALL.len())]
    }
}

fn start(flash: &Flash) -> (Store<Flash>, Settings, Report) {
    flash.power_up();
    let mut store = Store::new(flash.clone());
    let (settings, report) = block_on(store.load());
    assert_eq!(report.error, None);
    (store, settings, report)
}

/// What the unit was doing when it was switched off, and what it had in flash.
#[derive(Clone)]
struct Image {
    bytes: Vec<u8>,
    settings: Settings,
    /// The next save erases a sector.
    full: bool,
}

/// A long life: an image from time to time, and one before each change of the sector.
fn life(seed: u64, saves: usize) -> Vec<Image> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let flash = Flash::new(seed);
    let (mut store, mut settings, _) = start(&flash);
    let mut images = vec![Image {
        bytes: flash.bytes(),
        settings,
        full: true,
    }];
    for group in Group::ALL {
        change(&mut settings, group, &mut rng);
        block_on(store.save(&settings, group)).unwrap();
    }
    for k in 0..saves {
        let before = flash.counts().erases;
        let image = (flash.bytes(), settings);
        let group = any_group(&mut rng);
        change(&mut settings, group, &mut rng);
        block_on(store.save(&settings, group)).unwrap();
        let full = flash.counts().erases != before;
        if full || k % 61 == 0 {
            let (bytes, settings) = image;
            images.push(Image { bytes, settings, full });
        }
    }
    let counts = flash.counts();
    assert_eq!(counts.clashes, 0);
    assert!(counts.erases.iter().all(|erases| *erases >= 2), "{counts:?}");
    images
}

/// The state after a cut while `group` was saved: old or new, and all others as they were. Which of the two.
fn old_or_new(found: &Settings, report: &Report, old: &Settings, new: &Settings, group: Group, what: &str) -> bool {
    for other in Group::ALL {
        let (found, old) = (body(found, other), body(old, other));
        if other == group {
            assert!(
                found == old || found == body(new, other),
                "{what}: {other} is lost, {report:?}"
            );
        } else {
            assert_eq!(found, old, "{what}: {other} is lost with {group}, {report:?}");
        }
    }
    // A group whose save was cut is called older until it is saved again; one without any record before has lost it.
    for (other, origin) in report.wanting() {
        let never = body(found, other) == body(&Settings::default(), other);
        assert!(
            origin == Origin::Older || origin == Origin::Lost && never,
            "{what}: {other} {origin:?}"
        );
    }
    body(found, group) == body(new, group)
}

/// What the cuts hit.
#[derive(Debug, Default)]
struct Tally {
    cuts: usize,
    in_erases: usize,
    /// While records were moved.
    moving: usize,
    /// With the new value after it.
    news: usize,
    /// Groups called older that are not.
    suspected: usize,
}

impl Tally {
    fn add(self, other: Self) -> Self {
        Self {
            cuts: self.cuts + other.cuts,
            in_erases: self.in_erases + other.in_erases,
            moving: self.moving + other.moving,
            news: self.news + other.news,
            suspected: self.suspected + other.suspected,
        }
    }
}

/// Saves from a point of a life, three cuts at any byte in them, and then all goes on as if nothing had been.
fn sequence(seed: u64, image: &Image, rng: &mut ChaCha8Rng) -> Tally {
    let mut tally = Tally::default();
    let flash = Flash::with_bytes(&image.bytes, seed);
    let (mut store, mut settings, _) = start(&flash);
    for _ in 0..3 {
        let most = if rng.random_bool(0.7) { 300 } else { 1500 };
        flash.cut_after(rng.random_range(0..most));
        for _ in 0..30 {
            let group = any_group(rng);
            let mut new = settings;
            change(&mut new, group, rng);
            let before = flash.counts();
            let saved = block_on(store.save(&new, group));
            if saved.is_ok() {
                settings = new;
                continue;
            }
            assert_eq!(saved, Err(StoreError::Flash));
            // A record has 32 words at the most.
            let moving = flash.counts().words - before.words > 32;
            let erased = flash.counts().erases != before.erases;
            let (again, found, report) = start(&flash);
            let new = old_or_new(&found, &report, &settings, &new, group, &format!("seed {seed}"));
            tally = tally.add(Tally {
                cuts: 1,
                in_erases: usize::from(erased && !moving),
                moving: usize::from(moving),
                news: usize::from(new),
                suspected: 0,
            });
            (store, settings) = (again, found);
            break;
        }
    }
    let (mut store, _, _) = start(&flash);
    for group in Group::ALL {
        change(&mut settings, group, rng);
        block_on(store.save(&settings, group)).unwrap();
    }
    let (_, found, report) = start(&flash);
    assert_eq!(found, settings, "seed {seed}");
    // An old record in half an erased sector may look like a later one.
    tally.suspected += report.wanting().count();
    assert_eq!(
        flash.counts().clashes,
        0,
        "seed {seed}: written over what was not erased"
    );
    tally
}

/// 10 000 sequences from 300 points of three lives.
#[test]
fn no_power_cut_loses_a_value() {
    let images: Vec<Image> = (0..3).flat_map(|seed| life(seed, 6000)).collect();
    let full: Vec<Image> = images.iter().filter(|image| image.full).cloned().collect();
    let tally = (0..10_000)
        .into_par_iter()
        .map(|seed| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let from = if rng.random_bool(0.7) { &full } else { &images };
            let image = &from[rng.random_range(0..from.len())];
            sequence(seed, image, &mut rng)
        })
        .reduce(Tally::default, Tally::add);
    println!("{} images, {tally:?}", images.len());
    assert!(tally.cuts > 20_000 && tally.in_erases > 1000 && tally.moving > 300);
    assert!(tally.news > 100 && tally.suspected < 20);
}

/// Every byte of the saves that change the sector and move what is left behind.
#[test]
fn a_cut_at_every_byte_of_a_change_of_sector() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut tried, mut longest) = (0, 0);
    for (nth, image) in (7..11).flat_map(|seed| life(seed, 6000)).enumerate() {
        let mut new = image.settings;
        change(&mut new, Group::LastPosition, &mut rng);
        let flash = Flash::with_bytes(&image.bytes, 0);
        block_on(Store::new(flash.clone()).save(&new, Group::LastPosition)).unwrap();
        let counts = flash.counts();
        // Those that only write, here and there.
        if !image.full && nth % 40 != 0 {
            continue;
        }
        longest = longest.max(counts.steps);
        for cut in 0..counts.steps {
            tried += 1;
            let flash = Flash::with_bytes(&image.bytes, cut);
            flash.cut_after(cut);
            assert!(block_on(Store::new(flash.clone()).save(&new, Group::LastPosition)).is_err());
            let (mut store, found, report) = start(&flash);
            old_or_new(
                &found,
                &report,
                &image.settings,
                &new,
                Group::LastPosition,
                &format!("image {nth}, byte {cut}"),
            );
            // A second cut while it makes up for the first.
            flash.cut_after(rng.random_range(0..counts.steps));
            let _ = block_on(store.save(&new, Group::LastPosition));
            let (mut store, found, report) = start(&flash);
            old_or_new(
                &found,
                &report,
                &image.settings,
                &new,
                Group::LastPosition,
                &format!("image {nth}, twice, {cut}"),
            );
            block_on(store.save(&new, Group::LastPosition)).unwrap();
            assert_eq!(start(&flash).1, new);
        }
    }
    println!("{tried} cuts, the longest save of {longest} steps");
    assert!(tried > 5000 && longest > ERASE_STEPS + 300);
}

/// A cut in every fifth save for four lives' worth of sectors: rubbish adds up.
#[test]
fn a_life_of_power_cuts() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let flash = Flash::new(5);
    let (mut store, mut settings, _) = start(&flash);
    for k in 0..12_000 {
        let group = any_group(&mut rng);
        let mut new = settings;
        change(&mut new, group, &mut rng);
        if rng.random_bool(0.2) {
            let most = if rng.random_bool(0.9) { 60 } else { 600 };
            flash.cut_after(rng.random_range(0..most));
        }
        if block_on(store.save(&new, group)).is_ok() {
            settings = new;
            continue;
        }
        let (again, found, report) = start(&flash);
        old_or_new(&found, &report, &settings, &new, group, &format!("save {k}"));
        (store, settings) = (again, found);
    }
    let counts = flash.counts();
    println!("{counts:?}");
    assert!(counts.clashes == 0 && counts.erases.iter().all(|erases| *erases >= 4));
}

/// Saves that are given up, and the same store goes on.
#[test]
fn a_save_that_is_dropped() {
    let mut images = life(3, 5000);
    images.retain(|image| image.full);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut dropped = 0;
    for k in 0..2000 {
        let image = &images[k % images.len()];
        let flash = Flash::with_bytes(&image.bytes, 0);
        let (_, mut settings, _) = start(&flash);
        let mut store = Store::new(flash.clone().awaited());
        vtime::Executor::new()
            .block_on(Duration::from_secs(60), async {
                for nth in 0..4 {
                    // The first one in or behind the erase, at every second word.
                    let at = match nth {
                        0 => ERASE_US - 100 + 2 * PROGRAM_US * (k / images.len()) as u64,
                        _ => rng.random_range(0..600),
                    };
                    let group = any_group(&mut rng);
                    let mut new = settings;
                    change(&mut new, group, &mut rng);
                    let saved = with_timeout(Duration::from_micros(at + 8), store.save(&new, group)).await;
                    dropped += usize::from(saved.is_err());
                    let (found, report) = store.load().await;
                    old_or_new(&found, &report, &settings, &new, group, &format!("{k} at {at} us"));
                    settings = found;
                    // And goes on with what it then knows.
                    change(&mut settings, group, &mut rng);
                    assert!(store.save(&settings, group).await.is_ok(), "{k} at {at} us");
                }
            })
            .unwrap();
        assert_eq!((start(&flash).1, flash.counts().clashes), (settings, 0), "{k}");
    }
    println!("{dropped} saves dropped");
    assert!(dropped > 1000);
}

/// A record as the format has it, written down once more.
fn record(key: u8, sequence: u32, body: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0x77, 0x5E, key, body.len() as u8];
    bytes.extend(sequence.to_le_bytes());
    let sum = crc32(bytes.iter().chain(body).copied());
    bytes.extend(sum.to_le_bytes());
    bytes.extend(body);
    bytes.resize(bytes.len().next_multiple_of(16), 0xFF);
    bytes
}

fn origin(report: &Report, group: Group) -> Origin {
    report.origins[usize::from(group.key())]
}

/// Installation of version 1: latitude, longitude, height, source. It had no mounting.
#[test]
fn an_installation_of_version_1_is_migrated() {
    let mut old = vec![1];
    old.extend(0.83_f32.to_le_bytes());
    old.extend(0.2_f32.to_le_bytes());
    old.extend(120.0_f32.to_le_bytes());
    old.push(1);
    let flash = Flash::with_bytes(&record(1, 5, &old), 0);
    let before = flash.bytes();
    let (mut store, mut settings, report) = start(&flash);
    assert_eq!(origin(&report, Group::Installation), Origin::Migrated { from: 1 });
    let position = settings.installation.position;
    assert_eq!(
        (position.latitude, position.longitude, position.height, position.source),
        (0.83, 0.2, 120.0, Source::Operator)
    );
    assert_eq!(settings.installation.mounting, Mounting::default());
    assert_eq!(report.wanting().count(), 0);
    // The earlier program would still find its record.
    assert_eq!(flash.bytes(), before);
    settings.installation.mounting.heading = 1.0;
    block_on(store.save(&settings, Group::Installation)).unwrap();
    let (_, found, report) = start(&flash);
    assert_eq!(origin(&report, Group::Installation), Origin::Stored);
    assert_eq!(found, settings);
    // A record of version 2 with the fields of version 1 is none.
    old[0] = 2;
    let (_, found, report) = start(&Flash::with_bytes(&record(1, 5, &old), 0));
    assert_eq!(origin(&report, Group::Installation), Origin::Refused(Invalid::Length));
    assert_eq!(found, Settings::default());
}

/// Output of version 1: all but the talker, which was HE.
#[test]
fn an_output_of_version_1_is_migrated() {
    let mut old = vec![1];
    for count in [250_u32, 5, 300, 100] {
        old.extend(count.to_le_bytes());
    }
    for number in [0.1_f32, 2.0] {
        old.extend(number.to_le_bytes());
    }
    let expected = OutputConfig {
        period_ms: 250,
        status_every: 5,
        fresh_ms: 300,
        write_ms: 100,
        estimated_sd: 0.1,
        rate_tau: 2.0,
        talker: Talker::He,
    };
    let flash = Flash::with_bytes(&record(4, 5, &old), 0);
    let before = flash.bytes();
    let (mut store, mut settings, report) = start(&flash);
    assert_eq!(origin(&report, Group::Output), Origin::Migrated { from: 1 });
    assert_eq!(settings.output, expected);
    assert_eq!((report.wanting().count(), flash.bytes()), (0, before));
    for talker in Talker::ALL {
        settings.output.talker = talker;
        block_on(store.save(&settings, Group::Output)).unwrap();
        let (_, found, report) = start(&flash);
        assert_eq!(origin(&report, Group::Output), Origin::Stored);
        assert_eq!(found, settings);
    }
    // In a record of version 2 the talker is not missing, and one of those there are.
    old[0] = 2;
    let refused = |body: &[u8]| {
        let (_, found, report) = start(&Flash::with_bytes(&record(4, 5, body), 0));
        assert_eq!(found, Settings::default());
        origin(&report, Group::Output)
    };
    assert_eq!(refused(&old), Origin::Refused(Invalid::Length));
    old.push(4);
    let beyond = Invalid::OutOfRange {
        name: "output talker",
        low: 0.0,
        high: 3.0,
    };
    assert_eq!(refused(&old), Origin::Refused(beyond));
}

/// What a later program has saved is told, left alone and taken along, its unknown groups as well.
#[test]
fn records_of_a_later_program_are_kept() {
    let later = [record(1, 8, &[9; 60]), record(12, 9, &[1; 40])].concat();
    let flash = Flash::with_bytes(&later, 0);
    let (mut store, mut settings, report) = start(&flash);
    assert_eq!(settings, Settings::default());
    assert_eq!(origin(&report, Group::Installation), Origin::Newer { version: 9 });
    settings.installation.mounting.roll = 0.1;
    let error = StoreError::Newer {
        group: Group::Installation,
        version: 9,
    };
    assert_eq!(block_on(store.save(&settings, Group::Installation)), Err(error));
    assert_eq!(
        error.to_string(),
        "installation is of version 9, saved by a later program: load that, or erase the settings"
    );
    assert_eq!(&flash.bytes()[..later.len()], later);
    // Round the sectors more than twice.
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    for _ in 0..5000 {
        change(&mut settings, Group::LastPosition, &mut rng);
        block_on(store.save_position(&settings.last_position)).unwrap();
    }
    assert!(flash.counts().erases.iter().all(|erases| *erases >= 2));
    let (mut store, _, report) = start(&flash);
    assert_eq!(origin(&report, Group::Installation), Origin::Newer { version: 9 });
    let bytes = flash.bytes();
    for body in [[9; 60].as_slice(), &[1; 40]] {
        assert!(bytes.windows(body.len()).any(|window| window == body));
    }
    // Unless somebody wants it so.
    block_on(store.erase()).unwrap();
    assert_eq!(block_on(store.save(&settings, Group::Installation)), Ok(Saved::Written));
}

/// Damage of all kinds: no panic, only good values, and nothing wrong without a word.
#[test]
fn damage_is_told() {
    let images = life(11, 5000);
    let (mut lost, mut older, mut unchanged, mut full) = (0, 0, 0, 0);
    for seed in 0..2000 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let image = &images[rng.random_range(0..images.len())];
        let flash = Flash::with_bytes(&image.bytes, seed);
        let (_, _, sound) = start(&flash);
        assert_eq!(sound.wanting().count(), 0);
        flash.with_mut(|bytes| match rng.random_range(0..4) {
            0 => {
                for _ in 0..rng.random_range(1..2000) {
                    bytes[rng.random_range(0..SECTOR * SECTORS)] ^= 1 << rng.random_range(0..8);
                }
            }
            1 => {
                let from = rng.random_range(0..SECTOR * SECTORS);
                bytes
                    .iter_mut()
                    .skip(from)
                    .take(rng.random_range(1..3000))
                    .for_each(|byte| *byte = rng.random());
            }
            2 => {
                let sector = rng.random_range(0..SECTORS) * SECTOR;
                bytes[sector..sector + SECTOR]
                    .iter_mut()
                    .for_each(|byte| *byte = rng.random());
            }
            _ => {
                for byte in bytes.iter_mut() {
                    *byte &= if rng.random_bool(0.02) { rng.random() } else { 0xFF };
                }
            }
        });
        let (mut store, mut found, report) = start(&flash);
        for group in Group::ALL {
            assert_eq!(found.validate(group), Ok(()));
            if body(&found, group) == body(&image.settings, group) {
                unchanged += 1;
                continue;
            }
            assert!(report.damaged > 0, "seed {seed}: {group} {report:?}");
            match origin(&report, group) {
                Origin::Older => older += 1,
                Origin::Lost => lost += 1,
                // The head itself is damaged: nothing says whose it was.
                Origin::Default | Origin::Stored => {}
                other => panic!("seed {seed}: {group} {other:?}"),
            }
        }
        // It is as good as new with the next saves.
        for group in Group::ALL {
            change(&mut found, group, &mut rng);
            match block_on(store.save(&found, group)) {
                Ok(_) => {}
                // Of the values that have come up from below some are in every sector: it takes somebody to say so.
                Err(StoreError::Full) => {
                    full += 1;
                    block_on(store.erase()).unwrap();
                    for group in Group::ALL {
                        block_on(store.save(&found, group)).unwrap();
                    }
                }
                Err(error) => panic!("seed {seed}: {error:?}"),
            }
        }
        assert_eq!(start(&flash).1, found, "seed {seed}");
    }
    println!("groups unchanged {unchanged}, older {older}, lost {lost}; full {full}");
    assert!(older > 100 && lost > 100);
}

/// One record damaged, bit by bit: the one before it holds, and is called so.
#[test]
fn the_value_before_a_damaged_one() {
    let mut settings = Settings::default();
    let flash = Flash::new(0);
    let mut store = Store::new(flash.clone());
    for latitude in [0.1, 0.2] {
        settings.last_position.latitude = latitude;
        block_on(store.save(&settings, Group::LastPosition)).unwrap();
    }
    let sound = flash.bytes();
    let (old, new) = (
        Settings {
            last_position: app::settings::Position {
                latitude: 0.1,
                ..settings.last_position
            },
            ..settings
        },
        settings,
    );
    // The second record of 32 bytes: head and body, 12 + 1 + 9.
    for bit in 0..22 * 8 {
        let mut bytes = sound.clone();
        bytes[32 + bit / 8] ^= 1 << (bit % 8);
        let (_, found, report) = start(&Flash::with_bytes(&bytes, 0));
        assert_eq!(found, old, "{bit}");
        assert!(report.damaged == 1, "{bit} {report:?}");
        // Bits of magic, key and length hide whose it is; a sequence number may have become a lower one.
        if bit >= 64 {
            assert_eq!(origin(&report, Group::LastPosition), Origin::Older, "{bit}");
        }
        bytes[8] ^= 1;
        let (_, found, report) = start(&Flash::with_bytes(&bytes, 0));
        assert_eq!(
            (found, origin(&report, Group::LastPosition)),
            (Settings::default(), Origin::Lost),
            "{bit}"
        );
    }
    assert_eq!(start(&Flash::with_bytes(&sound, 0)).1, new);
}

/// Flash that somebody else has used: rubbish with good check sums in between.
#[test]
fn any_flash_is_taken_over() {
    for seed in 0..100 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut bytes: Vec<u8> = (0..SECTOR * SECTORS).map(|_| rng.random()).collect();
        for _ in 0..200 {
            let fields: Vec<u8> = (0..rng.random_range(1..=244))
                .map(|_| if rng.random_bool(0.5) { 1 } else { rng.random() })
                .collect();
            let record = record(rng.random_range(0..20), rng.random_range(0..1 << 30), &fields);
            let at = rng.random_range(0..(SECTOR * SECTORS - record.len()) / 16) * 16;
            bytes[at..at + record.len()].copy_from_slice(&record);
        }
        let flash = Flash::with_bytes(&bytes, seed);
        let (mut store, found, report) = start(&flash);
        for group in Group::ALL {
            assert_eq!(found.validate(group), Ok(()));
        }
        assert!(report.damaged > 0);
        block_on(store.erase()).unwrap();
        let mut new = Settings::default();
        for group in Group::ALL {
            change(&mut new, group, &mut rng);
            block_on(store.save(&new, group)).unwrap();
        }
        assert_eq!(start(&flash).1, new);
    }
}

#[test]
fn a_value_out_of_range_is_not_saved() {
    let flash = Flash::new(0);
    let mut store = Store::new(flash.clone());
    let mut settings = Settings::default();
    settings.motion.rate = 9.0;
    let error = block_on(store.save(&settings, Group::Motion)).unwrap_err();
    assert!(matches!(
        error,
        StoreError::Invalid(Invalid::OutOfRange { name: "rotor rate", .. })
    ));
    assert_eq!(flash.counts().words, 0);
    // Nor taken from a record of right check sum.
    let mut fields = vec![1];
    fields.extend([9.0_f32, 6.0, 3.0].into_iter().flat_map(f32::to_le_bytes));
    let (_, found, report) = start(&Flash::with_bytes(&record(3, 1, &fields), 0));
    assert_eq!(found, Settings::default());
    assert!(matches!(
        origin(&report, Group::Motion),
        Origin::Refused(Invalid::OutOfRange { name: "rotor rate", .. })
    ));
}

#[test]
fn the_sectors_wear_evenly_and_slowly() {
    let flash = Flash::new(0);
    let mut store = Store::new(flash.clone());
    let mut settings = Settings::default();
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    for group in Group::ALL {
        change(&mut settings, group, &mut rng);
        block_on(store.save(&settings, group)).unwrap();
        assert_eq!(block_on(store.save(&settings, group)), Ok(Saved::Unchanged));
    }
    let saves = 20_000;
    for _ in 0..saves {
        change(&mut settings, Group::LastPosition, &mut rng);
        block_on(store.save_position(&settings.last_position)).unwrap();
    }
    let erases = flash.counts().erases;
    let (least, most) = (erases.iter().min().unwrap(), erases.iter().max().unwrap());
    assert!(most - least <= 1, "{erases:?}");
    let good_for = f64::from(saves) / f64::from(*most) * f64::from(ENDURANCE);
    println!("{erases:?}: good for {:.1} million saves", good_for * 1e-6);
    assert!(good_for > 18e6);
}

/// A supply that is enough, or not.
struct Volts(bool);

impl Supply for Volts {
    fn is_enough(&mut self) -> bool {
        self.0
    }

    fn is_guarded(&self) -> bool {
        true
    }
}

/// Where the program is in the same bank: the start makes room, and after it nothing is erased.
#[test]
fn nothing_is_erased_after_the_start() {
    let erases = |flash: &Flash| flash.counts().erases.iter().sum::<u32>();
    let flash = Flash::new(7);
    let mut kept = Settings::default();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for round in 0..12 {
        let (mut store, found, report) = start(&flash);
        assert_eq!((found, report.wanting().count()), (kept, 0), "round {round}");
        block_on(store.erase_ahead(&mut Volts(true))).unwrap();
        let erased = erases(&flash);
        let group = [Group::Encoder, Group::LastPosition][round % 2];
        let mut saved = 0;
        loop {
            assert!(saved < 1000, "a sector was erased for them");
            let mut changed = kept;
            change(&mut changed, group, &mut rng);
            match block_on(store.save(&changed, group)) {
                Ok(_) => (kept, saved) = (changed, saved + 1),
                Err(error) => break assert_eq!(error, StoreError::NotNow),
            }
        }
        let least = [60, 250][round % 2];
        assert!(saved >= least, "{saved} saves of {group:?}");
        assert_eq!(erases(&flash), erased, "round {round}");
    }
    // Starts at which nothing is saved do not wear it out.
    let (mut store, ..) = start(&flash);
    block_on(store.erase_ahead(&mut Volts(true))).unwrap();
    let erased = erases(&flash);
    for _ in 0..5 {
        let (mut store, found, _) = start(&flash);
        assert_eq!(found, kept);
        block_on(store.erase_ahead(&mut Volts(true))).unwrap();
    }
    assert_eq!(erases(&flash), erased);
    // Nor is anything erased with too low a supply.
    let flash = Flash::new(8);
    let (mut store, ..) = start(&flash);
    block_on(store.erase_ahead(&mut Volts(false))).unwrap();
    let refused = block_on(store.save(&kept, Group::Encoder));
    assert_eq!((refused, erases(&flash)), (Err(StoreError::NotNow), 0));
}

#[test]
fn what_it_takes_of_memory() {
    let mut store = Store::new(Flash::new(0));
    let own = size_of::<Store<Flash>>() - size_of::<Flash>();
    let settings = Settings::default();
    let save = size_of_val(&store.save(&settings, Group::Imu));
    let load = size_of_val(&store.load());
    println!(
        "store {own}, settings {}, save {save}, load {load} bytes",
        size_of::<Settings>()
    );
    assert!(own <= 560 && size_of::<Settings>() <= 500 && save <= 400 && load <= 1600);
}

#[test]
fn how_long_a_save_takes() {
    let flash = Flash::new(0);
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut settings = Settings::default();
    let mut store = Store::new(flash.clone().awaited());
    let took = |store: &mut Store<Flash>, settings: &Settings, group| {
        let mut unit = vtime::Executor::new();
        unit.block_on(Duration::from_secs(2), async {
            let start = Instant::now();
            store.save(settings, group).await.unwrap();
            start.elapsed().as_micros()
        })
        .unwrap()
    };
    // The first one erases.
    assert_eq!(
        took(&mut store, &settings, Group::LastPosition),
        ERASE_US + 8 * PROGRAM_US
    );
    for (group, words) in [
        (Group::LastPosition, 8),
        (Group::Identity, 12),
        (Group::Imu, 20),
        (Group::Encoder, 32),
    ] {
        change(&mut settings, group, &mut rng);
        if group == Group::Imu {
            settings.imu.calibration.get_or_insert(Calibration {
                bias_s: Vec3::zero(),
                k_xz: 0.0,
                k_yz: 0.0,
                s_z: 0.0,
                bias_sd: 0.0,
                column_sd: 0.0,
                scatter: 0.0,
                rest: 0.0,
                turn: 0.0,
                turned: 0.0,
            });
        }
        assert_eq!(took(&mut store, &settings, group), words * PROGRAM_US, "{group}");
    }
}

/// The fields are what another library makes of them.
#[test]
fn the_records_are_those_of_postcard() {
    type F3 = (f32, f32, f32);
    /// A number as wide as in memory.
    #[derive(Debug, Deserialize, PartialEq)]
    struct Wide(#[serde(with = "postcard::fixint::le")] u32);

    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut s = Settings::default();
    for group in Group::ALL {
        change(&mut s, group, &mut rng);
    }
    s.encoder.electrical_offset = Some(1.0);
    let identity: (Wide, [u8; 16]) = postcard::from_bytes(&body(&s, Group::Identity)).unwrap();
    assert_eq!(identity, (Wide(s.identity.serial), s.identity.name));
    let installation: (F3, u8, F3) = postcard::from_bytes(&body(&s, Group::Installation)).unwrap();
    let (p, m) = (s.installation.position, s.installation.mounting);
    assert_eq!(
        installation,
        ((p.latitude, p.longitude, p.height), 1, (m.heading, m.pitch, m.roll))
    );
    let output: (Wide, Wide, Wide, Wide, f32, f32, u8) = postcard::from_bytes(&body(&s, Group::Output)).unwrap();
    assert_eq!(output.0, Wide(s.output.period_ms));
    assert_eq!((output.5, output.6), (s.output.rate_tau, s.output.talker as u8));
    let thermal: Vec<(f32, F3)> = {
        let bytes = body(&s, Group::Thermal);
        (0..usize::from(bytes[0]))
            .map(|i| postcard::from_bytes(&bytes[1 + 16 * i..]).unwrap())
            .collect()
    };
    for (row, found) in s.thermal.rows.iter().zip(thermal) {
        assert_eq!(
            (row.temperature_c, row.bias_s),
            (found.0, [found.1.0, found.1.1, found.1.2])
        );
    }
    let encoder: (f32, bool, f32, [(Wide, f32, f32); 8]) = postcard::from_bytes(&body(&s, Group::Encoder)).unwrap();
    assert_eq!((encoder.0, encoder.1, encoder.2), (s.encoder.zero, true, 1.0));
    for (row, found) in s.encoder.correction.rows().iter().zip(encoder.3) {
        assert_eq!((Wide(u32::from(row.order)), row.amplitude, row.phase), found);
    }
}
