//! Results as tables for people.

use hal_sim::align::Angles;
use hal_sim::bound::Bound;
use hal_sim::monte_carlo::{self, MethodReport, READY_SD_DEG, Statistics};
use hal_sim::observability;
use hal_sim::replay::Replay;
use hal_sim::simulate::{Moment, RunResult};
use hal_sim::unit_sim::{Drift, UnitResult};

use super::colour::{self, Sense};

/// The closing table of a run.
pub(super) fn run(result: &RunResult) -> String {
    let mut text = match (result.aligned_at_s, &result.reason) {
        (Some(t), None) => format!("{} since {t:.1} s ({})\n", ending(result.state), result.method.name()),
        (_, reason) => {
            format!(
                "{} ({}): {}\n",
                ending(result.state),
                result.method.name(),
                reason.as_deref().unwrap_or("no estimate")
            )
        }
    };
    if let Some(coarse) = &result.coarse {
        text += &format!(
            "coarse alignment alone, over the whole run: heading error {:+.3}°, sd {:.3}°\n",
            coarse.error.heading_deg, coarse.sd.heading_deg
        );
    }
    let Some(last) = &result.last else { return text };
    let Moment {
        reading, truth, error, ..
    } = last;
    text += &attitude(truth, &reading.attitude, error, &reading.sd);
    let biases = [
        (
            "gyro",
            "°/h",
            last.true_gyro_bias_deg_h,
            reading.gyro_bias_deg_h,
            reading.gyro_bias_sd_deg_h,
        ),
        (
            "accel",
            "µg",
            last.true_accel_bias_ug,
            reading.accel_bias_ug,
            reading.accel_bias_sd_ug,
        ),
    ];
    for (sensor, unit, truth, found, sd) in biases {
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            text += &format!(
                "{:<16}{:>12.2}{:>12.2}{:>+12.2}{:>12.2}\n",
                format!("{sensor} {name} ({unit})"),
                truth[axis],
                found[axis],
                found[axis] - truth[axis],
                sd[axis]
            );
        }
    }
    text
}

/// The closing table of a Monte Carlo.
pub(super) fn monte_carlo(report: &monte_carlo::Report) -> String {
    let mut text = format!(
        "{}, {} runs of {} s, seed {}; angle random walk alone leaves {:.3}° of heading, the ideal filter {:.3}°\n{:<18}{:>6}{:>10}{:>10}{:>10}{:>12}{:>14}{:>11}\n",
        report.scenario,
        report.runs,
        report.duration_s,
        report.seed,
        report.random_walk_limit_deg,
        report.bound_deg,
        "",
        "runs",
        "mean (°)",
        "sd (°)",
        "rms (°)",
        "predicted",
        "(error/σ)²",
        "rms/ideal"
    );
    let mut rows = |name: &str, s: &Statistics, over_bound: Option<f64>| {
        for (angle, spread) in [("heading", &s.heading), ("pitch", &s.pitch), ("roll", &s.roll)] {
            let over_bound = over_bound
                .filter(|_| angle == "heading")
                .map(|ratio| format!("{ratio:>11.3}"));
            text += &format!(
                "{:<18}{:>6}{:>+10.4}{:>10.4}{:>10.4}{:>12.4}{:>14.2}{}\n",
                format!("{name} {angle}"),
                s.runs,
                spread.mean_deg,
                spread.sd_deg,
                spread.rms_deg,
                spread.predicted_sd_deg,
                spread.nees,
                over_bound.unwrap_or_default()
            );
        }
    };
    if let Some(coarse) = &report.coarse {
        rows("coarse", coarse, None);
    }
    for method in &report.by_method {
        if let Some(fine) = &method.fine {
            rows(
                &format!("fine {}", method.method.name()),
                fine,
                method.heading_rms_over_bound,
            );
        }
    }
    for method in &report.by_method {
        text += &format!(
            "{}: {} of {} aligned{}{}\n",
            method.method.name(),
            method.aligned,
            report.runs,
            method
                .mean_time_to_aligned_s
                .map(|t| format!(", after {t:.1} s in the mean"))
                .unwrap_or_default(),
            if method.inconsistent > 0 {
                format!(
                    "; {} refused: innovations do not fit a base that only swings",
                    method.inconsistent
                )
            } else {
                String::new()
            }
        );
        text += &course_of(method);
    }
    // Each run has phases of its own.
    text + "rms/ideal: over the ideal filter's σ along the motion of the first run; n runs scatter it by 1/√(2n)\n"
}

