//! The unit's image for the STM32F429. Starts clocks, executors and tasks, nothing else.
//!
//! | file | what |
//! |---|---|
//! | `board.rs` | pins, clocks, peripherals; the one file a second board changes |
//! | `params.rs` | the unit's figures |
//! | `tasks.rs` | the application's bodies as tasks |
//! | `fault.rs` | panic and hard fault: motor off, say why, reset |
#![no_std]
#![no_main]

mod board;
mod fault;
mod params;
mod tasks;

use board::Board;
use defmt_rtt as _;
use embassy_executor::Spawner;

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    let board = Board::start();
    defmt::info!("started by {}", board.reset_cause);
    tasks::start(spawner, board).await;
}
