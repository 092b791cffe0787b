//! The capture written by a demo.

use std::path::{Path, PathBuf};

use joulebus_bus::clock;
use joulebus_program::exit::UsageError;
use serde::{Deserialize, Serialize};

/// Path of the capture.
///
/// # Errors
/// The requested file exists, or cannot be written.
pub(super) fn file(asked: Option<&Path>) -> Result<PathBuf, UsageError> {
    let path = asked.map_or_else(usual, ToOwned::to_owned);
    // Tried here, where the error can be reported, instead of in a process that would be restarted
    // repeatedly.
    let tried = std::fs::File::create_new(&path).and_then(|_| std::fs::remove_file(&path));
    match tried {
        Ok(()) => Ok(path),
        Err(error) => Err(UsageError(format!(
            "cannot write the capture {}: {error}; name another with --capture, or leave it out \
             with --no-capture",
            path.display()
        ))),
    }
}

/// Named after the time, so that no file is overwritten.
fn usual() -> PathBuf {
    let seconds = clock::unix_ns() / 1_000_000_000;
    let (year, month, day) = date(seconds / 86_400);
    let (hour, minute, second) = (seconds / 3_600 % 24, seconds / 60 % 60, seconds % 60);
    PathBuf::from(format!(
        "joulebus-demo-{year}{month:02}{day:02}T{hour:02}{minute:02}{second:02}Z.mcap"
    ))
}

/// Gregorian date of a number of days after 1 January 1970.
fn date(mut days: u64) -> (u64, u64, u64) {
    let mut year = 1970;
    let is_leap = |year: u64| {
        year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400))
    };
    while days >= 365 + u64::from(is_leap(year)) {
        days -= 365 + u64::from(is_leap(year));
        year += 1;
    }
    let february = 28 + u64::from(is_leap(year));
    let lengths = [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let mut month = 1;
    for length in lengths {
        if days < length {
            break;
        }
        days -= length;
        month += 1;
    }
    (year, month, days + 1)
}

/// The recorder's report on the capture.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Captured {
    /// The path of the first file; there is only one unless the recorder died.
    #[serde(default)]
    pub(super) path: PathBuf,
    /// Number of messages.
    pub(super) messages: u64,
    /// Size, bytes.
    pub(super) bytes: u64,
    /// How long it recorded, s.
    pub(super) duration_s: f64,
    /// CPU time of the recorder over that time: 1 is one core.
    pub(super) cpu_share: f64,
    /// Messages that it lost.
    pub(super) messages_lost: u64,
    /// Why it stopped before its end, if it did.
    pub(super) failure: Option<String>,
}

impl Captured {
    /// Parses the recorder's report.
    pub(super) fn read(report: &str, path: &Path) -> Option<Self> {
        let read: Self = serde_json::from_str(report).ok()?;
        Some(Self {
            path: path.to_owned(),
            ..read
        })
    }
}

#[cfg(test)]
mod tests {
    use super::date;

    #[test]
    fn days_become_dates() {
        for (days, expected) in [
            (0, (1970, 1, 1)),
            (58, (1970, 2, 28)),
            (59, (1970, 3, 1)),
            (11_016, (2000, 2, 29)),
            (11_017, (2000, 3, 1)),
            (20_454, (2026, 1, 1)),
            (20_778, (2026, 11, 21)),
        ] {
            assert_eq!(date(days), expected);
        }
    }
}
