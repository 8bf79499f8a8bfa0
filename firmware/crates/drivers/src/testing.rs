//! Helpers of the drivers' tests.

use std::vec;
use std::vec::Vec;

use embedded_hal_async::spi::{ErrorKind, ErrorType, Operation, SpiDevice};
use embedded_hal_mock::eh1::spi::Transaction;

pub(crate) use embassy_futures::block_on;
pub(crate) use embedded_hal_mock::eh1::delay::CheckedDelay;
pub(crate) use embedded_hal_mock::eh1::delay::NoopDelay;
pub(crate) use embedded_hal_mock::eh1::delay::Transaction as Wait;
pub(crate) use embedded_hal_mock::eh1::spi::Mock;

/// One full-duplex transfer under chip select, followed by a wait where `stall_ns` is not zero.
pub(crate) fn exchange(sent: &[u8], received: &[u8], stall_ns: u32) -> Vec<Transaction<u8>> {
    let mut list = vec![
        Transaction::transaction_start(),
        Transaction::transfer_in_place(sent.to_vec(), received.to_vec()),
    ];
    if stall_ns > 0 {
        list.push(Transaction::delay(stall_ns));
    }
    list.push(Transaction::transaction_end());
    list
}

/// A bus that fails every transaction.
pub(crate) struct BrokenBus;

#[derive(Debug)]
pub(crate) struct BusError;

impl embedded_hal_async::spi::Error for BusError {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Overrun
    }
}

impl ErrorType for BrokenBus {
    type Error = BusError;
}

impl SpiDevice for BrokenBus {
    async fn transaction(&mut self, _: &mut [Operation<'_, u8>]) -> Result<(), BusError> {
        Err(BusError)
    }
}
