//! Endings of file names, in any case: cameras and meters write `LOG.CSV`.

use std::path::Path;

/// True if a file's name ends in this ending, such as `csv` or `csv.gz`, in any case.
#[must_use]
pub fn ends_in(path: &Path, ending: &str) -> bool {
    let name = path.file_name().map(std::ffi::OsStr::as_encoded_bytes).unwrap_or_default();
    let start = name.len().checked_sub(ending.len() + 1).filter(|start| *start > 0);
    start.is_some_and(|start| {
        name[start] == b'.' && name[start + 1..].eq_ignore_ascii_case(ending.as_bytes())
    })
}

/// A file's name without this ending, if it has it in any case.
#[must_use]
pub fn without_ending<'a>(name: &'a str, ending: &str) -> Option<&'a str> {
    let start = name.len().checked_sub(ending.len() + 1)?;
    let (bare, found) = name.split_at_checked(start)?;
    found.strip_prefix('.')?.eq_ignore_ascii_case(ending).then_some(bare)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ending_is_found_in_any_case() {
        for (name, ending, expected) in [
            ("a.csv", "csv", true),
            ("runs.d/A.CSV", "csv", true),
            ("a.Csv.GZ", "csv.gz", true),
            ("a.csv.gz", "csv", false),
            ("acsv", "csv", false),
            (".csv", "csv", false),
            ("csv", "csv", false),
            ("a.csv/b", "csv", false),
            ("", "csv", false),
        ] {
            assert_eq!(ends_in(Path::new(name), ending), expected, "{name}");
        }
        assert_eq!(without_ending("A.CSV.gz", "csv.gz"), Some("A"));
        assert_eq!(without_ending("ä€.NPY", "npy"), Some("ä€"));
        for (name, ending) in [("a.npy", "csv"), ("€", "csv"), ("x€sv", "csv"), ("npy", "npy")]
        {
            assert_eq!(without_ending(name, ending), None, "{name}");
        }
    }
}
