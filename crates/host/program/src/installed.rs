//! The other programs of this release, found like git's subcommands: in the directory of the
//! running program, then in the directories of `PATH`.

use std::env;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, anyhow};
use rustix::fs::{Access, access};

/// The path of the program `name`: beside this one, or in a directory of `PATH`.
///
/// # Errors
/// There is none.
pub fn find_program(name: &str) -> anyhow::Result<PathBuf> {
    let beside = env::current_exe().context("cannot find the program's own file")?;
    let beside = beside.parent().unwrap_or(Path::new("/"));
    let path = env::var_os("PATH").unwrap_or_default();
    find(name, beside, env::split_paths(&path)).ok_or_else(|| {
        let place = beside.display();
        // Where this program looks for it.
        let profile = if beside.ends_with("debug") { "" } else { "--release " };
        anyhow!(
            "neither {place} nor a directory of PATH has the program {name}: build it with `cargo \
             build {profile}-p {name}`, which takes up to five minutes on two processors"
        )
    })
}

/// The first executable file of that name. Relative entries of `PATH` are skipped: files in the
/// current directory were not installed.
fn find(name: &str, beside: &Path, path: impl Iterator<Item = PathBuf>) -> Option<PathBuf> {
    [beside.to_owned()]
        .into_iter()
        .chain(path.filter(|directory| directory.is_absolute()))
        .map(|directory| directory.join(name))
        .find(|file| file.is_file() && access(file, Access::EXEC_OK).is_ok())
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn the_programs_directory_precedes_path_and_relative_entries_are_skipped() -> std::io::Result<()>
    {
        let place = tempfile::tempdir()?;
        let directory = |name: &str, mode| -> std::io::Result<PathBuf> {
            let directory = place.path().join(name);
            fs::create_dir(&directory)?;
            fs::write(directory.join("joulebus-x"), "")?;
            fs::set_permissions(directory.join("joulebus-x"), PermissionsExt::from_mode(mode))?;
            Ok(directory)
        };
        let (beside, installed) = (directory("beside", 0o755)?, directory("installed", 0o755)?);
        let (data, empty) = (directory("data", 0o644)?, place.path().to_owned());
        let found = |beside: &Path, path: &[&Path]| {
            let path = path.iter().map(|directory| directory.to_path_buf());
            find("joulebus-x", beside, path)
        };
        let in_both = found(&beside, &[&installed]);
        assert_eq!(in_both, Some(beside.join("joulebus-x")));
        // A file without execute permission is not a program.
        let installed_alone = found(&empty, &[&data, &installed]);
        assert_eq!(installed_alone, Some(installed.join("joulebus-x")));
        // Tests run in the package's directory, from which a relative path leads to the installed
        // program.
        let here = env::current_dir()?;
        let up: PathBuf = here.components().skip(1).map(|_| "..").collect();
        let relative = up.join(installed.strip_prefix("/").unwrap_or(&installed));
        assert!(relative.join("joulebus-x").is_file(), "{relative:?}");
        assert_eq!(found(&empty, &[&relative, Path::new("")]), None);
        Ok(())
    }
}
