//! Subcommands in separate executables: lookup, arguments, exit codes and signals.

use std::fs;
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::fleet::{Exits as _, code, is_built, output, stderr, stdout};
use joulebus_testkit::assert_contains;

/// The program in an otherwise empty directory.
struct Installed(tempfile::TempDir);

impl Installed {
    fn new() -> Self {
        let place = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
        let program = env!("CARGO_BIN_EXE_joulebus");
        fs::hard_link(program, place.path().join("joulebus")).unwrap();
        Self(place)
    }

    fn joulebus(&self, path: &str, words: &str) -> Output {
        Command::new(self.0.path().join("joulebus"))
            .args(words.split(' '))
            .env("PATH", path)
            .current_dir(self.directory("stands-here"))
            .output()
            .unwrap()
    }

    fn directory(&self, name: &str) -> PathBuf {
        let directory = self.0.path().join(name);
        fs::create_dir_all(&directory).unwrap();
        directory
    }
}

/// Writes a script that prints its path and arguments and then runs `then`. In a separate process:
/// a child that another test forks meanwhile would inherit the open file, and a file open for
/// writing cannot be executed (ETXTBSY).
fn write_program(directory: &Path, verb: &str, then: &str) {
    let file = directory.join(format!("joulebus-{verb}"));
    let written = Command::new("sh")
        .args(["-c", "printf '%s' \"$1\" > \"$0\" && chmod 755 \"$0\""])
        .arg(&file)
        .arg(format!("#!/bin/sh\necho \"$0\" \"$@\"\n{then}\n"))
        .status();
    assert!(written.unwrap().success(), "{}", file.display());
}

#[test]
fn an_executable_beside_this_one_gets_the_arguments_and_passes_its_exit_code_and_signals() {
    let installed = Installed::new();
    let in_path = installed.directory("path");
    write_program(&in_path, "serve", "exit 9");
    write_program(installed.0.path(), "serve", "exit 3");
    let path = format!("{}:/usr/bin:/bin", in_path.display());
    let ended = installed.joulebus(&path, "-v --format json serve --http").exits(3);
    let beside = installed.0.path().join("joulebus-serve");
    let command_line = format!("{} -v --format json --http\n", beside.display());
    assert_eq!(stdout(&ended), command_line);

    write_program(installed.0.path(), "serve", "kill -TERM $$");
    let killed = installed.joulebus(&path, "serve --http");
    assert_eq!(killed.status.signal(), Some(15), "{killed:?}");
}

#[test]
fn without_one_the_executable_is_looked_up_in_path_but_not_in_the_current_directory() {
    let installed = Installed::new();
    write_program(&installed.directory("stands-here"), "bench", "exit 9");
    for path in ["", ".", ":", "../stands-here"] {
        let refused = installed.joulebus(path, "bench kernel");
        assert_eq!(code(&refused), 1, "{path:?}: {}", stdout(&refused));
        let printed = stderr(&refused);
        assert_contains(&printed, ["cargo build --release -p joulebus-bench"]);
        assert_eq!(stdout(&refused), "", "{path:?}");
    }
    let in_path = installed.directory("path");
    write_program(&in_path, "bench", "exit 0");
    let path = format!(".:{}:/usr/bin:/bin", in_path.display());
    let found = installed.joulebus(&path, "bench kernel").exits(0);
    assert!(stdout(&found).starts_with(in_path.to_str().unwrap()));
}

#[test]
fn the_verbs_on_recordings_are_one_executable_which_gets_all_arguments() {
    let installed = Installed::new();
    for words in ["-v publish trial a.csv --rate max", "train sim --seed 1 --out x"] {
        let missing = installed.joulebus("", words);
        assert_eq!(code(&missing), 1, "{words}: {}", stdout(&missing));
        let printed = stderr(&missing);
        assert_contains(&printed, ["cargo build --release -p joulebus-lab`"]);
        write_program(installed.0.path(), "lab", "exit 3");
        let lab = installed.0.path().join("joulebus-lab");
        let ended = installed.joulebus("", words);
        assert_eq!(code(&ended), 3, "{words}: {}", stderr(&ended));
        assert_eq!(stdout(&ended), format!("{} {words}\n", lab.display()));
        fs::remove_file(lab).unwrap();
    }
}

#[test]
fn a_program_shows_the_help_of_its_verbs_and_what_is_this_ones_needs_none() {
    let installed = Installed::new();
    for (words, exit, expected) in [
        ("help publish", 0, "trial"),
        ("--help", 0, "Simulate missions"),
        ("help serve", 1, "cargo build --release -p joulebus-serve"),
        ("eval --help", 1, "cargo build --release -p joulebus-lab"),
        ("completions bash", 0, "without the options of joulebus-lab"),
        ("cat run.mcap --topics x", 2, "cat went: `mcap cat FILE --json`"),
        ("calibrate a.mcap", 2, "calibrate went: alarms.level_alarms_per_robot_h"),
        ("serve --format csv", 2, "csv went: the verb `cat`"),
    ] {
        let ended = installed.joulebus("", words);
        assert_eq!(code(&ended), exit, "{words}");
        let printed = stdout(&ended) + &stderr(&ended);
        assert!(printed.contains(expected), "{words}: {printed}");
    }
    for program in ["serve", "link", "lab"] {
        write_program(installed.0.path(), program, "exit 0");
    }
    for (words, program, expected) in [
        ("help serve", "serve", "--help"),
        ("serve -h", "serve", "-h"),
        ("-v help link init", "link", "init --help"),
        ("--format json help config init", "lab", "config init --help"),
        ("help train trials", "lab", "train trials --help"),
        ("publish help trial", "lab", "publish trial --help"),
        ("mission --help", "lab", "mission --help"),
    ] {
        let program = installed.0.path().join(format!("joulebus-{program}"));
        let ended = installed.joulebus("", words).exits(0);
        assert_eq!(stdout(&ended), format!("{} {expected}\n", program.display()), "{words}");
    }
}

/// The programs themselves, which other tests build.
#[test]
fn completions_have_the_options_of_every_program_and_help_says_what_each_verb_is_for() {
    let script = stdout(&output(["completions", "bash"]));
    let help = stdout(&output(["--help"])).split_whitespace().collect::<Vec<_>>().join(" ");
    for (verb, option) in [
        ("record", "--per-robot"),
        ("train trials", "--hold-out"),
        ("publish trial", "--frame-rate"),
        ("config init", "--train"),
        ("serve", "--token-file"),
        ("bridge", "--broker"),
        ("link", "--check"),
        ("bench", "--learning"),
    ] {
        if !is_built(verb) {
            continue;
        }
        assert!(script.contains(option), "{verb} {option}");
        let own = stdout(&output(verb.split(' ').chain(["--help"])));
        assert!(own.contains(option), "{verb}: {own}");
        // Verbs of verbs are listed with those.
        let about = own.split("\n\n").next().unwrap().replace('\n', " ");
        assert!(verb.contains(' ') || help.contains(&about), "{verb}: {about}");
    }
}