/// Readiness, settling, and the errors of those that were refused as well.
fn course_of(method: &MethodReport) -> String {
    let mut text = String::new();
    if let Some(all) = method.all.filter(|all| all.runs > method.aligned) {
        text += &format!(
            "    all {} with an estimate: heading rms {:.4}°\n",
            all.runs, all.heading.rms_deg
        );
    }
    if let Some(ready) = &method.readiness {
        text += &format!(
            "    known to {READY_SD_DEG}°: {} runs, after {:.0} s in the mean, {:.0} s at most; then beyond 3σ: {} runs at \
             first, {} of {} s ({:.2} %)\n",
            ready.runs,
            ready.mean_s,
            ready.last_s,
            ready.false_at_first,
            ready.false_seconds,
            ready.seconds,
            100.0 * ready.false_seconds as f64 / ready.seconds as f64
        );
    }
    if let Some(settling) = &method.settling {
        text += &format!(
            "    within ±{:.2}° to the end: {} runs, from {:.0} s on in the mean, {:.0} s for 95 of 100",
            settling.within_deg, settling.runs, settling.mean_s, settling.most_s
        );
        if settling.later_rms_deg > 0.0 {
            text += &format!(
                "; from 600 s on rms {:.3}°, worst {:.2}°",
                settling.later_rms_deg, settling.later_worst_deg
            );
        }
        text += "\n";
    }
    text
}

/// The table of a bound.
pub(super) fn bound(bound: &Bound) -> String {
    let mut text = format!(
        "{}, seed {}: σ of the ideal filter, {} states, zero velocity known to {} m/s each second\n{:>8}{:>12}{:>12}{:>10}{:>10}{:>27}{:>27}\n",
        bound.scenario,
        bound.seed,
        bound.states,
        bound.velocity_measurement_sd_m_s,
        "t (s)",
        "heading (°)",
        "by ARW (°)",
        "pitch (°)",
        "roll (°)",
        "gyros x, y, z (°/h)",
        "accels x, y, z (µg)"
    );
    for row in &bound.rows {
        text += &format!(
            "{:>8}{:>12.3}{:>12.3}{:>10.5}{:>10.5}",
            row.t_s, row.sd.heading_deg, row.random_walk_limit_deg, row.sd.pitch_deg, row.sd.roll_deg
        );
        for sd in row.gyro_bias_sd_deg_h {
            text += &format!("{sd:>9.3}");
        }
        for sd in row.accel_bias_sd_ug {
            text += &format!("{sd:>9.2}");
        }
        text += "\n";
    }
    let limits = &bound.limits;
    text += &format!("what a single cause leaves of heading after {} s:\n", bound.duration_s);
    for (name, limit) in [
        ("angle random walk", Some(limits.angle_random_walk_deg)),
        ("velocity random walk", limits.velocity_random_walk_deg),
        ("velocity measurement", Some(limits.velocity_measurement_deg)),
        ("quantum of the gyros", limits.gyro_quantum_deg),
        ("quantum of the accels", limits.accel_quantum_deg),
    ] {
        if let Some(limit) = limit {
            text += &format!("  {name:<24}{limit:>12.7}°\n");
        }
    }
    text
}

pub(super) fn replay(result: &Replay) -> String {
    let mut text = format!("{} at {} s", ending(result.state), result.t_s);
    match &result.reason {
        Some(reason) => text += &format!(": {reason}\n"),
        None => text += "\n",
    }
    let rows = [
        ("heading", result.heading_deg, result.heading_sd_deg),
        ("pitch", result.pitch_deg, result.pitch_sd_deg),
        ("roll", result.roll_deg, result.roll_sd_deg),
    ];
    for (name, value, sd) in rows {
        if let (Some(value), Some(sd)) = (value, sd) {
            text += &format!("{name:<10}{value:>10.3}°  sd {sd:.4}°\n");
        }
    }
    if let (Some([gx, gy, gz]), Some([ax, ay, az])) = (result.gyro_bias_deg_h, result.accel_bias_ug) {
        text += &format!("gyro bias  {gx:8.2} {gy:8.2} {gz:8.2} °/h\naccel bias {ax:8.1} {ay:8.1} {az:8.1} µg\n");
    }
    if let Some(delay) = result.imu_delay {
        text += &format!("{delay}\n");
    }
    if let Some(walk) = result.measured_walk_deg_sqrt_h {
        text += &format!(
            "the gyros' random walk is {walk:.3} °/√h in the log, clearly more than their figures say: σ is by it. The figures are of \
             another IMU, or the base vibrates\n"
        );
    }
    text
}

