//! Tables of checked numbers, and errors that name file, line and key.
//!
//! `table!` writes a struct, its defaults and its ranges from one list, so that the documentation,
//! the TOML reader and the range check cannot disagree.

use std::path::Path;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use toml::de::{DeTable, DeValue};

/// What is wrong with a configuration file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ConfigProblem {
    /// The file cannot be read; the system's words.
    Read(String),
    /// Not TOML; the parser's words.
    Syntax(String),
    /// A key nobody knows; the keys known in its place.
    UnknownKey(String),
    /// A value of the wrong type; what was found and expected.
    WrongType(String),
    /// A value out of its range, or at odds with another; which values are allowed.
    Value(String),
    /// No built-in scenario has this name; the names there are.
    UnknownScenario(String),
    /// Neither the name of a format nor a file that can be read.
    UnknownFormat {
        /// Why it cannot be read; the system's words.
        why: String,
        /// The names there are.
        names: String,
    },
    /// Neither the name of a part nor a file that can be read.
    UnknownPart {
        /// Why it cannot be read; the system's words.
        why: String,
        /// The names there are.
        names: String,
    },
}

impl core::fmt::Display for ConfigProblem {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Read(what) => write!(f, "cannot read: {what}"),
            Self::Syntax(what) => write!(f, "not valid TOML: {what}"),
            Self::UnknownKey(known) => write!(f, "unknown key; known here: {known}"),
            Self::WrongType(what) | Self::Value(what) => f.write_str(what),
            Self::UnknownFormat { why, names } => write!(f, "neither a format ({names}) nor a file: {why}"),
            Self::UnknownPart { why, names } => write!(f, "neither a part ({names}) nor a file: {why}"),
            Self::UnknownScenario(names) => write!(
                f,
                "no built-in scenario of this name; there are {names}, or a TOML file of your own"
            ),
        }
    }
}

/// One line about a configuration file: `file:line: key: what is wrong and what is allowed`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConfigError {
    /// The file's name as it was given.
    pub file: String,
    /// The line, from 1, where there is one.
    pub line: Option<usize>,
    /// The key with the tables it is in, `swing.pitch.period_s`, where there is one.
    pub key: Option<String>,
    /// What is wrong.
    pub problem: ConfigProblem,
}

impl core::fmt::Display for ConfigError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(&self.file)?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        if let Some(key) = &self.key {
            // A key in quotes may hold the end of a line.
            write!(f, ": {}", key.replace(char::is_control, "·"))?;
        }
        write!(f, ": {}", self.problem)
    }
}

impl core::error::Error for ConfigError {}

/// A value that may not be: its key and what is allowed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Violation {
    /// The key with the tables it is in.
    pub key: String,
    /// What is wrong and what is allowed.
    pub problem: String,
}

impl core::fmt::Display for Violation {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}: {}", self.key, self.problem)
    }
}

impl core::error::Error for Violation {}

/// A table whose numbers have ranges.
pub trait Table {
    /// The first number out of its range; `path` is the key of the table itself, empty at the top.
    ///
    /// # Errors
    /// The [`Violation`].
    fn check(&self, path: &str) -> Result<(), Violation>;
}

impl<T: Table> Table for Vec<T> {
    fn check(&self, path: &str) -> Result<(), Violation> {
        self.iter()
            .enumerate()
            .try_for_each(|(i, item)| item.check(&format!("{path}[{i}]")))
    }
}

/// `path.key`, or `key` at the top.
pub(crate) fn join(path: &str, key: &str) -> String {
    if path.is_empty() {
        key.to_owned()
    } else {
        format!("{path}.{key}")
    }
}

/// A value with a range.
pub(crate) trait Ranged {
    /// The number that is out of range, if any. Not a number is out of every range.
    fn outside(&self, low: f64, high: f64) -> Option<f64>;
}

impl Ranged for f64 {
    fn outside(&self, low: f64, high: f64) -> Option<f64> {
        (!(low..=high).contains(self)).then_some(*self)
    }
}

impl Ranged for u32 {
    fn outside(&self, low: f64, high: f64) -> Option<f64> {
        f64::from(*self).outside(low, high)
    }
}

impl<R: Ranged> Ranged for Option<R> {
    fn outside(&self, low: f64, high: f64) -> Option<f64> {
        self.as_ref().and_then(|value| value.outside(low, high))
    }
}

impl<R: Ranged, const N: usize> Ranged for [R; N] {
    fn outside(&self, low: f64, high: f64) -> Option<f64> {
        self.iter().find_map(|value| value.outside(low, high))
    }
}

