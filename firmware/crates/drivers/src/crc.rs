//! The two check sums of the unit's devices.
//!
//! | | width | polynomial | initial | reflected | final xor | check value of "123456789" |
//! |---|---|---|---|---|---|---|
//! | [`crc32`] | 32 | 0x04C11DB7 | all ones | yes | all ones | 0xCBF43926 |
//! | [`crc8`] | 8 | 0x07 | 0 | no | 0 | 0xF4 |
//!
//! Both take one nibble at a time: 64 and 16 bytes of table instead of 1 kB and 256 bytes, two
//! look-ups a byte instead of eight shifts.

const CRC32_NIBBLE: [u32; 16] = {
    let mut table = [0; 16];
    let mut i = 0;
    while i < 16 {
        let mut r = i as u32;
        let mut bit = 0;
        while bit < 4 {
            // 0xEDB88320 is 0x04C11DB7 with its bits in reverse order.
            r = if r & 1 == 1 { (r >> 1) ^ 0xEDB8_8320 } else { r >> 1 };
            bit += 1;
        }
        table[i] = r;
        i += 1;
    }
    table
};

const CRC8_NIBBLE: [u8; 16] = {
    let mut table = [0; 16];
    let mut i = 0;
    while i < 16 {
        let mut r = (i as u8) << 4;
        let mut bit = 0;
        while bit < 4 {
            r = if r & 0x80 != 0 { (r << 1) ^ 0x07 } else { r << 1 };
            bit += 1;
        }
        table[i] = r;
        i += 1;
    }
    table
};

/// CRC-32/ISO-HDLC, the one of Ethernet and zip.
pub fn crc32<I: IntoIterator<Item = u8>>(bytes: I) -> u32 {
    let mut r = u32::MAX;
    for byte in bytes {
        r ^= u32::from(byte);
        r = (r >> 4) ^ CRC32_NIBBLE[(r & 0xF) as usize];
        r = (r >> 4) ^ CRC32_NIBBLE[(r & 0xF) as usize];
    }
    !r
}

/// CRC-8 with polynomial x⁸ + x² + x + 1, nothing reflected (CRC-8/SMBUS).
pub fn crc8<I: IntoIterator<Item = u8>>(bytes: I) -> u8 {
    let mut r = 0_u8;
    for byte in bytes {
        r ^= byte;
        r = (r << 4) ^ CRC8_NIBBLE[usize::from(r >> 4)];
        r = (r << 4) ^ CRC8_NIBBLE[usize::from(r >> 4)];
    }
    r
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn catalogue_check_values() {
        assert_eq!(crc32(*b"123456789"), 0xCBF4_3926);
        assert_eq!(crc8(*b"123456789"), 0xF4);
    }

    /// The CRC-8 of stuck-high data is not stuck-high, that of stuck-low data is stuck-low.
    #[test]
    fn stuck_lines() {
        assert_ne!(crc8([0xFF; 3]), 0xFF);
        assert_eq!(crc8([0; 3]), 0);
    }
}
