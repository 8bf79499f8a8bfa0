//! Sentences of NMEA 0183 as they are on a line: whether one is whole, and what is in it. What the unit says in them is
//! [`app::nmea`]'s.

/// Why a line is no sentence.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wrong {
    /// It is not `$`, text, `*` and two hexadecimal digits.
    Frame,
    /// The digits are not the check sum of the text.
    CheckSum,
}

/// What is between `$` and `*` of a line without its CR LF.
///
/// # Errors
/// [`Wrong`].
pub fn body(line: &str) -> Result<&str, Wrong> {
    let (body, sum) = line
        .strip_prefix('$')
        .and_then(|rest| rest.rsplit_once('*'))
        .filter(|(_, sum)| sum.len() == 2)
        .ok_or(Wrong::Frame)?;
    let expected = body.bytes().fold(0, |sum, byte| sum ^ byte);
    // As the unit writes it: a digit in the other case has a wrong bit.
    if sum == format!("{expected:02X}") {
        Ok(body)
    } else {
        Err(Wrong::CheckSum)
    }
}

/// The same of bytes that end with CR LF, and are ASCII as all of a sentence is; `None` where they are not.
pub(crate) fn whole(bytes: &[u8]) -> Option<&str> {
    let line = core::str::from_utf8(bytes).ok().filter(|line| line.is_ascii())?;
    body(line.strip_suffix("\r\n")?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sentence_is_told_by_its_check_sum() {
        assert_eq!(body("$HETHS,,V*14"), Ok("HETHS,,V"));
        assert_eq!(body("$HEHDT,274.07,T*1A"), Err(Wrong::CheckSum));
        for frame in [
            "",
            "$",
            "HETHS,,V*14",
            "$HETHS,,V",
            "$HETHS,,V*1",
            "$HETHS,,V*014",
            "$é*",
        ] {
            assert_eq!(body(frame), Err(Wrong::Frame), "{frame}");
        }
        assert_eq!(body("$J*4A"), Ok("J"));
        assert_eq!(body("$J*4a"), Err(Wrong::CheckSum));
        assert_eq!(whole(b"$J*4A\r\n"), Some("J"));
        for other in [&b"$J*4A"[..], b"$J*4A\n", b"$J*4A\r\n\r\n", b"$\xFF*FF\r\n", b""] {
            assert_eq!(whole(other), None, "{}", other.escape_ascii());
        }
    }
}
