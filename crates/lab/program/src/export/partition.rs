//! The partition of a trial: `fleet=…/day=…/robot=…`, as Hive names it.

use std::fmt::Write as _;
use std::path::PathBuf;

use joulebus_program::utc::Utc;

/// The partition value that engines read as null.
const NOTHING: &str = "__HIVE_DEFAULT_PARTITION__";

/// The folder of a trial. `unix_ns`: when its first reading was recorded, if that is known.
pub(crate) fn folder(fleet: Option<&str>, unix_ns: Option<u64>, robot: Option<&str>) -> PathBuf {
    let escaped = |value: Option<&str>| {
        let value = value.filter(|value| !value.is_empty());
        value.map_or_else(|| NOTHING.to_owned(), escape)
    };
    let day = unix_ns.map_or_else(|| NOTHING.to_owned(), |unix_ns| Utc::of(unix_ns).date());
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

#[cfg(test)]
mod tests {
    use super::*;

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
