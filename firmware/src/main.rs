//! The unit's image for the STM32F429. Starts clocks, executors and tasks, nothing else.
//!
//! | file | what |
//! |---|---|
//! | `board.rs` | pins, clocks, peripherals; the one file a second board changes |
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
