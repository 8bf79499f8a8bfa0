//! An SPI transaction as a device sees it: one stream of bytes under one chip select, whatever operations it is made of.

use embedded_hal_async::spi::Operation;

/// Puts the bytes of the operations, one after the other, into `mosi`; the sum of their delays, ns.
pub(crate) fn gather(operations: &[Operation<'_, u8>], mosi: &mut Vec<u8>) -> u64 {
    mosi.clear();
    let mut delay_ns = 0;
    for operation in operations {
        match operation {
            Operation::Read(buffer) => mosi.resize(mosi.len() + buffer.len(), 0),
            Operation::Write(buffer) => mosi.extend_from_slice(buffer),
            Operation::Transfer(read, write) => {
                let end = mosi.len() + read.len().max(write.len());
                mosi.extend_from_slice(write);
                mosi.resize(end, 0);
            }
            Operation::TransferInPlace(buffer) => mosi.extend_from_slice(buffer),
            Operation::DelayNs(ns) => delay_ns += u64::from(*ns),
        }
    }
    delay_ns
}

/// Gives each operation its bytes of the answer, which is as long as what was gathered.
pub(crate) fn scatter(miso: &[u8], operations: &mut [Operation<'_, u8>]) {
    let mut rest = miso;
    for operation in operations {
        let (length, buffer): (usize, &mut [u8]) = match operation {
            Operation::Read(buffer) | Operation::TransferInPlace(buffer) => (buffer.len(), buffer),
            Operation::Transfer(read, write) => (read.len().max(write.len()), read),
            Operation::Write(buffer) => (buffer.len(), &mut []),
            Operation::DelayNs(_) => (0, &mut []),
        };
        let (head, tail) = rest.split_at(length);
        for (to, from) in buffer.iter_mut().zip(head) {
            *to = *from;
        }
        rest = tail;
    }
}
