//! Folders that appear when all of their files are whole.

use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use crate::disk;
use crate::whole::{MAX_KIND_BYTES, beside, check_beside, check_kind, rename_new, taken};

/// The files of a folder, which appear when the result is whole ([`keep`](Self::keep)): a new
/// folder with all of them at once. In a folder that is there, each appears whole, one right after
/// the other.
///
/// Until then they are in a hidden folder, `.joulebus-PID-N`, in the nearest folder that is there.
/// It is removed with this. That of a killed process is removed by the next that writes there.
#[derive(Debug)]
pub struct WholeFolder {
    folder: PathBuf,
    hidden: Option<Hidden>,
}

#[derive(Debug)]
struct Hidden {
    path: PathBuf,
    /// The new folder that it becomes. None if the folder is there.
    becomes: Option<PathBuf>,
    /// Paths of the files below the folder.
    names: Vec<PathBuf>,
    /// Locked while it is open.
    _lock: File,
}

impl Drop for Hidden {
    fn drop(&mut self) {
        // Whatever stays is removed by the next process.
        let _ = fs::remove_dir_all(&self.path);
    }
}

impl WholeFolder {
    /// Begins a result in `folder`, which is made at the end if it is missing. Makes nothing yet.
    ///
    /// # Errors
    /// Something else than a folder is there, or nothing can be written there.
    pub fn begin(folder: &Path) -> io::Result<Self> {
        // Fails now and not after hours.
        check_beside(&missing(folder).unwrap_or_else(|| folder.join("new")))?;
        Ok(Self { folder: folder.to_owned(), hidden: None })
    }

    /// Where to write the file of this path below the folder. The folder of the file is made.
    ///
    /// # Errors
    /// Those of the system.
    pub fn path(&mut self, name: impl AsRef<Path>) -> io::Result<PathBuf> {
        let hidden = match &mut self.hidden {
            Some(hidden) => hidden,
            none => none.insert(Hidden::new(&self.folder)?),
        };
        let below = hidden.becomes.as_ref().and_then(|top| self.folder.strip_prefix(top).ok());
        let path = hidden.path.join(below.unwrap_or(Path::new(""))).join(name.as_ref());
        fs::create_dir_all(path.parent().unwrap_or(&path))?;
        hidden.names.push(name.as_ref().to_owned());
        Ok(path)
    }

    /// The result is whole: its files get their names, and replace those of earlier runs.
    ///
    /// # Errors
    /// Those of [`replace`](crate::replace()).
    pub fn keep(self) -> io::Result<()> {
        let check = |from: &Path, to: &Path| {
            let mut beginning = Vec::new();
            File::open(from)?.take(MAX_KIND_BYTES as u64).read_to_end(&mut beginning)?;
            check_kind(to, &beginning)
        };
        self.name_files(check, |from, to| disk::rename(from, to))
    }

    /// Same as [`keep`](Self::keep), but replaces nothing.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`], or those of the system.
    pub fn keep_new(self) -> io::Result<()> {
        let check = |_: &Path, to: &Path| match disk::exists(to) {
            true => Err(taken()),
            false => Ok(()),
        };
        self.name_files(check, |from, to| rename_new(from, to).map(drop))
    }

    fn name_files(
        mut self,
        check: impl Fn(&Path, &Path) -> io::Result<()>,
        rename: impl Fn(&Path, &Path) -> io::Result<()>,
    ) -> io::Result<()> {
        let Some(mut hidden) = self.hidden.take() else { return Ok(()) };
        if let Some(top) = &hidden.becomes {
            disk::rename(&hidden.path, top)?;
            hidden.path.clear();
            return Ok(());
        }
        let named = |name: &PathBuf| (hidden.path.join(name), self.folder.join(name));
        for (from, to) in hidden.names.iter().map(named).filter(|(from, _)| disk::exists(from)) {
            check(&from, &to).map_err(|error| {
                io::Error::new(error.kind(), format!("{}: {error}", to.display()))
            })?;
            // A power failure must not leave a part of it in the place of the file before.
            File::open(from)?.sync_all()?;
        }
        for (from, to) in hidden.names.iter().map(named) {
            let new = missing(to.parent().unwrap_or(&to));
            match new.as_ref().and_then(|new| new.strip_prefix(&self.folder).ok()) {
                Some(below) => disk::rename(hidden.path.join(below), self.folder.join(below))?,
                None if disk::exists(&from) => rename(&from, &to)?,
                None => {}
            }
        }
        Ok(())
    }
}

impl Hidden {
    fn new(folder: &Path) -> io::Result<Self> {
        let becomes = missing(folder);
        let path = becomes.clone().unwrap_or_else(|| folder.join("new"));
        let made = |hidden: &Path| fs::create_dir(hidden).and_then(|()| File::open(hidden));
        let (lock, path) = beside(&path, made)?;
        Ok(Self { path, becomes, names: Vec::new(), _lock: lock })
    }
}

/// The topmost missing folder of a path.
fn missing(folder: &Path) -> Option<PathBuf> {
    let missing = folder.ancestors().take_while(|at| !disk::exists(at));
    missing.filter(|at| !at.as_os_str().is_empty()).last().map(Path::to_owned)
}

#[cfg(test)]
mod tests {
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
                fs::write(whole.path(name).unwrap(), name).unwrap();
            }
            // One that is not written after all.
            whole.path("c/three").unwrap();
            whole
        };
        let deep = there.join("a/b");
        let dropped = write(&deep);
        assert!(names(scratch.path())[0].starts_with(".joulebus-"));
        drop(dropped);
        assert_eq!(names(scratch.path()), [""; 0]);
        // As if it was killed: it is removed by the next.
        fs::create_dir(scratch.path().join(".joulebus-1-0")).unwrap();
        write(&deep).keep().unwrap();
        assert_eq!(names(scratch.path()), ["there"]);
        assert_eq!(names(&deep), ["b", "c", "one"]);
        assert_eq!(fs::read_to_string(deep.join("b/two")).unwrap(), "b/two");
        // In a folder that is there, files of earlier runs are replaced, if they may be.
        fs::create_dir(there.join("empty")).unwrap();
        write(&there.join("empty")).keep_new().unwrap();
        fs::write(deep.join("other"), "").unwrap();
        fs::write(deep.join("one"), "one of before").unwrap();
        let error = write(&deep).keep_new().unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
        assert!(error.to_string().contains("b/one: the file exists"), "{error}");
        write(&deep).keep().unwrap();
        assert_eq!(names(&deep), ["b", "c", "one", "other"]);
        assert_eq!(fs::read_to_string(deep.join("one")).unwrap(), "one");
        fs::write(deep.join("one"), "somebody's").unwrap();
        assert!(write(&deep).keep().is_err());
        assert_eq!(fs::read_to_string(deep.join("one")).unwrap(), "somebody's");
        assert!(WholeFolder::begin(&deep.join("one")).is_err());
        assert_eq!(names(scratch.path()), ["there"]);
        assert_eq!(names(&deep), ["b", "c", "one", "other"]);
    }
}
