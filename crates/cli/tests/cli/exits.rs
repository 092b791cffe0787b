//! Exit codes of every subcommand: 0 done, 1 failed, 2 wrong usage or config, 3 finished with
//! losses or differences. What runs until it is stopped is in [`crate::signals`] too.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::captures::capture;
use crate::fleet::{Fleet, at, code, is_built, joulebus, output, sees_all, stderr, stdout};

/// Arguments of a subcommand, and the exit code. Words in capitals are files: see [`file`].
pub(crate) const CASES: &[(i32, &str)] = &[
    (2, "demo --robots 0"),
    (0, "new controller NEW"),
    (1, "new planner /proc/new"),
    (2, "new planner THERE"),
    (2, "new bridge NEW"),
    (2, "run --config /nowhere.toml"),
    (2, "run --config JUNK"),
    (0, "publish sim --config FLEET --robots 1 --duration 0.1"),
    (2, "publish sim --config FLEET --robots 99"),
    (0, "publish trial TRIAL@0 --config FLEET --no-wait --rate max"),
    (1, "publish trial JUNK@0 --config FLEET --no-wait"),
    (2, "publish trial TRIAL --config FLEET --no-wait --rate 0"),
    (1, "record --config FLEET -o THERE"),
    (2, "record --config FLEET"),
    (2, "record --config FLEET -o NEW -e forecast$"),
    (2, "record --config FLEET -o NEW --topics joulebus/x/ticks"),
    (3, "replay CAPTURE --config FLEET --no-wait --rate max"),
    (1, "replay JUNK --config FLEET --no-wait"),
    (1, "replay --verify JUNK"),
    (1, "replay --verify /nowhere.mcap"),
    (2, "replay CAPTURE --config FLEET --fleet other"),
    (3, "replay CUT --config FLEET --no-wait --rate max"),
    (1, "watch --once --config FLEET"),
    (2, "watch --once --config JUNK"),
    (2, "watch --config FLEET --duration=-1"),
    (2, "watch --config FLEET --duration nan"),
    (0, "alarms CAPTURE"),
    (0, "alarms --config FLEET --duration 0.2"),
    (1, "alarms JUNK"),
    (2, "alarms --config JUNK"),
    (2, "alarms --duration 0"),
    (1, "alarms CUT"),
    (1, "alarms --config FLEET --acknowledge 1 LevelHigh --new-normal --by ann"),
    (2, "alarms --config FLEET --acknowledge 1 NoData --new-normal --by ann"),
    (2, "alarms --config FLEET --new-normal"),
    (1, "battery --config FLEET"),
    (1, "battery --config FLEET 1 --full --by ann"),
    (2, "battery --config FLEET --full"),
    (1, "ask --config FLEET --robot 1 --idle 5"),
    (2, "ask --config FLEET --idle 5"),
    (2, "ask --config FLEET --robot 1"),
    (2, "ask --config FLEET --robot 1 --path JUNK"),
    (2, "ask --config FLEET --robot 1 --idle 5 --return dock"),
    (2, "ask --config FLEET --robot 1 --idle 5 --power"),
    (2, "ask --config FLEET --rank 1,2 --path JUNK --power"),
    (2, "ask --config FLEET --rank 3-1 --idle 5"),
    (2, "ask --config JUNK --robot 1 --idle 5"),
    (0, "info CAPTURE"),
    (1, "info JUNK"),
    (1, "info /nowhere.mcap"),
    (2, "info"),
    (3, "info CUT"),
    (2, "cat CAPTURE"),
    (2, "info CAPTURE --format csv"),
    (0, "recover CAPTURE -o NEW"),
    (1, "recover JUNK -o NEW"),
    (1, "recover CAPTURE -o THERE"),
    (2, "recover CAPTURE"),
    (3, "recover CUT -o NEW"),
    (2, "serve"),
    (2, "serve --token-file JUNK"),
    (2, "serve --http --port 9000"),
    (2, "serve --http --per-robot"),
    (0, "bridge mqtt --robots agv=1 --write NEW"),
    (2, "bridge"),
    (2, "link"),
    (0, "link init base edge-1 --out NEW"),
    (2, "link init base"),
    (2, "link JUNK --format csv"),
    (2, "bridge JUNK --format csv"),
    (0, "import CAPTURE -o NEW"),
    (0, "import TRIAL -o NEW.mcap"),
    (1, "import JUNK -o NEW"),
    (1, "import CUT -o NEW"),
    (2, "import CAPTURE"),
    (0, "data info TRIAL"),
    (1, "data info JUNK"),
    (2, "data info"),
    (0, "data check TRIAL"),
    (2, "data check"),
    (3, "data check JUNK"),
    (0, "data convert TRIAL --to npy -o NEW"),
    (1, "data convert TRIAL -o TRIAL"),
    (1, "data convert JUNK --to npy -o NEW"),
    (2, "data convert TRIAL"),
    (0, "data simulate NEW"),
    (2, "data simulate"),
    (0, "status --config FLEET"),
    (2, "status --format csv"),
    (0, "doctor CAPTURE"),
    (1, "doctor JUNK"),
    (2, "doctor --config JUNK"),
    (3, "doctor CUT"),
    (0, "config init --from TRIAL -o NEW"),
    (0, "config init --power 30-200 --speed 1.2 --battery-wh 480 -o NEW"),
    (0, "config init --from TRIAL --train -o NEW"),
    (1, "config init --from JUNK -o NEW"),
    (2, "config init"),
    (0, "config check FLEET"),
    (2, "config check JUNK"),
    (0, "config show FLEET"),
    (2, "config show JUNK"),
    (0, "config explain tick.rate_hz"),
    (2, "config explain tick.rate"),
    (0, "config schema link"),
    (2, "config schema links"),
    (0, "train trials TRIAL --split time -o NEW"),
    (1, "train trials JUNK -o NEW"),
    (2, "train trials TRIAL"),
    (2, "train trials TRIAL --split time --threads 4 -o NEW"),
    (2, "analyze TRIAL --split time --lags 18446744073709551615"),
    (2, "eval TRIAL --resamples 4294967295"),
    (2, "train sim"),
    (0, "analyze TRIAL --split time"),
    (1, "analyze JUNK"),
    (2, "analyze"),
    (0, "eval TRIAL --model MODEL"),
    (1, "eval JUNK --model MODEL"),
    (1, "eval TRIAL --model JUNK"),
    (2, "eval"),
    (2, "eval TRIAL --model MODEL --partition 1/1"),
    (2, "eval --merge JUNK"),
    (0, "report TRIAL -o NEW"),
    (2, "report TRIAL"),
    (2, "bench nothing"),
    (2, "mission --hours 0"),
    (0, "model info MODEL"),
    (0, "model info builtin:husky"),
    (2, "model info builtin:nothing"),
    (1, "model info JUNK"),
    (2, "model info"),
    (1, "model import JUNK --data TRIAL -o NEW"),
    (2, "model import MODEL --data TRIAL -o NEW"),
    (2, "model import JUNK -o NEW"),
    (2, "model import JUNK --data TRIAL --part x -o NEW"),
    (0, "model export MODEL --to npz -o NEW"),
    (1, "model export JUNK --to npz -o NEW"),
    (0, "model export MODEL --to python -o NEW"),
    (2, "model export MODEL --python NEW"),
    (2, "model export MODEL"),
    (0, "model compare MODEL MODEL TRIAL"),
    (1, "model compare MODEL JUNK TRIAL"),
    (2, "model compare MODEL MODEL"),
    (0, "man NEW"),
    (1, "man JUNK"),
    (2, "man"),
    (0, "completions bash"),
    (2, "completions cmd"),
];

