//! One text for both formatters, `core::fmt` and `defmt`.

/// Makes a type's `Display`, for a host, and under the caller's feature `defmt` its `defmt::Format`, for the target, from
/// one body: so the two cannot differ.
///
/// The body gets the type's `self`, and a macro that writes a piece of the text. What it says is a format string as both
/// understand it: `{}`, `{:?}`, `{:02}`, `{:#06x}`, and arguments behind it. No precision: defmt prints an `f32` with all
/// its digits.
///
/// ```
/// struct Turn { degrees: i16, slow: bool }
///
/// frames::wording!(Turn, |self, say| {
///     say!("a turn of {} deg", self.degrees);
///     if self.slow {
///         say!(", slow");
///     }
/// });
/// assert_eq!(Turn { degrees: -90, slow: true }.to_string(), "a turn of -90 deg, slow");
/// ```
#[macro_export]
macro_rules! wording {
    ($type:ty, |$self:ident, $say:ident| $body:block) => {
        $crate::wording!(@ ($) $type, $self, $say, $body);
    };
    (@ ($d:tt) $type:ty, $self:ident, $say:ident, $body:block) => {
        impl ::core::fmt::Display for $type {
            fn fmt(&$self, f: &mut ::core::fmt::Formatter<'_>) -> ::core::fmt::Result {
                macro_rules! $say {
                    ($d($d piece:tt)*) => { ::core::write!(f, $d($d piece)*)? };
                }
                $body
                ::core::result::Result::Ok(())
            }
        }

        #[cfg(feature = "defmt")]
        impl ::defmt::Format for $type {
            fn format(&$self, f: ::defmt::Formatter<'_>) {
                macro_rules! $say {
                    ($d($d piece:tt)*) => { ::defmt::write!(f, $d($d piece)*) };
                }
                $body
            }
        }
    };
}
