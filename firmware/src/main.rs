//! The unit's image for an STM32F4. Starts clocks, executors and tasks, nothing else.
//!
//! | file | what |
//! |---|---|
//! | `board.rs` | clocks and peripherals, what the boards have in common |
//! | `board/` | a file for each board: its pins and peripherals |
//! | `params.rs` | the unit's figures |
//! | `tasks.rs` | the application's bodies as tasks |
//! | `fault.rs` | panic and hard fault: motor off, say and note why, reset |
#![no_std]
#![no_main]

mod board;
mod fault;
mod params;
mod tasks;

use app::blackbox::BlackBox;
use board::{BlackBoxRam, Board};
use defmt_rtt as _;
use embassy_executor::Spawner;
use embassy_time::Instant;

/// Of the program: the release, and the commit where it was built from a repository.
const VERSION: &str = env!("ROTARY_NORTH_VERSION");

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    let board = Board::start();
    let blackbox = BlackBox::start(BlackBoxRam, board.reset_cause, Instant::now().as_micros());
    app::log::started(VERSION, blackbox.started(), board.clock);
    tasks::start(spawner, board, blackbox).await;
}