/// An angle in degrees, or `"random"`: uniform over the full circle, from the seed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Angle {
    /// Degrees.
    Degrees(f64),
    /// Drawn from the seed, uniform in [0°, 360°).
    Random,
}

impl Ranged for Angle {
    fn outside(&self, low: f64, high: f64) -> Option<f64> {
        match self {
            Self::Degrees(value) => value.outside(low, high),
            Self::Random => None,
        }
    }
}

impl Serialize for Angle {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Degrees(value) => serializer.serialize_f64(*value),
            Self::Random => serializer.serialize_str("random"),
        }
    }
}

impl<'de> Deserialize<'de> for Angle {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl serde::de::Visitor<'_> for Visitor {
            type Value = Angle;
            fn expecting(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str("a number of degrees or \"random\"")
            }
            fn visit_f64<E: serde::de::Error>(self, value: f64) -> Result<Angle, E> {
                Ok(Angle::Degrees(value))
            }
            fn visit_i64<E: serde::de::Error>(self, value: i64) -> Result<Angle, E> {
                // Beyond 2^53 it is out of range anyway.
                Ok(Angle::Degrees(value as f64))
            }
            fn visit_u64<E: serde::de::Error>(self, value: u64) -> Result<Angle, E> {
                Ok(Angle::Degrees(value as f64))
            }
            fn visit_str<E: serde::de::Error>(self, value: &str) -> Result<Angle, E> {
                match value {
                    "random" => Ok(Angle::Random),
                    other => Err(E::invalid_value(serde::de::Unexpected::Str(other), &self)),
                }
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}

/// Writes a table: its struct, `Default`, TOML reading that refuses unknown keys, and range checks.
///
/// `pub struct NAME, keys left out by KEY: TYPE` adds a key that is not a field: it says what keys left out are, in place
/// of their defaults. `NAME` is `From<TYPE>`.
macro_rules! table {
    (
        $(#[$doc:meta])*
        pub struct $name:ident, keys left out by $base:ident : $base_type:ty {
            numbers {
                $( $(#[$number_doc:meta])* $number:ident : $number_type:ty = $default:expr, [$low:literal, $high:literal]; )*
            }
            tables {}
        }
    ) => {
        $crate::config::table! {
            @common
            $(#[$doc])*
            pub struct $name {
                numbers { $( $(#[$number_doc])* $number : $number_type = $default, [$low, $high]; )* }
                tables {}
            }
        }

        impl<'de> serde::Deserialize<'de> for $name {
            fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                #[derive(serde::Deserialize)]
                #[serde(default, deny_unknown_fields)]
                struct Keys {
                    $base: Option<$base_type>,
                    $( $number: Option<$number_type>, )*
                }
                impl Default for Keys {
                    fn default() -> Self {
                        Self { $base: None, $( $number: None, )* }
                    }
                }
                let keys = Keys::deserialize(deserializer)?;
                let mut table = keys.$base.map_or_else(Self::default, Self::from);
                $( if let Some(value) = keys.$number { table.$number = value; } )*
                Ok(table)
            }
        }
    };
    (
        $(#[$doc:meta])*
        pub struct $name:ident {
            numbers {
                $( $(#[$number_doc:meta])* $number:ident : $number_type:ty = $default:expr, [$low:literal, $high:literal]; )*
            }
            tables {
                $( $(#[$table_doc:meta])* $table:ident : $table_type:ty; )*
            }
        }
    ) => {
        $crate::config::table! {
            @common
            #[derive(serde::Deserialize)]
            #[serde(default, deny_unknown_fields)]
            $(#[$doc])*
            pub struct $name {
                numbers { $( $(#[$number_doc])* $number : $number_type = $default, [$low, $high]; )* }
                tables { $( $(#[$table_doc])* $table : $table_type; )* }
            }
        }
    };
    (
        @common
        $(#[$doc:meta])*
        pub struct $name:ident {
            numbers {
                $( $(#[$number_doc:meta])* $number:ident : $number_type:ty = $default:expr, [$low:literal, $high:literal]; )*
            }
            tables {
                $( $(#[$table_doc:meta])* $table:ident : $table_type:ty; )*
            }
        }
    ) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, serde::Serialize)]
        pub struct $name {
            $(
                $(#[$number_doc])*
                ///
                #[doc = concat!("Range ", stringify!($low), " to ", stringify!($high), "; `", stringify!($default), "` where absent.")]
                pub $number: $number_type,
            )*
            $( $(#[$table_doc])* pub $table: $table_type, )*
        }

        impl Default for $name {
            fn default() -> Self {
                Self {
                    $( $number: $default, )*
                    $( $table: Default::default(), )*
                }
            }
        }

        impl $crate::config::Table for $name {
            fn check(&self, path: &str) -> Result<(), $crate::config::Violation> {
                $(
                    if let Some(value) = $crate::config::Ranged::outside(&self.$number, $low, $high) {
                        return Err($crate::config::Violation {
                            key: $crate::config::join(path, stringify!($number)),
                            problem: format!(
                                "{value} is out of range, allowed are {} to {}",
                                stringify!($low).trim_end_matches(".0"),
                                stringify!($high).trim_end_matches(".0"),
                            ),
                        });
                    }
                )*
                $( self.$table.check(&$crate::config::join(path, stringify!($table)))?; )*
                Ok(())
            }
        }
    };
}
pub(crate) use table;

/// Reads a file into text.
pub(crate) fn read(path: &Path) -> Result<String, ConfigError> {
    std::fs::read_to_string(path).map_err(|error| ConfigError {
        file: path.display().to_string(),
        line: None,
        key: None,
        problem: ConfigProblem::Read(error.to_string()),
    })
}

/// Reads a table and checks it with `check`.
pub(crate) fn parse<T: DeserializeOwned>(
    text: &str,
    file: &str,
    check: impl Fn(&T) -> Result<(), Violation>,
) -> Result<T, ConfigError> {
    let error = |line, key, problem| ConfigError {
        file: file.to_owned(),
        line,
        key,
        problem,
    };
    let line_at = |offset: usize| Some(1 + text.bytes().take(offset).filter(|b| *b == b'\n').count());
    // First as plain TOML, so that an error of the grammar is told from one of the keys.
    let tree = DeTable::parse(text).map_err(|e| {
        let line = e.span().and_then(|span| line_at(span.start));
        error(line, None, ConfigProblem::Syntax(one_line(e.message())))
    })?;
    let value = toml::from_str::<T>(text).map_err(|e| {
        let offset = e.span().map(|span| span.start);
        let key = offset.and_then(|offset| key_at(tree.get_ref(), "", offset));
        error(offset.and_then(line_at), key, problem_of(e.message()))
    })?;
    check(&value).map_err(|violation| {
        let line = offset_of(tree.get_ref(), &violation.key).and_then(line_at);
        error(line, Some(violation.key), ConfigProblem::Value(violation.problem))
    })?;
    Ok(value)
}

fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Serde's words in ours.
fn problem_of(message: &str) -> ConfigProblem {
    if message.starts_with("unknown field") {
        let known = message.split_once(", expected ").map_or("none", |(_, known)| known);
        return ConfigProblem::UnknownKey(known.trim_start_matches("one of ").replace(" or ", ", "));
    }
    let message = one_line(message)
        .replace("invalid type: ", "found ")
        .replace("invalid value: ", "found ")
        .replace("expected f64", "expected a number")
        .replace("expected u32", "expected a whole number")
        .replace("floating point ", "");
    ConfigProblem::WrongType(match message.split_once("expected struct ") {
        Some((found, _)) => format!("{found}expected a table"),
        None => message,
    })
}

/// The key whose name or value the offset is in.
fn key_at(table: &DeTable<'_>, path: &str, offset: usize) -> Option<String> {
    table.iter().find_map(|(key, value)| {
        let path = join(path, key.get_ref());
        // Inner keys first: the span of an inline table holds theirs.
        let inner = match value.get_ref() {
            DeValue::Table(table) => key_at(table, &path, offset),
            DeValue::Array(array) => array.iter().enumerate().find_map(|(i, item)| match item.get_ref() {
                DeValue::Table(table) => key_at(table, &format!("{path}[{i}]"), offset),
                _ => None,
            }),
            _ => None,
        };
        let holds = |span: core::ops::Range<usize>| span.contains(&offset);
        inner.or_else(|| (holds(key.span()) || holds(value.span())).then_some(path))
    })
}

/// Where the key is written, or the innermost table of it that is.
fn offset_of(table: &DeTable<'_>, path: &str) -> Option<usize> {
    let (head, rest) = path.split_once('.').unwrap_or((path, ""));
    let (name, index) = match head.split_once('[') {
        Some((name, index)) => (name, index.trim_end_matches(']').parse::<usize>().ok()),
        None => (head, None),
    };
    let (key, value) = table.iter().find(|(key, _)| key.get_ref() == name)?;
    let inner = match (value.get_ref(), index) {
        (DeValue::Table(table), None) => offset_of(table, rest),
        (DeValue::Array(array), Some(index)) => array.get(index).and_then(|item| match item.get_ref() {
            DeValue::Table(table) => offset_of(table, rest).or(Some(item.span().start)),
            _ => None,
        }),
        _ => None,
    };
    inner.or(Some(key.span().start))
}
