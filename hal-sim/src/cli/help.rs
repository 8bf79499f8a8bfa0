//! What `--help` says after the options: what comes out, and examples that can be typed as they stand.

pub(super) const ALL: &str = "\
Examples:
  hal-sim                                     a run of five minutes, and a page about it in report/
  hal-sim monte-carlo --runs 200              how good it is, over 200 runs
  hal-sim replay LOG.csv --latitude-deg 40    your own recording
  hal-sim COMMAND --help                      what a command takes, what comes out of it, examples

Results go to stdout, progress, events and warnings to stderr. Both have colours on a terminal, unless NO_COLOR is set.

Exit codes:
  0  aligned; of commands that align nothing: done
  1  not aligned, or not any more; `link`: the unit refuses or does not answer; `soak`: a promise is broken
  2  a file, a scenario or an argument cannot be used; the line after `error:` says which and what can";

pub(super) const RUN: &str = "\
Prints what happens, then truth, estimate, error and σ of attitude and biases. Writes report/SCENARIO-seedN/: report.html to
look at, result.json, estimates.csv (once a second), plots as SVG. Exit code 0 where it ends aligned.

Examples:
  hal-sim run --scenario moored --seed 7
  hal-sim run --seconds 600 --log LOG.csv     writes what `replay` reads
  hal-sim run --method stf --json --quiet     the paper's filter; the result alone, for a program";

pub(super) const MONTE_CARLO: &str = "\
Prints mean, scatter, RMS and predicted σ of the errors at the end of the runs, and the RMS over the ideal filter's σ. Writes
report/SCENARIO-monte-carlo/: report.html, result.json, histograms as SVG. Exit code 0 where any run ends aligned.

Examples:
  hal-sim monte-carlo --runs 200 --seed 1
  hal-sim monte-carlo --scenario moored --runs 400 --method robust,kf,stf";

pub(super) const BOUND: &str = "\
Prints σ of attitude and biases against time, and what a single cause alone leaves of heading. Writes
report/SCENARIO-bound-seedN/: report.html, result.json, sigma.csv, the plot of heading as SVG. Takes a second.

Examples:
  hal-sim bound --scenario moored
  hal-sim bound --seconds 3600 --velocity-sd 0.001";

pub(super) const REPLAY: &str = "\
Prints what happens, then heading, pitch and roll (°) with σ, and the biases found. Writes no file but with --report: a page,
and estimates.csv (once a second). A log that cannot be true is refused, with the likely cause: unit, sign, encoder. Exit code 0
where the log's end finds it aligned.

Examples:
  hal-sim replay LOG.csv --latitude-deg 40
  hal-sim replay LOG.csv --latitude-deg 40 --unit UNIT.toml --json
  hal-sim replay LOG.csv --latitude-deg 40 --encoder-unit -deg --report report/LOG
  hal-sim replay LOG.bin                      a recording by `link --record`: it says itself where it stands";

pub(super) const UNIT: &str = "\
Prints the unit's log as it comes, then its modes, losses and faults, and the estimate beside the truth. Exit code 0 where it
ends aligned or navigating.

Examples:
  hal-sim unit --scenario paper-sim --seed 1
  hal-sim unit --scenario static --seconds 300 --type \"100 calibrate\"
  hal-sim unit --serve tcp:127.0.0.1:7000     then, elsewhere: hal-sim link tcp:127.0.0.1:7000";

pub(super) const SOAK: &str = "\
Prints what was broken and how often, what was found and what should have been. A day takes some minutes. Exit code 0 where
every promise holds.

Examples:
  hal-sim soak
  hal-sim soak --hours 2 --seed 7 --json";

pub(super) const LINK: &str = "\
Prints the unit's state, live, and its answers; on a terminal, type commands below (docs/serial.md).

Examples:
  hal-sim link /dev/ttyACM0
  hal-sim link /dev/ttyACM0 --send \"set latitude 40.1\" --send save
  hal-sim link tcp:127.0.0.1:7000 --record LOG.bin --seconds 600";

pub(super) const OBSERVABILITY: &str = "\
Prints the rank, the singular values, and which errors or sums of errors are seen. Writes no file.

Examples:
  hal-sim observability --axis z --pitch 5
  hal-sim observability --axis z,x --rate-dps 20 --seconds 18";

pub(super) const ALLAN: &str = "\
Prints random walk (°/√h, µg/√Hz) and bias instability (°/h, µg) of each axis with their uncertainty. Writes the plot, and
with --unit the figures for `replay` and `calibrate`.

Examples:
  hal-sim allan LOG.csv --unit UNIT.toml
  hal-sim allan LOG.csv --plot allan.svg --json";

pub(super) const CALIBRATE: &str = "\
Prints biases (°/h), scale factor (ppm) and misalignments (arcmin) of the gyros with σ. With --corrected it writes the log
again, without them.

Examples:
  hal-sim calibrate LOG.csv
  hal-sim calibrate LOG.csv --latitude-deg 40 --heading-deg 90 --corrected CORRECTED.csv";

pub(super) const CONVERT: &str = "\
Writes the CSV and says how many rows it has.

Examples:
  hal-sim convert LOG.bin LOG.csv
  hal-sim convert imu.csv LOG.csv --format ros-imu
  hal-sim convert - LOG.csv --format kitti-oxts --rate-hz 100";

pub(super) const TURN: &str = "\
Writes the CSV and says how many rows it has. A bias of the log cannot be told from Earth's rate: it is turned as well, and
goes into heading as it does at rest. What the rotor's rate does to a gyro is not in it.

Examples:
  hal-sim turn REST.csv -o TURNED.csv
  hal-sim turn REST.csv --rate 10 -o TURNED.csv   then: hal-sim replay TURNED.csv --latitude-deg 40";

pub(super) const REPRODUCE: &str = "\
Prints every published figure beside ours, and the verdict. Writes report/reproduce/: report.html, and of each its curves as
CSV and its plots as SVG. --all takes three minutes of processor time.

Examples:
  hal-sim reproduce
  hal-sim reproduce yu15
  hal-sim reproduce du17-observability xing18-allan";

pub(super) const INSPECT: &str = "\
Prints modes, estimates, faults and resets with their times. Exit code 0 where the log ends aligned or navigating.

Examples:
  hal-sim inspect LOG.txt --svg chart.svg --csv estimates.csv
  hal-sim inspect LOG.bin --elf firmware
  hal-sim inspect - --follow                  what another program prints, while it does";

pub(super) const SCENARIOS: &str = "\
Prints names and what they are; of one, its TOML.

Examples:
  hal-sim scenarios
  hal-sim scenarios paper-sim > mine.toml     change it, then: hal-sim run --scenario mine.toml";

pub(super) const COMPLETIONS: &str = "\
Prints a script for the shell.

Examples:
  hal-sim completions bash > ~/.local/share/bash-completion/completions/hal-sim
  hal-sim completions zsh > ~/.zfunc/_hal-sim
  hal-sim completions fish > ~/.config/fish/completions/hal-sim.fish
  hal-sim completions powershell >> $PROFILE";
