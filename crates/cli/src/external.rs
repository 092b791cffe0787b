//! Verbs that are separate programs. `joulebus VERB` executes `joulebus-VERB`, which is searched
//! like git's subcommands: in the directory of the running program, then in the directories of
//! `PATH`.

use std::env;
use std::ffi::OsString;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, anyhow};
use joulebus_program::exit::Outcome;
use rustix::fs::{Access, access};

/// Executes the program of `verb`, with the same arguments, replacing this process; so signals and
/// the exit code need no forwarding. Returns only on failure.
///
/// # Errors
/// There is no such program, or it cannot be started.
pub(crate) fn run(verb: &str) -> anyhow::Result<Outcome> {
    let program = find_program(&format!("joulebus-{verb}"))
        .with_context(|| format!("`joulebus {verb}` is a separate program"))?;
    let arguments = without(verb, env::args_os().skip(1));
    let error = Command::new(&program).args(arguments).exec();
    Err(error).with_context(|| format!("cannot start {}", program.display()))
}

/// The program `name`: beside this one, or in a directory of `PATH`.
///
/// # Errors
/// There is none.
pub(crate) fn find_program(name: &str) -> anyhow::Result<PathBuf> {
    let beside = env::current_exe().context("cannot find the program's own file")?;
    let beside = beside.parent().unwrap_or(Path::new("/"));
    let path = env::var_os("PATH").unwrap_or_default();
    find(name, beside, env::split_paths(&path)).ok_or_else(|| {
        let place = beside.display();
        anyhow!(
            "neither {place} nor a directory of PATH has the program {name}: build it with `cargo \
             build --release -p {name}`, or install it with `cargo install {name}`"
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

/// The arguments without the verb, the first word equal to its name: only global options precede
/// it, and none of them takes a verb's name as its value.
fn without(verb: &str, arguments: impl Iterator<Item = OsString>) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = arguments.collect();
    if let Some(place) = arguments.iter().position(|argument| argument == verb) {
        arguments.remove(place);
    }
    arguments
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn only_the_verb_is_removed() {
        let words = ["-v", "--format", "json", "report", "report", "--out", "x"];
        let left = without("report", words.iter().map(OsString::from));
        assert_eq!(left, ["-v", "--format", "json", "report", "--out", "x"]);
    }

    #[test]
    fn the_programs_directory_precedes_path_and_relative_entries_are_skipped() -> std::io::Result<()>
    {
        let place = tempfile::tempdir()?;
        let directory = |name: &str, mode| -> std::io::Result<PathBuf> {
            let directory = place.path().join(name);
            fs::create_dir(&directory)?;
            fs::write(directory.join("joulebus-x"), "")?;
            fs::set_permissions(
                directory.join("joulebus-x"),
                PermissionsExt::from_mode(mode),
            )?;
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
