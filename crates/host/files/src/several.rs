//! Results that consist of several files.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// The files and folders of a result that is not whole yet. They are removed with it, so that the
/// same call can be made again, unless [`keep`](Self::keep) declares the result whole.
#[derive(Debug, Default)]
pub struct Several {
    /// In the order in which they were made.
    made: Vec<PathBuf>,
}

impl Several {
    /// Makes a folder and those above it, as far as they are missing.
    ///
    /// # Errors
    /// The system's error.
    pub fn folder(&mut self, path: &Path) -> io::Result<()> {
        let missing = path.ancestors().take_while(|at| !at.as_os_str().is_empty() && !at.exists());
        let missing: Vec<PathBuf> = missing.map(Path::to_owned).collect();
        fs::create_dir_all(path)?;
        self.made.extend(missing.into_iter().rev());
        Ok(())
    }

    /// Notes a file that was written, and that was not there before.
    pub fn file(&mut self, path: &Path) {
        self.made.push(path.to_owned());
    }

    /// The result is whole: its files stay.
    pub fn keep(mut self) {
        self.made.clear();
    }
}

impl Drop for Several {
    fn drop(&mut self) {
        for path in self.made.drain(..).rev() {
            // A folder stays if it has another's files. Whatever stays, the next call names.
            let _ = if path.is_dir() { fs::remove_dir(&path) } else { fs::remove_file(&path) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_made_is_removed_unless_it_is_kept_and_nothing_else_is() {
        let scratch = tempfile::tempdir().unwrap();
        let there = scratch.path().join("there");
        fs::create_dir(&there).unwrap();
        let (folder, deep) = (there.join("a"), there.join("a/b"));
        for is_kept in [false, true] {
            let mut several = Several::default();
            several.folder(&deep).unwrap();
            for name in ["one", "b/two"] {
                fs::write(folder.join(name), name).unwrap();
                several.file(&folder.join(name));
            }
            if is_kept {
                several.keep();
            } else {
                drop(several);
            }
            assert_eq!(deep.join("two").exists(), is_kept);
            assert_eq!(folder.exists(), is_kept);
            assert!(there.exists());
        }
        // A folder that was there before, with another's file.
        let mut several = Several::default();
        several.folder(&deep).unwrap();
        several.folder(&there.join("c")).unwrap();
        fs::write(there.join("c/other"), "").unwrap();
        drop(several);
        assert!(deep.exists() && there.join("c/other").exists());
    }
}
