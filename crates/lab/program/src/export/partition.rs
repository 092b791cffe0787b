//! The partition of a trial: `fleet=…/day=…/robot=…`, as Hive names it.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use joulebus_program::utc::Utc;

/// The partition value that engines read as null.
const NOTHING: &str = "__HIVE_DEFAULT_PARTITION__";

/// Names that a partition may have, outermost first.
const NAMES: [&str; 3] = ["fleet", "day", "robot"];

/// The levels that an archive's folders name: fleet, day, robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Levels([bool; 3]);

impl Levels {
    /// All of them.
    pub(crate) const ALL: Self = Self([true; 3]);

    /// The levels of a file in an archive.
    pub(crate) fn of_file(file: &Path) -> Self {
        let text = file.to_string_lossy();
        Self(NAMES.map(|name| text.split('/').any(|part| part.starts_with(&format!("{name}=")))))
    }

    /// Its names, for messages.
    pub(crate) fn names(self) -> String {
        let names = NAMES.into_iter().zip(self.0).filter(|(_, known)| *known);
        let names: Vec<&str> = names.map(|(name, _)| name).collect();
        match names.is_empty() {
            true => "neither fleet nor day nor robot".to_owned(),
            false => names.join(", "),
        }
    }
}

/// True if a file is in a partition of something unknown.
pub(crate) fn is_of_nothing(file: &Path) -> bool {
    file.to_string_lossy().contains(NOTHING)
}

/// The partition of a trial: its fleet, day and robot as folders name them, if they are known.
#[derive(Debug)]
pub(crate) struct Partition([Option<String>; 3]);

impl Partition {
    /// `unix_ns`: when the first reading was recorded.
    pub(crate) fn new(fleet: Option<&str>, unix_ns: Option<u64>, robot: Option<&str>) -> Self {
        let escaped = |value: Option<&str>| value.filter(|value| !value.is_empty()).map(escape);
        let day = unix_ns.map(|unix_ns| Utc::new(unix_ns).date());
        Self([escaped(fleet), day, escaped(robot)])
    }

    /// The levels that are known.
    pub(crate) fn levels(&self) -> Levels {
        Levels([0, 1, 2].map(|at| self.0[at].is_some()))
    }

    /// The folder in an archive of these levels.
    pub(crate) fn folder(&self, levels: Levels) -> PathBuf {
        let parts = NAMES.into_iter().zip(&self.0).zip(levels.0);
        let parts = parts.filter(|(_, is_there)| *is_there);
        let folder = |((name, value), _): ((&str, &Option<String>), bool)| {
            format!("{name}={}", value.as_deref().unwrap_or(NOTHING))
        };
        parts.map(folder).collect()
    }
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
    fn no_name_leaves_its_partition_and_what_is_unknown_has_no_folder() {
        let named = Partition::new(Some("a/../b"), Some(0), Some("../ü=1 %"));
        let wanted = "fleet=a%2F..%2Fb/day=1970-01-01/robot=..%2F%C3%BC%3D1%20%25";
        assert_eq!(named.folder(named.levels()), PathBuf::from(wanted));
        assert_eq!(Levels::of_file(Path::new(wanted)), Levels::ALL);
        let robot = Partition::new(None, None, Some("7"));
        assert_eq!(robot.folder(robot.levels()), PathBuf::from("robot=7"));
        assert_eq!(robot.levels().names(), "robot");
        let nothing = Partition::new(None, None, Some(""));
        assert_eq!(nothing.folder(nothing.levels()), PathBuf::new());
        assert_eq!(nothing.levels(), Levels::of_file(Path::new("000000-0000.parquet")));
        let folder = nothing.folder(Levels::ALL);
        assert!(is_of_nothing(&folder) && !is_of_nothing(Path::new(wanted)));
        assert_eq!(folder.components().count(), 3);
    }
}