/// The closing table of a run of the unit.
pub(super) fn unit(result: &UnitResult) -> String {
    let when = |t: Option<f64>, then: &str, never: &str| t.map_or(never.to_owned(), |t| format!("{then} at {t:.1} s"));
    let mut text = format!(
        "{}, seed {}, {}: {} at {:.1} s; {}, {}\n",
        result.scenario,
        result.seed,
        result.method.name(),
        ending(result.state),
        result.t_s,
        when(result.aligning_at_s, "began to align", "never began to align"),
        when(result.aligned_at_s, "first aligned", "never aligned")
    );
    text += "modes:";
    for at in &result.modes {
        text += &format!(" {} {:.2} s,", at.mode, at.t_s);
    }
    text.truncate(text.trim_end_matches(',').len());
    let s = &result.samples;
    text += &format!(
        "\nsamples: {} received, {} lost ({} edges lost by the simulator), {} repeated, {} failed transfers, {} overruns, {} saturated\n",
        s.received, s.lost, s.edges_lost, s.repeated, s.transfers, s.overruns, s.saturated
    );
    if result.resets > 0 {
        text += &format!("resets: {}\n", result.resets);
    }
    for fault in &result.faults {
        text += &format!(
            "fault at {:.4} s: {}, motor off after {:.3} ms{}: {}\n",
            fault.t_s,
            fault.name,
            fault.motor_off_ms,
            if fault.latched { ", latched" } else { "" },
            fault.text
        );
    }
    let Some(last) = &result.last else { return text };
    text += &attitude(&last.truth, &last.reading.attitude, &last.error, &last.reading.sd);
    if let Some(Drift {
        speed_m_s,
        east_m,
        north_m,
    }) = last.track
    {
        text += &format!("navigated to {east_m:+.1} m east, {north_m:+.1} m north, at {speed_m_s:.2} m/s\n");
    }
    text
}

/// Rank, singular values, and what they mean for each error.
pub(super) fn observability(found: &observability::Report) -> String {
    let mut text = format!("rank {} of {}\nsingular values:", found.rank, found.states);
    for value in found.singular_values {
        text += &format!(" {value:.2e}");
    }
    text += &format!(
        "\nof the largest, the smallest that counts is {:.1e}, the next {:.1e}\nobservable:\n",
        found.smallest_counted, found.largest_neglected
    );
    for combination in &found.observable {
        text += &format!("  {combination}\n");
    }
    for (frame, states) in [
        ("each error, in east, north, up:", &found.by_state),
        ("biases along the body's axes, at the start:", &found.by_body_axis),
    ] {
        text += &format!("{frame}\n");
        for state in states {
            text += &format!("  {:<6}{}\n", state.name, state.seen);
        }
    }
    text
}

/// Truth, estimate, error and σ of the three angles.
fn attitude(truth: &Angles, estimate: &Angles, error: &Angles, sd: &Angles) -> String {
    let mut text = format!(
        "{:<16}{:>12}{:>12}{:>12}{:>12}\n",
        "", "truth", "estimate", "error", "sd"
    );
    for (name, of) in Angles::NAMED {
        text += &format!(
            "{name:<16}{:>12.4}{:>12.4}{:>+12.4}{:>12.4}\n",
            of(truth),
            of(estimate),
            of(error),
            of(sd)
        );
    }
    text
}

/// How it ended, as the first word of a table.
fn ending(state: &str) -> String {
    let sense = if is_aligned(state) { Sense::Good } else { Sense::Bad };
    colour::result(state, sense)
}

pub(super) fn is_aligned(state: &str) -> bool {
    matches!(state, "aligned" | "navigating")
}
