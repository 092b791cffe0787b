//! The partition of a trial: `fleet=…/day=…/robot=…`, as Hive names it.

use std::fmt::Write as _;
use std::path::PathBuf;

/// The partition value that engines read as null.
const NOTHING: &str = "__HIVE_DEFAULT_PARTITION__";

const DAY_NS: u64 = 86_400_000_000_000;

/// The folder of a trial. `unix_ns`: when its first reading was recorded, if that is known.
pub(crate) fn folder(fleet: Option<&str>, unix_ns: Option<u64>, robot: Option<&str>) -> PathBuf {
    let escaped = |value: Option<&str>| {
        let value = value.filter(|value| !value.is_empty());
        value.map_or_else(|| NOTHING.to_owned(), escape)
    };
    let day = unix_ns.map_or_else(|| NOTHING.to_owned(), |unix_ns| date(unix_ns / DAY_NS));
    let fleet = format!("fleet={}", escaped(fleet));
    let robot = format!("robot={}", escaped(robot));
    PathBuf::from(fleet).join(format!("day={day}")).join(robot)
}

/// The value with every byte as `%2F` that a name of a folder cannot have, or that engines read
/// otherwise.
fn escape(value: &str) -> String {
    let mut escaped = String::with_capacity(value.len());
    for byte in value.bytes() {
        if byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.') {
            escaped.push(char::from(byte));
        } else {
            // Writing to a String cannot fail.
            let _ = write!(escaped, "%{byte:02X}");
        }
    }
    escaped
}

/// Gregorian date of a number of days after 1 January 1970, as 2026-11-22.
fn date(days: u64) -> String {
    // Years from March on, in eras of 400: https://howardhinnant.github.io/date_algorithms.html
    let days = days + 719_468;
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era =
        (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_those_of_the_calendar() {
        for (days, wanted) in [
            (0, "1970-01-01"),
            (59, "1970-03-01"),
            (10_956, "1999-12-31"),
            (11_016, "2000-02-29"),
            (11_017, "2000-03-01"),
            (20_779, "2026-11-22"),
            (47_540, "2100-02-28"),
            (47_541, "2100-03-01"),
        ] {
            assert_eq!(date(days), wanted, "{days}");
        }
    }

    #[test]
    fn no_name_leaves_its_partition() {
        let folder = folder(Some("a/../b"), Some(0), Some("../ü=1 %"));
        let wanted = "fleet=a%2F..%2Fb/day=1970-01-01/robot=..%2F%C3%BC%3D1%20%25";
        assert_eq!(folder, PathBuf::from(wanted));
        let nothing = super::folder(None, None, Some(""));
        assert_eq!(nothing.components().count(), 3);
        assert!(nothing.to_string_lossy().matches(NOTHING).count() == 3);
    }
}