const MODEL: &str =
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/models/gternal-sim.safetensors");

/// Writes a file of text, a capture and one that is cut short.
pub(crate) fn prepare(fleet: &Fleet) {
    fs::write(fleet.path("junk"), "hello\n").unwrap();
    fleet.recording("trial.csv", 300);
    let (whole, _) = capture(fleet, 300);
    let bytes = fs::read(whole).unwrap();
    fs::write(fleet.path("cut.mcap"), &bytes[..bytes.len() * 2 / 3]).unwrap();
}

/// The file that a word names; `new` for NEW, with an ending if the word has one.
pub(crate) fn file(fleet: &Fleet, word: &str, new: &Path) -> PathBuf {
    match word {
        "MODEL" => MODEL.into(),
        "TRIAL" => fleet.path("trial.csv"),
        "TRIAL@0" => at(&fleet.path("trial.csv"), "0"),
        "JUNK@0" => at(&fleet.path("junk"), "0"),
        "CAPTURE" => fleet.path("trials.mcap"),
        "CUT" => fleet.path("cut.mcap"),
        "JUNK" | "THERE" => fleet.path("junk"),
        "FLEET" => fleet.config(),
        word => match word.strip_prefix("NEW") {
            Some(ending) => format!("{}{ending}", new.display()).into(),
            None => word.into(),
        },
    }
}

