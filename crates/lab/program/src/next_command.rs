//! Recordings in commands that a report proposes next.

use std::path::PathBuf;

use joulebus_program::shell::word;

/// Maximum number of recordings in a proposed command.
const NAMED: usize = 3;

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
    fn hundreds_of_recordings_are_not_repeated() {
        let paths = ["a", "b", "c", "d"].map(PathBuf::from);
        assert_eq!(recordings(&paths[..3]), "a b c");
        assert_eq!(recordings(&paths), "RECORDINGS");
    }
}
