//! An outcome in words and tables.

use core::fmt::Write as _;

use hal_sim::align::Angles;

use crate::board::CORE_HZ;
use crate::outcome::{Cost, Moment, Outcome, Verdict};

/// kB as a linker counts them.
const KB: f64 = 1024.0;

/// The result of a run: attitude against truth, what happened, what was missing, what it cost.
pub fn text(outcome: &Outcome) -> String {
    let mut text = String::new();
    // Writing to a String does not fail.
    let _ = writeln!(
        text,
        "{}, seed {}, {:.1} s: {} ({})",
        outcome.scenario,
        outcome.seed,
        outcome.t_s,
        outcome.state,
        verdict(outcome.verdict)
    );
    if let Some(last) = &outcome.last {
        text += &attitude(last);
    }
    let modes: Vec<String> = outcome
        .modes
        .iter()
        .map(|at| format!("{} {:.1} s", at.mode, at.t_s))
        .collect();
    let _ = writeln!(text, "modes: {}", modes.join(", "));
    for fault in &outcome.faults {
        let motor = if fault.motor_off { "motor off" } else { "motor on" };
        let _ = writeln!(text, "fault at {:.3} s: {}, {motor}", fault.t_s, fault.text);
    }
    for reset in &outcome.resets {
        let _ = writeln!(text, "reset at {:.3} s by {}", reset.t_s, reset.cause);
    }
    let [low, high] = outcome.travel_deg;
    let _ = writeln!(
        text,
        "rotor between {low:.1}° and {high:.1}°, cable {}",
        if outcome.wound_past { "WOUND PAST" } else { "sound" }
    );
    let serial = &outcome.serial;
    let _ = writeln!(
        text,
        "serial line: {} sentences, {} other lines, {} bytes",
        serial.sentences, serial.others, serial.bytes
    );
    if outcome.gaps.is_empty() {
        text += "gaps of the emulator: none\n";
    }
    for (name, list) in outcome.gaps.lists() {
        for gap in list {
            let _ = writeln!(text, "GAP, {name}: {gap}");
        }
    }
    text + &cost(&outcome.cost)
}

/// What a verdict says.
pub fn verdict(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Aligned => "aligned, heading within 3 sd",
        Verdict::NotAligned => "not aligned",
        Verdict::BeyondSigma => "heading beyond 3 sd",
        Verdict::WoundPast => "cable wound past its end",
        Verdict::Gaps => "the emulator has gaps here",
    }
}

fn attitude(moment: &Moment) -> String {
    let (reading, truth, error, sd) = (&moment.reading, &moment.truth, &moment.error, &moment.sd);
    let mut text = format!(
        "{:<16}{:>12}{:>12}{:>12}{:>12}{:>12}   at {:.3} s\n",
        "", "truth", "estimate", "error", "sd", "error/sd", moment.t_s
    );
    for (name, of) in Angles::NAMED {
        let _ = writeln!(
            text,
            "{name:<16}{:>12.3}{:>12.3}{:>+12.3}{:>12.3}{:>+12.2}",
            of(truth),
            of(reading),
            of(error),
            of(sd),
            of(error) / of(sd)
        );
    }
    text
}

/// Load, stack and memory as tables.
pub fn cost(cost: &Cost) -> String {
    let mut text = format!(
        "\n| mode | s | instructions/s | of {} M | busiest 0.1 s |\n|---|---|---|---|---|\n",
        CORE_HZ / 1_000_000
    );
    for row in &cost.load {
        let _ = writeln!(
            text,
            "| {} | {:.1} | {:.2} M | {:.1} % | {:.1} % |",
            row.mode,
            row.seconds,
            row.instructions as f64 / row.seconds.max(f64::MIN_POSITIVE) * 1e-6,
            100.0 * row.share,
            100.0 * row.peak
        );
    }
    let (stack, memory) = (&cost.stack, &cost.footprint);
    let _ = writeln!(
        text,
        "\nstack: {:.1} of {:.0} kB used, {:.0} % never",
        stack.used as f64 / KB,
        stack.size as f64 / KB,
        100.0 * stack.margin()
    );
    let _ = writeln!(
        text,
        "flash {:.1} kB, static RAM {:.1} kB:",
        memory.flash as f64 / KB,
        memory.static_ram as f64 / KB
    );
    for section in &memory.sections {
        let _ = writeln!(
            text,
            "  {:<16} {:#010x} {:>8}",
            section.name, section.address, section.size
        );
    }
    text
}
