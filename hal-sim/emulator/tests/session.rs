//! A session with the release image: what is typed on its serial line, what it answers, and what its flash keeps.
#![allow(clippy::unwrap_used, reason = "tests")]

use emulator::image::Image;
use emulator::nmea::Sentence;
use emulator::outcome::Verdict;
use emulator::run::{self, Observer, Setup, Typed};
use hal_sim::scenario::Scenario;

/// What the unit has sent, but for the cycles.
#[derive(Default)]
struct Kept {
    answers: Vec<String>,
    places: Vec<String>,
}

impl Observer for Kept {
    fn sentence(&mut self, sentence: &Sentence) {
        let text = sentence.text.trim_end();
        if let Some(answer) = text.strip_prefix("$PRNSA,") {
            self.answers
                .push(answer.split('*').next().unwrap_or_default().to_owned());
        } else if text.starts_with("$HEGLL,") {
            self.places.push(text.to_owned());
        }
    }
}

fn typed_at((at_s, text): (f64, &str)) -> Typed {
    Typed {
        at_s,
        text: text.to_owned(),
    }
}

/// Sets its place, calibrates its gyros from rest, saves, starts anew from what it saved, aligns, navigates.
#[test]
fn a_unit_is_set_calibrated_saved_restarted_and_navigates() {
    let path = Image::release();
    let image = Image::read(&path).unwrap_or_else(|e| panic!("{e}: `cargo fw` builds the image"));
    let typed = [
        (12.0, "set latitude 40"),
        (12.5, "set longitude -8.5"),
        (13.0, "set latitude 86"),
        (20.0, "stop"),
        (21.0, "calibrate"),
        (164.0, "save"),
        (166.0, "restart"),
        (255.0, "navigate"),
    ];
    let setup = Setup {
        typed: typed.map(typed_at).to_vec(),
        ..Setup::new(Scenario::builtin("static").unwrap(), 3, 290.0)
    };
    let (outcome, kept) = run::run(&image, &setup, Kept::default()).unwrap();
    assert!(outcome.gaps.is_empty(), "{:?}", outcome.gaps);
    assert_eq!(
        kept.answers,
        [
            "ok,set - align takes it up and save keeps it",
            "ok,set - align takes it up and save keeps it",
            "error,expected latitude from -85.0 to 85.0 deg",
            "ok,the rotor stops",
            "ok,calibrating: keep the base still for 3 minutes",
            "ok,saved",
            "ok,restarting",
            "ok,navigating",
        ]
    );
    let modes: Vec<&str> = outcome.modes.iter().map(|at| at.mode).collect();
    assert_eq!(
        modes,
        [
            "self-test",
            "homing",
            "coarse",
            "idle",
            "self-test",
            "calibrating",
            "idle",
            "self-test",
            "homing",
            "coarse",
            "fine",
            "aligned",
            "navigating",
        ],
        "{:?}",
        outcome.modes
    );
    assert_eq!((outcome.resets.len(), outcome.faults.len()), (1, 0));
    // The electrical offset was kept: the second homing is the search alone.
    let homing = |nth: usize| outcome.modes[nth + 1].t_s - outcome.modes[nth].t_s;
    assert!(homing(8) < homing(1) - 2.0, "{:?}", outcome.modes);
    assert_eq!(outcome.verdict, Verdict::Aligned, "{:?}", outcome.last);
    // Half a minute of dead reckoning from the place that was saved.
    let place = kept.places.last().unwrap();
    assert!(place.starts_with("$HEGLL,4") && place.contains(",N,00830."), "{place}");
    assert!(outcome.flash.iter().any(|byte| *byte != 0xFF));
}

/// Turned through three headings, a minute and a half at each, the unit finds the gyro error of its housing, keeps it over a restart
/// and aligns with it.
#[test]
fn a_unit_that_is_turned_keeps_its_deviation() {
    let path = Image::release();
    let image = Image::read(&path).unwrap_or_else(|e| panic!("{e}: `cargo fw` builds the image"));
    let mut scenario = Scenario::builtin("four-headings").unwrap();
    scenario.turn.truncate(2);
    for (turn, at_s) in scenario.turn.iter_mut().zip([100.0, 190.0]) {
        turn.at_s = at_s;
    }
    let typed = [
        (95.0, "deviation"),
        (282.0, "deviation"),
        (283.0, "save"),
        (284.0, "restart"),
        (290.0, "show"),
    ];
    let setup = Setup {
        typed: typed.map(typed_at).to_vec(),
        ..Setup::new(scenario, 5, 380.0)
    };
    let (outcome, kept) = run::run(&image, &setup, Kept::default()).unwrap();
    let [early, found, taken, saved, _, shown @ ..] = &kept.answers[..] else {
        panic!("{:?}", kept.answers)
    };
    assert_eq!(
        early,
        "error,nothing found: align then turn the base through four headings"
    );
    assert_eq!(
        (taken.as_str(), saved.as_str()),
        ("ok,set - align takes it up and save keeps it", "ok,saved")
    );
    // The truth is 0.3 and -0.4 °/h.
    let figures: Vec<f64> = found.split(' ').filter_map(|word| word.parse().ok()).collect();
    let [x, y, sd] = figures[..] else { panic!("{found}") };
    assert!(
        sd < 0.25 && (x - 0.3).abs() < 3.0 * sd && (y + 0.4).abs() < 3.0 * sd,
        "{found}"
    );
    assert!(shown.contains(found), "{shown:?}");
    // After the restart there is one heading only: 2.1° at the least without it.
    let last = outcome.last.as_ref().unwrap();
    let sd = last.sd.heading_deg;
    assert!(sd < 1.6 && last.error.heading_deg.abs() < 3.0 * sd, "{last:?}");
}