#[test]
fn every_subcommand_ends_with_the_code_that_its_help_states() {
    let fleet = Fleet::new();
    prepare(&fleet);
    let mut wrong = Vec::new();
    // Only the program knows which options require each other.
    let cases = CASES.iter().enumerate();
    for (place, (expected, words)) in cases.filter(|(_, (_, words))| is_built(words)) {
        let new = fleet.path(&format!("new-{place}"));
        let arguments = words.split(' ').map(|word| file(&fleet, word, &new));
        let _alone = words.starts_with("status").then(sees_all);
        let ended = joulebus(arguments).output().unwrap();
        let printed = stderr(&ended);
        let fails = matches!(expected, 1 | 2);
        // A failed call has no result, states the cause, and leaves no part of a file.
        let is_silent = stdout(&ended).is_empty() && !printed.is_empty() && !new.exists();
        if code(&ended) != *expected || fails && !is_silent {
            wrong.push(format!("{expected}, {words}: {ended:?}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert_eq!(fs::read_to_string(fleet.path("junk")).unwrap(), "hello\n");
    assert!(fleet.stale_files().is_empty());
}

/// `ulimit` with these words, and what the error names.
const LIMITS: &[(&str, &[&str])] = &[
    ("-v 100000", &["address space: ", " used, 102400000 allowed", "(`ulimit -v "]),
    ("-v 400000", &["address space: ", " used, 409600000 allowed", "(`ulimit -v "]),
    ("-s 64", &["stack: 524288 bytes needed, 65536 allowed", "(`ulimit -s 512`)"]),
    ("-s 256", &["stack: 524288 bytes needed, 262144 allowed", "(`ulimit -s 512`)"]),
];

#[test]
fn a_limit_of_address_space_or_stack_is_named_and_nobody_is_aborted() {
    let fleet = Fleet::new();
    let new = fleet.path("new");
    let rows = ["run", "publish sim --robots 2", "record -o NEW", "serve --http"];
    for row in rows.into_iter().filter(|row| is_built(row)) {
        let whole = format!("{row} --config FLEET");
        let mut words = whole.split(' ').map(|word| file(&fleet, word, &new));
        // `joulebus` itself would refuse the stack first.
        let program = Path::new(env!("CARGO_BIN_EXE_joulebus"));
        let (program, first) = match words.next() {
            Some(verb) if verb == Path::new("serve") => {
                (program.with_file_name("joulebus-serve"), None)
            }
            verb => (program.to_owned(), verb),
        };
        let words: Vec<PathBuf> = first.into_iter().chain(words).collect();
        for (limit, wanted) in LIMITS {
            let mut limited = Command::new("bash");
            limited.args(["-c", &format!("ulimit {limit}; exec \"$@\""), "bash"]);
            let ended = limited.arg(&program).args(&words).output().unwrap();
            let printed = stderr(&ended);
            let is_named = wanted.iter().all(|part| printed.contains(part));
            assert!(is_named && ended.status.code() == Some(1), "{row}, {limit}: {ended:?}");
            assert!(!new.exists(), "{row}, {limit}");
        }
    }
    assert!(fleet.stale_files().is_empty());
}

/// The subcommands of one, from its help: the names in its list, but `help`.
pub(crate) fn below(words: &[String]) -> Vec<String> {
    let help = output(words.iter().map(String::as_str).chain(["--help"]));
    let text = stdout(&help);
    let (_, list) = text.split_once("Commands:\n").unwrap_or_default();
    let list = ["Arguments:\n", "Options:\n"]
        .into_iter()
        .fold(list, |list, next| list.split_once(next).map_or(list, |(before, _)| before));
    let names = list.lines().filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    let names = names.filter_map(|line| line.split_whitespace().next());
    names.filter(|name| *name != "help").map(str::to_owned).collect()
}

/// True if a row of a table calls this subcommand.
pub(crate) fn calls(row: &str, verb: &str) -> bool {
    row == verb || row.starts_with(&format!("{verb} "))
}

/// All subcommands without others below them.
pub(crate) fn leaves() -> Vec<String> {
    let all = subcommands();
    let leaves = all.iter().filter(|words| below(words).is_empty());
    let leaves: Vec<String> = leaves.map(|words| words.join(" ")).collect();
    assert!(leaves.len() > 25, "{leaves:?}");
    leaves
}

/// All subcommands and theirs, as the words of a call.
pub(crate) fn subcommands() -> Vec<Vec<String>> {
    let mut found = vec![Vec::new()];
    let mut looked_at = 0;
    while let Some(words) = found.get(looked_at).cloned() {
        found.extend(below(&words).into_iter().map(|name| {
            let mut longer = words.clone();
            longer.push(name);
            longer
        }));
        looked_at += 1;
    }
    found.split_off(1)
}

#[test]
fn the_table_has_every_subcommand() {
    for verb in leaves() {
        assert!(CASES.iter().any(|(_, case)| calls(case, &verb)), "{verb}");
    }
}

/// The same call, whose results a full disk refuses.
fn refused(arguments: impl IntoIterator<Item = PathBuf>) -> Output {
    let full = fs::File::options().write(true).open("/dev/full").unwrap();
    joulebus(arguments).stdout(full).output().unwrap()
}

#[test]
fn results_that_cannot_be_written_are_a_failure() {
    let fleet = Fleet::new();
    prepare(&fleet);
    let new = fleet.path("new");
    let mut calls: Vec<Vec<PathBuf>> = vec![vec!["--help".into()], vec!["--version".into()]];
    for mut words in subcommands() {
        words.push("--help".to_owned());
        calls.push(words.iter().map(PathBuf::from).collect());
    }
    let good = CASES.iter().filter(|(code, _)| *code == 0);
    calls.extend(
        good.map(|(_, words)| words.split(' ').map(|word| file(&fleet, word, &new)).collect()),
    );
    let mut wrong = Vec::new();
    let clear = || {
        let capture = new.with_extension("mcap");
        [&new, &capture].map(|path| fs::remove_dir_all(path).or_else(|_| fs::remove_file(path)))
    };
    for call in &calls {
        let ended = refused(call.clone());
        let printed = stderr(&ended).contains("cannot write to stdout");
        let _ = clear();
        // Publishers, and verbs whose result is a file, print nothing to stdout.
        let has_results = !output(call).stdout.is_empty();
        let _ = clear();
        if code(&ended) != i32::from(has_results) || printed != has_results {
            wrong.push(format!("{call:?}: {ended:?}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
