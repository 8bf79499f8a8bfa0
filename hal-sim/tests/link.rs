//! The simulated unit on a socket and on a pty, and `link` at the other end.
#![allow(clippy::unwrap_used, reason = "the helpers of tests are tests")]

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Output, Stdio};
use std::thread;
use std::time::Duration;

use tempfile::TempDir;

fn hal_sim() -> Command {
    Command::new(assert_cmd::cargo::cargo_bin!("hal-sim"))
}

/// A unit that is served; it ends with the test.
struct Unit {
    process: Child,
    name: String,
}

impl Drop for Unit {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn serve(at: &str, speed: &str) -> Unit {
    serve_in("static", at, speed)
}

fn serve_in(scenario: &str, at: &str, speed: &str) -> Unit {
    let mut process = hal_sim()
        .args(["--quiet", "unit", "--scenario", scenario, "--log-level", "off"])
        .args(["--serve", at, "--speed", speed])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(process.stderr.as_mut().unwrap())
        .read_line(&mut line)
        .unwrap();
    let name = line.trim().rsplit(' ').next().unwrap().to_owned();
    Unit { process, name }
}

/// With time to answer also where the machine is busy.
fn link(unit: &Unit, arguments: &[&str]) -> Output {
    let timeout: &[&str] = if arguments.contains(&"--send") {
        &["--timeout", "30"]
    } else {
        &[]
    };
    hal_sim()
        .args(["link", &unit.name])
        .args(arguments)
        .args(timeout)
        .output()
        .unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn commands_are_answered_over_a_socket() {
    let unit = serve("tcp:127.0.0.1:0", "10");
    let found = link(
        &unit,
        &[
            "--send",
            "version",
            "--send",
            "# a remark",
            "--send",
            "set latitude 40.25",
        ],
    );
    assert_eq!(found.status.code(), Some(0), "{found:?}");
    let answers = text(&found.stdout);
    assert_eq!(
        answers,
        concat!(
            "rotary-north ",
            env!("CARGO_PKG_VERSION"),
            "\nset - align takes it up and save keeps it\n"
        )
    );
    // All of several answers, over a new connection.
    let shown = text(&link(&unit, &["--send", "show", "--send", "status"]).stdout);
    let lines: Vec<&str> = shown.lines().collect();
    assert_eq!(lines.len(), app::console::Setting::ALL.len() + 2, "{shown}");
    let [first, .., last, status] = lines[..] else {
        panic!("{shown}")
    };
    assert_eq!((first, last), ("latitude 40.25000 deg", "gyros not calibrated"));
    assert!(status.contains(" s  ") && status.contains("  heading "), "{shown}");
    assert_eq!(text(&link(&unit, &["--send", "faults"]).stdout), "no more faults\n");
    assert_eq!(
        text(&link(&unit, &["--send", "help"]).stdout).lines().count(),
        app::console::WORDS.len()
    );

    // One that is refused ends it.
    let refused = link(&unit, &["--send", "set latitude 99", "--send", "set latitude 41"]);
    assert_eq!(refused.status.code(), Some(1), "{refused:?}");
    assert_eq!(
        text(&refused.stderr),
        "error: set latitude 99: expected latitude from -85.0 to 85.0 deg\n"
    );
    let unknown = link(&unit, &["--send", "turn around"]);
    assert_eq!(unknown.status.code(), Some(1));
    assert!(text(&unknown.stderr).contains("help lists them"), "{unknown:?}");
    let shown = text(&link(&unit, &["--send", "show"]).stdout);
    assert!(shown.starts_with("latitude 40.25000 deg\n"), "{shown}");

    // Saved, it outlives a restart of the unit; the line stays.
    let saved = link(&unit, &["--send", "save", "--send", "restart"]);
    assert_eq!(saved.status.code(), Some(0), "{saved:?}");
    let shown = text(&link(&unit, &["--send", "set height 12", "--send", "show"]).stdout);
    assert!(shown.contains("latitude 40.25000 deg\n"), "{shown}");
}

#[test]
fn what_a_unit_sends_is_told_and_recorded() {
    let dir = TempDir::new().unwrap();
    let record = dir.path().join("run.nmea");
    let unit = serve("tcp:127.0.0.1:0", "20");
    let found = link(&unit, &["--seconds", "4", "--record", record.to_str().unwrap()]);
    assert_eq!(found.status.code(), Some(0), "{found:?}");
    let told = text(&found.stdout);
    assert!(
        told.contains("  heading - V") && told.contains("sentences/s, 0 check sums wrong"),
        "{told}"
    );
    let recorded = fs::read_to_string(record).unwrap();
    let whole = |line: &&str| line.starts_with("$PRNST,") && line.contains('*') && nmea_kit::parse_frame(line).is_ok();
    let status = recorded.lines().filter(whole).count();
    assert!(status >= 2, "{recorded}");
    assert_eq!(told.lines().count(), status, "{told}");
    // A line may have been under way when it began and when it ended.
    let lines: Vec<&str> = recorded.lines().collect();
    for line in &lines[1..lines.len() - 1] {
        assert!(nmea_kit::parse_frame(line).is_ok(), "{line}");
    }
}

#[test]
fn a_calibration_is_followed_to_its_end() {
    let unit = serve("tcp:127.0.0.1:0", "40");
    let early = link(&unit, &["--send", "calibrate"]);
    assert_eq!(early.status.code(), Some(1), "{early:?}");
    let found = link(&unit, &["--send", "stop", "--send", "calibrate", "--send", "save"]);
    assert_eq!(found.status.code(), Some(0), "{found:?}");
    let said = text(&found.stdout);
    let lines: Vec<&str> = said.lines().collect();
    let ["the rotor stops", calibrating, end, "saved"] = lines[..] else {
        panic!("{said}")
    };
    assert_eq!(calibrating, "calibrating: keep the base still for 3 minutes");
    assert!(
        end.starts_with("gyros calibrated: z scale ") && end.ends_with(" ppm - biases not used"),
        "{end}"
    );
}

/// The unit says why, and what was to follow is not sent.
#[test]
fn a_calibration_that_fails_says_why() {
    let unit = serve_in("paper-sim", "tcp:127.0.0.1:0", "40");
    thread::sleep(Duration::from_secs(1));
    let found = link(&unit, &["--send", "stop", "--send", "calibrate", "--send", "save"]);
    assert_eq!(found.status.code(), Some(1), "{found:?}");
    assert_eq!(
        text(&found.stderr).trim(),
        "error: calibrate: gyros not calibrated: the base moves: keep the base still and try again"
    );
    assert!(!text(&found.stdout).contains("saved"), "{found:?}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_pty_is_a_serial_port() {
    let unit = serve("pty", "1");
    assert!(unit.name.starts_with("/dev/"), "{}", unit.name);
    for _ in 0..2 {
        let found = link(&unit, &["--send", "version", "--send", "log warn"]);
        assert_eq!(found.status.code(), Some(0), "{found:?}");
        assert!(text(&found.stdout).ends_with("\nwarn\n"), "{found:?}");
    }
    let found = link(&unit, &["--seconds", "2.5"]);
    assert!(text(&found.stdout).contains("  heading "), "{found:?}");
}

#[test]
fn a_line_without_a_unit_says_so() {
    // Somebody who listens and says nothing, and one who only talks.
    for (said, expected) in [
        (&b""[..], "nothing came in 0.3 s"),
        (b"$HETHS,,V*14\r\n", "no answer in 0.3 s"),
    ] {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = format!("tcp:{}", listener.local_addr().unwrap());
        let other = thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            stream.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
            let mut heard = Vec::new();
            let mut bytes = [0; 64];
            loop {
                match stream.read(&mut bytes) {
                    Ok(0) => return heard,
                    Ok(count) => heard.extend_from_slice(&bytes[..count]),
                    Err(_) => stream.write_all(said).unwrap_or_default(),
                }
            }
        });
        let found = hal_sim()
            .args(["link", &port, "--timeout", "0.3", "--send", "stop", "--send", "align"])
            .output()
            .unwrap();
        assert_eq!(found.status.code(), Some(1), "{found:?}");
        assert!(text(&found.stderr).contains(expected), "{found:?}");
        assert_eq!(text(&other.join().unwrap()), "\r\nstop\r\n");
    }
}

#[test]
fn what_cannot_be_linked_is_bad_input() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = format!("tcp:{}", listener.local_addr().unwrap());
    let closing = thread::spawn(move || drop(listener.accept().unwrap()));
    let gone = hal_sim().args(["link", &port]).output().unwrap();
    closing.join().unwrap();
    assert_eq!(gone.status.code(), Some(2), "{gone:?}");
    assert!(text(&gone.stderr).contains("is gone"), "{gone:?}");
    for (arguments, expected) in [
        (&["link", &port][..], "hal-sim unit --serve"),
        (&["link", "/dev/no-such-port"], "plug the unit in"),
        (&["link", "tcp:here"], "expected tcp:HOST:PORT"),
        (&["link", &port, "--timeout", "0"], "expected seconds"),
        (&["unit", "--serve", "tty"], "expected pty or tcp:HOST:PORT"),
        (
            &["unit", "--serve", "tcp:127.0.0.1:0", "--speed", "0"],
            "expected a number",
        ),
    ] {
        let found = hal_sim().args(arguments).output().unwrap();
        assert_eq!(found.status.code(), Some(2), "{found:?}");
        assert!(text(&found.stderr).contains(expected), "{found:?}");
    }
}

/// As any program that reads NMEA 0183 over TCP would do it: one that comes later finds the unit as well.
#[test]
fn one_client_after_the_other_is_served() {
    let unit = serve("tcp:127.0.0.1:0", "10");
    for _ in 0..3 {
        let stream = TcpStream::connect(unit.name.strip_prefix("tcp:").unwrap()).unwrap();
        let mut lines = BufReader::new(stream).lines();
        let found = lines
            .by_ref()
            .take(20)
            .map(Result::unwrap)
            .filter(|line| nmea_kit::parse_frame(line).is_ok());
        assert!(found.count() >= 19);
    }
}
