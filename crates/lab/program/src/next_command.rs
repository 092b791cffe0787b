//! Commands that a report proposes next, as a shell takes them.

use std::path::{Path, PathBuf};

/// Maximum number of recordings in a proposed command.
const NAMED: usize = 3;

/// A path as a word of a command.
pub(crate) fn word(path: &Path) -> String {
    quoted(&path.display().to_string())
}

/// A text as a word of a command.
pub(crate) fn quoted(text: &str) -> String {
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"/._-+,:=@%".contains(&byte);
    match !text.is_empty() && text.bytes().all(is_plain) {
        true => text.to_owned(),
        false => format!("'{}'", text.replace('\'', "'\\''")),
    }
}

/// The recordings of a call. A shell may have made hundreds of one pattern: they are not repeated.
pub(crate) fn recordings(paths: &[PathBuf]) -> String {
    if paths.len() > NAMED {
        return "RECORDINGS".to_owned();
    }
    let words: Vec<String> = paths.iter().map(|path| word(path)).collect();
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_quoted_where_a_shell_would_take_them_apart() {
        for (path, expected) in [
            ("trials/a-1.csv.gz", "trials/a-1.csv.gz"),
            ("my trials/*.csv", "'my trials/*.csv'"),
            ("it's", "'it'\\''s'"),
            ("", "''"),
        ] {
            assert_eq!(word(Path::new(path)), expected);
        }
    }

    #[test]
    fn hundreds_of_recordings_are_not_repeated() {
        let paths = ["a", "b", "c", "d"].map(PathBuf::from);
        assert_eq!(recordings(&paths[..3]), "a b c");
        assert_eq!(recordings(&paths), "RECORDINGS");
    }
}
