//! Recordings and directories in commands that a report proposes next.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use joulebus_dataset::inspect::find;
use joulebus_program::shell::word;

/// Maximum number of recordings in a proposed command, if they are a directory's.
const MAX_NAMED: usize = 3;

/// The recordings of a call. A shell may have made hundreds of one pattern: where they are all
/// those of a directory, that one is named.
/// One that is gone by now is named like the others: the result is there.
pub(crate) fn recordings(paths: &[PathBuf]) -> String {
    if paths.len() > MAX_NAMED
        && let Some(directory) = paths[0].parent()
    {
        let directory = match directory.as_os_str().is_empty() {
            true => Path::new("."),
            false => directory,
        };
        let files = |paths: &[PathBuf]| -> Option<BTreeSet<PathBuf>> {
            let files = find(paths).ok()?.files.into_iter();
            Some(files.map(|file| file.canonicalize().unwrap_or(file)).collect())
        };
        let found = files(paths);
        if found.is_some() && files(&[directory.to_owned()]) == found {
            return word(directory);
        }
    }
    let words: Vec<String> = paths.iter().map(|path| word(path)).collect();
    words.join(" ")
}

/// A directory for a config that does not exist yet, as a word of the shell.
pub(crate) fn free_lab() -> String {
    let numbered = (2..).map(|number| format!("lab-{number}"));
    let mut names = std::iter::once("lab".to_owned()).chain(numbered);
    let free = names.find(|name| !Path::new(name).exists());
    // The numbers are endless.
    free.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_recordings_of_a_directory_are_named_by_it_and_others_in_full() {
        let folder = tempfile::tempdir().expect("a temporary directory");
        let files = ["a", "b", "c", "d"].map(|name| folder.path().join(name).with_extension("csv"));
        for file in &files {
            std::fs::write(file, "time,power_W\n0,1\n").expect("writable");
        }
        assert_eq!(recordings(&files), word(folder.path()));
        let three: Vec<String> = files[..3].iter().map(|file| word(file)).collect();
        assert_eq!(recordings(&files[..3]), three.join(" "));
        std::fs::write(folder.path().join("e.csv"), "time,power_W\n0,1\n").expect("writable");
        assert_eq!(recordings(&files).split(' ').count(), 4);
        std::fs::remove_file(&files[0]).expect("removable");
        assert_eq!(recordings(&files).split(' ').count(), 4);
    }
}
