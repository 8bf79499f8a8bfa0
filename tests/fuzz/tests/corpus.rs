//! The corpus: what it must hold, and what every target makes of it.

use std::path::{Path, PathBuf};
use std::{env, fs};

use app::console::{Setting, WORDS};
use app::nmea::Talker;
use app::settings::{Group, Settings};
use drivers::mt6835::{self, AngleCounts, Reading, Warnings};
use frames::Vec3;
use fuzz::TARGETS;
use hal_sim::log::LogWriter;
use hal_sim::log::format::FORMATS;
use hal_sim::scenario::Scenario;
use hal_sim::unit::Unit;

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// A log of a rotor that turns at 20 °/s.
fn log(rows: u32) -> Vec<u8> {
    let mut writer = LogWriter::new(Vec::new(), true).unwrap();
    for k in 1..=rows {
        let (dt, rate) = (0.005, 0.349);
        let t = f64::from(k) * dt;
        let (turned, force) = (Vec3::new(0.0, 0.0, rate * dt), Vec3::new(0.0, 0.0, 9.8 * dt));
        writer.write(t, dt, turned, force, rate * t, Some(25.0)).unwrap();
    }
    writer.finish().unwrap()
}

/// A seed: target, name, bytes.
type Seed = (&'static str, String, Vec<u8>);

/// One valid input of each kind at least, as the library makes them.
fn seeds() -> Vec<Seed> {
    let mut seeds = Vec::new();
    let mut seed = |target, name: &str, bytes: Vec<u8>| seeds.push((target, name.to_owned(), bytes));

    let lines: Vec<_> = WORDS
        .iter()
        .map(|word| match word.name {
            "set" => "Set latitude -40.125".to_owned(),
            "log" => "log debug".to_owned(),
            "record" => "record on".to_owned(),
            name => name.to_owned(),
        })
        .collect();
    for line in &lines {
        let name = line.split(' ').next().unwrap_or_default().to_lowercase();
        seed("console_line", &name, line.clone().into_bytes());
    }
    seed("console_line", "remark", b" # nothing".to_vec());
    seed("console_line", "talker", b"set talker Hc".to_vec());
    for sentence in [
        "$GPRMC,120000.00,A,4000.6000,N,00500.0000,W,0.5,90.1,010126,,,A,V~",
        "$GPVTG,90.0,T,,M,10.0,N,18.5,K,A~",
    ] {
        seed(
            "console_line",
            &sentence[3..6].to_lowercase(),
            sentence.as_bytes().to_vec(),
        );
    }
    seed(
        "console_bytes",
        "all",
        format!("\0{}\r\n", lines.join("\r\n")).into_bytes(),
    );
    seed(
        "console_bytes",
        "garbled",
        b"\x09set\x08 t period 200\nhelp\xff\n\x7f\r".to_vec(),
    );

    for group in Group::ALL {
        let mut bytes = [0; 243];
        let length = Settings::default().encode(group, &mut bytes).unwrap();
        let body = [&[group.key(), group.version()], &bytes[..length]].concat();
        seed("settings_group", group.as_str(), body);
        // An older record of it, a damaged one, a newer one; then a save, and one in which the power goes.
        let key = group.key();
        let records = [2, key, 7, 1, 0, 0x42, key, 8, 2, 0, 40, 1, 3, key, 9, 3, 0];
        let save = |cut| [&[0, key, 33, 1, cut], &records[..]].concat();
        seed("settings_flash", group.as_str(), save(0));
        seed("settings_flash", &format!("{group}-cut"), save(9));
    }

    let burst: Vec<u8> = (0..drivers::adis16495::BURST_LEN as u8).collect();
    for (name, how) in [("none", 0), ("one", 1), ("two", 2)] {
        seed("adis16495_burst", name, [&burst[..], &[how]].concat());
    }
    seed("adis16495_burst", "silent", vec![0xFF; 40]);
    // Select page 0 and sample, again and again; then everything once, the parts' numbers where they are asked for.
    let sample = [&[0, 0], &burst[..], &[2]].concat();
    seed(
        "adis16495_bus",
        "samples",
        [&[0, 20, 0], &sample[..], &sample[2..], &sample[2..]].concat(),
    );
    let product = drivers::adis16495::PRODUCT.to_be_bytes();
    let identify = [
        &[2, 20, 0],
        &sample[..],
        &[0, 0],
        &product[..],
        &[0; 6],
        &[0, 3],
        &[0; 40],
    ]
    .concat();
    seed("adis16495_bus", "identify", identify);
    seed(
        "adis16495_bus",
        "configure",
        [&[4, 20, 0], &sample[..], &sample[2..], &[0; 80]].concat(),
    );
    seed(
        "adis16495_bus",
        "self-test",
        [&[8, 20, 0], &sample[..], &[0; 100]].concat(),
    );

    seed("icm42688_data", "data", (0..17).collect());
    seed("icm42688_data", "invalid", [&[0; 4], &[0x80][..], &[0; 12]].concat());
    seed("icm42688_bus", "samples", [&[0, 0x76], &[7; 120][..]].concat());
    seed("icm42688_bus", "all", [&[0xFF, 0x71], &[0x47; 250][..]].concat());

    let reading = Reading {
        angle: AngleCounts::new(0x12_3456),
        warnings: Warnings::WEAK_FIELD,
    };
    seed("mt6835_angle", "angle", mt6835::burst(reading).to_vec());
    seed("mt6835_angle", "zero", vec![0; 4]);
    let [a, b, c, d] = mt6835::burst(reading);
    seed("mt6835_bus", "angle", vec![0, 5, 4, 0, 0, a, b, c, d, 0]);
    seed(
        "mt6835_bus",
        "zero",
        vec![0, 5, 4, 0, 0, 0, 0, 0, 0, 1, 0, 0, mt6835::MARK],
    );
    seed(
        "mt6835_bus",
        "identify",
        vec![2, 5, 4, 0, 0, 0, 0, 0, mt6835::MARK, 0, 0, a, b, c, d, 0],
    );

    seed("log_csv", "turning", log(4));
    seed("log_csv", "sentence", b"$GPHDT,10.0,T*03\r\n".to_vec());
    let sentence = |body: &str| {
        let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
        format!("${body}*{sum:02X}\n")
    };
    let imu = sentence("VNIMU,0,0,0,0.1,0.2,-9.8,0.01,0.02,-0.35,20.7,101.3").repeat(3);
    let vectornav = format!("base = 'vectornav-imu'\n[time]\nrate_hz = 100\n---\n{imu}");
    seed("log_format", "vectornav", vectornav.into_bytes());
    let counts = "mounting = 'y,x,-z'\n[time]\ncolumn = 'n'\nunit = 'samples'\nrate_hz = 100\nwrap = 16\n[gyro]\n\
                  columns = ['a', 2, 3]\nunit = 'deg'\nscale = -0.5\n[accel]\ncolumns = [4, 5, 6]\nunit = 'mg'\n[encoder]\n\
                  column = 'e'\nunit = '-4096/turn'\n---\na;b;c;d;f;g;n;e\n1,5;2;3;4;5;6;14;0\n1;2;3;4;5;6;15;1\n\
                  1;2;3;4;5;6;0;2\n";
    seed("log_format", "counts", counts.into());
    seed(
        "log_format",
        "clock",
        b"time = { column = 7, unit = 'clock' }\ngyro = { columns = [1, 2, 3] }\naccel = { columns = [4, 5, 6], unit = 'm/s' }\n\
          ---\n% x\n1 2 3 4 5 6 23:59:59.99\n1 2 3 4 5 6 00:00:00,00\n"
            .to_vec(),
    );
    // A header, samples, a gap, a status, a sentence, a damaged byte, a restart.
    let header = [&[0x32, b'0', b'.', b'1'], &[0; 46][..]].concat();
    let turning = [&[0], &[1; 15][..]].concat();
    let rest = [&[5, 3, 2, 9, 9, 4, 3, b'A', b'B', b'C', 0x27, 1][..], &header, &turning].concat();
    seed(
        "log_record",
        "clean",
        [&header[..], &turning, &turning, &turning].concat(),
    );
    seed("log_record", "all", [&header[..], &turning, &turning, &rest].concat());
    seed("log_record", "any-bits", [&header[..], &[1], &[0x3A; 41]].concat());

    seed(
        "unit_toml",
        "default",
        toml::to_string(&Unit::default()).unwrap().into_bytes(),
    );
    // Whole scenarios are in `hal-sim/scenarios`.
    let text =
        "[place]\nlatitude_deg = 31.5\n\n[[encoder.harmonics]]\norder = 2\n\n[[faults]]\nkind = \"imu-silent\"\n";
    seed("scenario_toml", "small", text.into());
    seeds
}

/// The words that libFuzzer is to try: commands, settings, keys, columns.
fn words() -> [(&'static str, Vec<String>); 5] {
    let console = WORDS
        .iter()
        .map(|word| word.name)
        .chain(Setting::ALL.iter().map(|setting| setting.name))
        .chain(Talker::ALL.map(Talker::as_str));
    let keys = |text: String| {
        let mut keys: Vec<_> = text
            .lines()
            .filter_map(|line| {
                line.split_once(" = ")
                    .map(|(key, _)| key.to_owned())
                    .or(Some(line.to_owned()))
            })
            .filter(|key| !key.is_empty())
            .collect();
        keys.sort();
        keys.dedup();
        keys
    };
    let scenarios = Scenario::builtin_names().map(|name| Scenario::builtin(name).unwrap());
    let scenarios: Vec<_> = scenarios.map(|scenario| toml::to_string(&scenario).unwrap()).collect();
    [
        ("console_line", console.map(str::to_owned).collect()),
        ("scenario_toml", keys(scenarios.join("\n"))),
        ("unit_toml", keys(toml::to_string(&Unit::default()).unwrap())),
        (
            "log_format",
            keys(FORMATS.map(|format| format.text).join("\n"))
                .into_iter()
                .chain(FORMATS.map(|format| format.name.to_owned()))
                .chain(
                    [
                        "base",
                        "encoder",
                        "scale",
                        "offset_deg",
                        "clock",
                        "samples",
                        "/turn",
                        "---",
                        "%",
                        "//",
                        "us",
                        "mdps",
                    ]
                    .map(str::to_owned),
                )
                .collect(),
        ),
        (
            "log_csv",
            hal_sim::log::COLUMNS
                .into_iter()
                .chain(["temperature_c", "NaN", "\\xef\\xbb\\xbf"])
                .map(str::to_owned)
                .collect(),
        ),
    ]
}

/// `FUZZ_SEEDS=write cargo test` writes them.
#[test]
fn seeds_are_what_the_library_makes() {
    let write = env::var_os("FUZZ_SEEDS").is_some();
    let mut files: Vec<_> = seeds()
        .into_iter()
        .map(|(target, name, bytes)| (folder("corpus").join(target).join(name), bytes))
        .collect();
    files.extend(words().map(|(target, words)| {
        let lines: String = words
            .iter()
            .map(|word| format!("\"{}\"\n", word.replace('"', "\\\"")))
            .collect();
        (folder("words").join(target), lines.into_bytes())
    }));
    for (path, bytes) in files {
        if write {
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, &bytes).unwrap();
        }
        assert_eq!(fs::read(&path).ok(), Some(bytes), "{}: see above", path.display());
    }
}

/// Every input in the repository, those that failed once among them.
#[test]
fn every_target_takes_its_corpus() {
    for (name, target) in TARGETS {
        let files = fs::read_dir(folder("corpus").join(name)).unwrap();
        let mut count = 0;
        for file in files {
            target(&fs::read(file.unwrap().path()).unwrap());
            count += 1;
        }
        assert!(count > 0, "{name}");
    }
    for file in fs::read_dir(folder("../../hal-sim/scenarios")).unwrap() {
        fuzz::toml::scenario(&fs::read(file.unwrap().path()).unwrap());
    }
}
