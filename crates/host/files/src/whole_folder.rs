//! Folders that appear when all of their files are whole.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use crate::disk;
use crate::whole::{Draft, beside};

/// The files of a folder, which appear when the result is whole ([`keep`](Self::keep)). Until then
/// they have no names: of a program that is killed nothing stays. A folder that is new or empty
/// appears with all its files at once.
#[derive(Debug)]
pub struct WholeFolder {
    folder: PathBuf,
    /// The files by their paths below the folder.
    drafts: Vec<(PathBuf, Draft)>,
}

impl WholeFolder {
    /// Begins a result in `folder`, which is made at the end if it is missing.
    ///
    /// # Errors
    /// Something else than a folder is there, or nothing can be written there.
    pub fn begin(folder: &Path) -> io::Result<Self> {
        let whole = Self { folder: folder.to_owned(), drafts: Vec::new() };
        // Fails now and not after hours.
        whole.draft().map(|_| whole)
    }

    fn draft(&self) -> io::Result<Draft> {
        let there =
            self.folder.ancestors().find(|at| at.as_os_str().is_empty() || disk::exists(at));
        Draft::begin(&there.unwrap_or(Path::new("")).join("draft"))
    }

    /// Writes the file of this path below the folder.
    ///
    /// # Errors
    /// Those of the system and of `write`.
    pub fn write<T, E: From<io::Error>>(
        &mut self,
        name: impl AsRef<Path>,
        write: impl FnOnce(&File) -> Result<T, E>,
    ) -> Result<T, E> {
        let draft = self.draft()?;
        let written = write(draft.file())?;
        self.drafts.push((name.as_ref().to_owned(), draft));
        Ok(written)
    }

    /// The result is whole: its files get their names, and replace those of earlier runs.
    ///
    /// # Errors
    /// Those of [`replace`](crate::replace()).
    pub fn keep(self) -> io::Result<()> {
        let drafts = self.drafts;
        // An empty folder may be the working directory, a link, or a mount.
        let is_new = !disk::exists(&self.folder);
        if !is_new {
            for (name, draft) in drafts {
                let path = self.folder.join(name);
                fs::create_dir_all(path.parent().unwrap_or(&path))?;
                draft.replace(&path)?;
            }
            return Ok(());
        }
        let missing = self.folder.ancestors().take_while(|at| !disk::exists(at));
        let top = missing.filter(|at| !at.as_os_str().is_empty()).last();
        let top = top.unwrap_or(&self.folder).to_owned();
        let ((), hidden) = beside(&top, |hidden| fs::create_dir(hidden))?;
        let below = self.folder.strip_prefix(&top).unwrap_or(Path::new(""));
        let filled = drafts.into_iter().try_for_each(|(name, draft)| {
            let path = hidden.join(below).join(name);
            fs::create_dir_all(path.parent().unwrap_or(&path))?;
            draft.link(&path)
        });
        let named = filled.and_then(|()| {
            fs::create_dir_all(hidden.join(below))?;
            disk::rename(&hidden, &top)
        });
        named.inspect_err(|_| drop(fs::remove_dir_all(&hidden)))
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_folder_is_there_with_all_its_files_or_not_at_all() {
        let scratch = tempfile::tempdir().unwrap();
        let there = scratch.path().join("there");
        let write = |folder: &Path| {
            let mut whole = WholeFolder::begin(folder).unwrap();
            for name in ["one", "b/two"] {
                whole.write(name, |mut file| file.write_all(name.as_bytes())).unwrap();
            }
            let failed = whole.write("three", |_| Err::<(), _>(io::Error::other("half")));
            assert!(failed.is_err());
            whole
        };
        // As if it was killed: nothing has a name.
        let deep = there.join("a/b");
        drop(write(&deep));
        assert_eq!(names(scratch.path()), [""; 0]);
        write(&deep).keep().unwrap();
        assert_eq!(names(scratch.path()), ["there"]);
        assert_eq!(names(&deep), ["b", "one"]);
        assert_eq!(fs::read_to_string(deep.join("b/two")).unwrap(), "b/two");
        // An empty folder is one that is new. In others, files of earlier runs are replaced.
        fs::create_dir(there.join("empty")).unwrap();
        write(&there.join("empty")).keep().unwrap();
        fs::write(deep.join("other"), "").unwrap();
        fs::write(deep.join("one"), "one of before").unwrap();
        write(&deep).keep().unwrap();
        assert_eq!(names(&deep), ["b", "one", "other"]);
        assert_eq!(fs::read_to_string(deep.join("one")).unwrap(), "one");
        fs::write(deep.join("one"), "somebody's").unwrap();
        assert!(write(&deep).keep().is_err());
        assert_eq!(fs::read_to_string(deep.join("one")).unwrap(), "somebody's");
        assert!(WholeFolder::begin(&deep.join("one")).is_err());
        assert_eq!(names(scratch.path()), ["there"]);
    }
}
