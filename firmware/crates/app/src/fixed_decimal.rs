//! Numbers in texts.

use frames::units::{DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR};

/// A number with so many digits behind the point, for people: defmt has no such format, and formatting an `f32` on the
/// target takes 14 kB of flash.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FixedDecimal {
    value: f32,
    decimals: u8,
    /// Digits before the point below which blanks come before it.
    width: u8,
    /// With its sign, also where it is positive.
    signed: bool,
}

/// A number with `decimals`, 4 at the most.
pub(crate) const fn fixed_decimal(value: f32, decimals: u8) -> FixedDecimal {
    FixedDecimal {
        value,
        decimals,
        width: 0,
        signed: false,
    }
}

/// Degrees of an angle in rad.
pub(crate) fn deg(angle: f32, decimals: u8) -> FixedDecimal {
    fixed_decimal(angle / DEG as f32, decimals)
}

/// °/h of a rate in rad/s.
pub(crate) fn deg_h(rate: f32) -> FixedDecimal {
    fixed_decimal(rate / DEG_PER_HOUR as f32, 1)
}

/// °/√h of a random walk in rad/√s.
pub(crate) fn deg_sqrt_h(walk: f32) -> FixedDecimal {
    fixed_decimal(walk / DEG_PER_SQRT_HOUR as f32, 3)
}

/// Whole seconds of a time in µs: 136 years' worth.
pub fn seconds(us: u64) -> u32 {
    u32::try_from(us / 1_000_000).unwrap_or(u32::MAX)
}

/// The digit of a number below 16, in upper case.
pub(crate) const fn hex_digit(nibble: u8) -> u8 {
    nibble + if nibble < 10 { b'0' } else { b'A' - 10 }
}

impl FixedDecimal {
    /// With its sign, always.
    pub(crate) const fn signed(self) -> Self {
        Self { signed: true, ..self }
    }

    /// For a column of so many digits before the point, 3 at the most.
    pub(crate) const fn column(self, width: u8) -> Self {
        Self { width, ..self }
    }

    /// What is before the digits, those before the point, and those behind it as a number. Saturates; what is no number is
    /// told as the greatest there is.
    #[inline(never)]
    fn parts(self) -> (&'static str, u32, u16) {
        let scale = match self.decimals {
            0 => 1,
            1 => 10,
            2 => 100,
            3 => 1000,
            _ => 10_000,
        };
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "not negative, and below 2^32"
        )]
        let steps = ((self.value.abs() * scale as f32).min(4.0e9) + 0.5) as u32;
        let before = match (self.value < 0.0 && steps > 0, self.signed) {
            (true, _) => "   -",
            (false, true) => "   +",
            (false, false) => "   ",
        };
        let (whole, fraction) = (steps / scale, steps % scale);
        let digits = match whole {
            0..=9 => 1,
            10..=99 => 2,
            _ => 3,
        };
        let blanks = usize::from(self.width.saturating_sub(digits));
        let before = before.get(3_usize.saturating_sub(blanks)..).unwrap_or_default();
        #[expect(clippy::cast_possible_truncation, reason = "below the scale")]
        (before, whole, fraction as u16)
    }
}

frames::wording!(FixedDecimal, |self, say| {
    let (before, whole, fraction) = self.parts();
    match self.decimals {
        0 => say!("{}{}", before, whole),
        1 => say!("{}{}.{}", before, whole, fraction),
        2 => say!("{}{}.{:02}", before, whole, fraction),
        3 => say!("{}{}.{:03}", before, whole, fraction),
        _ => say!("{}{}.{:04}", before, whole, fraction),
    }
});

#[cfg(test)]
mod tests {
    use std::string::ToString as _;

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn digits_signs_and_columns() {
        let table = [
            (fixed_decimal(0.0, 0), "0"),
            (fixed_decimal(-0.4, 0), "0"),
            (fixed_decimal(-0.5, 0), "-1"),
            (fixed_decimal(0.05, 1), "0.1"),
            (fixed_decimal(-0.05, 2), "-0.05"),
            (fixed_decimal(7.0, 3), "7.000"),
            (fixed_decimal(1.234_56, 4), "1.2346"),
            (fixed_decimal(99.999, 2), "100.00"),
            (fixed_decimal(12.3, 1).signed(), "+12.3"),
            (fixed_decimal(-12.3, 1).signed(), "-12.3"),
            (fixed_decimal(-0.001, 2).signed(), "+0.00"),
            (fixed_decimal(7.25, 2).column(3), "  7.25"),
            (fixed_decimal(359.996, 2).column(3), "360.00"),
            (fixed_decimal(-7.25, 2).signed().column(2), " -7.25"),
            (fixed_decimal(-107.25, 2).signed().column(2), "-107.25"),
            (fixed_decimal(123_456.0, 2), "123456.00"),
            (fixed_decimal(f32::NAN, 1), "400000000.0"),
            (fixed_decimal(f32::NEG_INFINITY, 0), "-4000000000"),
        ];
        for (figure, text) in table {
            assert_eq!(figure.to_string(), text, "{figure:?}");
        }
    }

    proptest! {
        #[test]
        fn it_is_the_number(value in -1e5_f32..1e5, decimals in 0_u8..=4) {
            let step = 0.1_f64.powi(decimals.into());
            let text = fixed_decimal(value, decimals).to_string();
            let found: f64 = text.parse().unwrap();
            // Half a step, and what the product with the scale is rounded by.
            let off = (found - f64::from(value)).abs();
            prop_assert!(off <= 0.5 * step + 1.2e-7 * f64::from(value).abs(), "{value}: {text}");
            let digits = text.split_once('.').map_or(0, |(_, digits)| digits.len());
            prop_assert_eq!(digits, usize::from(decimals));
            prop_assert_eq!(fixed_decimal(value, decimals).signed().to_string().replace('+', ""), text);
        }
    }
}
