//! Prints the completion script of a shell.

use std::process::ExitCode;

use clap::CommandFactory as _;

use super::Cli;
use super::output::{Done, print};

pub(super) const HELP: &str = "\
Prints a script for the shell.

Examples:
  hal-sim completions bash > ~/.local/share/bash-completion/completions/hal-sim
  hal-sim completions zsh > ~/.zfunc/_hal-sim
  hal-sim completions fish > ~/.config/fish/completions/hal-sim.fish
  hal-sim completions powershell >> $PROFILE";

pub(super) fn run(shell: clap_complete::Shell) -> Done {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "hal-sim", &mut script);
    print(&String::from_utf8_lossy(&script))?;
    Ok(ExitCode::SUCCESS)
}
