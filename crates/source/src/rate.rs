//! Rates, speeds and times on the command line of a source.

use std::str::FromStr;
use std::time::Duration;

/// A rate on the command line, Hz: 0.1 to 1000.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hertz(f64);

impl Hertz {
    /// Time between two frames, ns.
    pub fn period_ns(self) -> u64 {
        // The range is checked at construction.
        (1e9 / self.0).round() as u64
    }
}

impl FromStr for Hertz {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        number(text, 0.1, 1000.0, "Hz").map(Self)
    }
}

/// A number within a closed range.
///
/// # Errors
/// The text is no number, or outside the range. The message has both ends.
pub fn number(text: &str, least: f64, greatest: f64, unit: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is not a number ({unit})"))?;
    if least <= value && value <= greatest {
        Ok(value)
    } else {
        Err(format!("{value} {unit}: allowed are {least} to {greatest} {unit}"))
    }
}

/// A time on the command line, s.
///
/// # Errors
/// As [`number`].
pub fn seconds(text: &str) -> Result<Duration, String> {
    number(text, 0.001, 1e8, "s").map(Duration::from_secs_f64)
}

/// Playback speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Rate {
    /// This many times as fast as recorded.
    Times(f64),
    /// The rate at which the worker answers.
    Max,
}

impl Rate {
    /// True if the source could be too fast for a worker.
    pub const fn is_faster_than_recorded(self) -> bool {
        match self {
            Self::Times(factor) => factor > 1.0,
            Self::Max => true,
        }
    }
}

impl FromStr for Rate {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "max" {
            return Ok(Self::Max);
        }
        number(text, 1e-3, 1e4, "times the recorded speed").map(Self::Times)
    }
}

/// Number of passes through each trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Passes {
    /// A number of frames.
    Count(u64),
    /// Without end.
    ForEver,
}

impl FromStr for Passes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse() {
            _ if text == "for-ever" => Ok(Self::ForEver),
            Ok(count) if count > 0 => Ok(Self::Count(count)),
            _ => Err(format!("{text:?}: give a whole number from 1, or leave it out")),
        }
    }
}
