//! The pin map of each board's page is the one that its image is built from.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test stops at the first surprise"
)]

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// Signal to (pin, function).
type PinMap = BTreeMap<String, (String, String)>;

fn read(path: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The lines `signal: PIN = "function",` of the block `pins { … }`, whatever feature they are for.
fn of_board(source: &str) -> PinMap {
    let (_, rest) = source.split_once("\n    pins {\n").expect("a block of pins");
    let (block, _) = rest.split_once("\n    }\n").expect("its end");
    let signals = block.lines().filter(|line| !line.trim().starts_with("#["));
    collect(signals.map(|line| {
        let (signal, rest) = line.trim().split_once(": ").expect(line);
        let (pin, function) = rest.split_once(" = ").expect(line);
        let function = function.strip_suffix(',').expect(line).trim_matches('"');
        (signal, pin, function)
    }))
}

/// The rows of the one table whose first cell is a signal in backticks.
fn of_docs(page: &str) -> PinMap {
    collect(page.lines().filter_map(|line| {
        let mut cells = line.strip_prefix("| `")?.split(" | ");
        let signal = cells.next()?.strip_suffix('`')?;
        Some((signal, cells.next()?, cells.next()?))
    }))
}

fn collect<'a>(rows: impl Iterator<Item = (&'a str, &'a str, &'a str)>) -> PinMap {
    let mut map = PinMap::new();
    for (signal, pin, function) in rows {
        let twice = map.insert(signal.into(), (pin.into(), function.into()));
        assert!(twice.is_none(), "{signal} is listed twice");
    }
    map
}

/// Names of pins in `text`: P, a port, a number, and no letter or digit around.
fn pins(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !c.is_alphanumeric() && c != '_').filter(|word| {
        let mut chars = word.chars();
        chars.next() == Some('P')
            && chars.next().is_some_and(|port| port.is_ascii_uppercase())
            && chars.as_str().parse::<u8>().is_ok_and(|number| number < 16)
    })
}

/// A board's file and its page.
const BOARDS: [(&str, &str); 2] = [
    ("firmware/src/board/nucleo_f429zi.rs", "docs/wiring.md"),
    ("firmware/src/board/weact_f405rg.rs", "docs/wiring-f405.md"),
];

#[test]
fn the_docs_have_the_pins_of_the_board() {
    for (source, page) in BOARDS {
        let (board, docs) = (of_board(&read(source)), of_docs(&read(page)));
        assert!(board.len() > 10, "only {} pins found in {source}", board.len());
        assert_eq!(board, docs, "{page}");
    }
}

#[test]
fn no_board_is_left_out() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../firmware/src/board");
    let files = fs::read_dir(folder).unwrap().count();
    assert_eq!(files, BOARDS.len());
}

/// All of them, so that the tasks find on each board what they ask for; only the pin held low is of one part alone.
#[test]
fn the_boards_have_the_same_signals() {
    let signals = |path| {
        let mut signals: Vec<_> = of_board(&read(path)).into_keys().collect();
        signals.retain(|signal| signal != "held_low");
        signals
    };
    assert_eq!(signals(BOARDS[0].0), signals(BOARDS[1].0));
}

#[test]
fn no_pin_has_two_signals() {
    for (source, _) in BOARDS {
        let board = of_board(&read(source));
        let mut pins: Vec<_> = board.values().map(|(pin, _)| pin).collect();
        pins.sort();
        pins.dedup();
        assert_eq!(pins.len(), board.len(), "{source}");
    }
}

/// The package of 64 pins has ports A to C, PD2 and no more; PA13 and PA14 are the debugger's, PC14 and PC15 the slow crystal's.
#[test]
fn the_pins_of_the_small_board_are_there() {
    for (signal, (pin, _)) in of_board(&read(BOARDS[1].0)) {
        let there = ["PA", "PB", "PC"].iter().any(|port| pin.starts_with(port));
        let taken = ["PA11", "PA12", "PA13", "PA14", "PC14", "PC15", "PA8"].contains(&pin.as_str());
        assert!(there && !taken, "{signal}: {pin}");
    }
}

#[test]
fn the_image_names_a_pin_nowhere_else() {
    let boards = BOARDS.map(|(source, _)| (source, of_board(&read(source)).len()));
    let others = ["board.rs", "main.rs", "tasks.rs", "params.rs", "fault.rs"];
    let others = others.map(|file| (format!("firmware/src/{file}"), 0));
    for (path, expected) in boards
        .map(|(path, count)| (path.into(), count))
        .into_iter()
        .chain(others)
    {
        let source = read(&path);
        // P0 to P15 without a port are priorities; `pins` wants a port.
        let named = pins(&source).count();
        assert_eq!(named, expected, "{path}: {:?}", pins(&source).collect::<Vec<_>>());
    }
}

#[test]
fn a_change_is_found() {
    for (source, page) in BOARDS {
        let (source, page) = (read(source), read(page));
        let docs = of_docs(&page);
        for (signal, (pin, function)) in of_board(&source) {
            let line = format!("{signal}: {pin} = \"{function}\",");
            for changed in [
                format!("{signal}: PG7 = \"{function}\","),
                format!("{signal}: {pin} = \"other\","),
                format!("{signal}_: {pin} = \"{function}\","),
            ] {
                assert_ne!(of_board(&source.replace(&line, &changed)), docs, "{changed}");
            }
            let row = format!("| `{signal}` | {pin} |");
            assert_ne!(
                of_docs(&page.replace(&row, &format!("| `{signal}` | PG7 |"))),
                docs,
                "{row}"
            );
        }
    }
}
