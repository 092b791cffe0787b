//! Every verb, killed at random moments: its result is there whole or not at all, and the next run
//! removes what is left. `JOULEBUS_KILLS` is the number of kills of each row, `JOULEBUS_SEED` draws
//! their moments.

use std::collections::{BTreeMap, BTreeSet};
use std::env;
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use joulebus_testkit::eventually;
use rustix::process::Signal;

use crate::exits::{CASES, calls, file, leaves, prepare};
use crate::fleet::{Exits as _, Fleet, Program, code, is_built, output, stderr};
use crate::signals::{RUNS, command};

/// Rows that the tables of exit codes and signals lack.
const MORE: [(&str, &str); 1] =
    [("demo --robots 2 --duration 60 --capture FILE --format json", "  samples ")];

/// Verbs that only compute, for minutes: they write no file.
const LONG: &str = "mission, bench";

/// The rows to kill of a verb that ends by itself: those that succeed, or if none does without a
/// worker, those that fail.
fn rows(verb: &str) -> Vec<&'static (i32, &'static str)> {
    let with = |codes: &[i32]| {
        let rows = CASES.iter().filter(|(code, row)| codes.contains(code) && calls(row, verb));
        rows.collect::<Vec<_>>()
    };
    Some(with(&[0, 3])).filter(|rows| !rows.is_empty()).unwrap_or_else(|| with(&[1]))
}

/// Verbs whose files others read or run, as far as the umask allows. All other files are their
/// owner's alone.
const SHARED: &str = "new, config init, man, model export, train sim, train trials, bridge";

/// System calls that make, name and fill files.
const NAMING: &str =
    "openat,mkdir,mkdirat,link,linkat,rename,renameat,renameat2,unlink,unlinkat,rmdir,write";

/// Numbers that only the seed determines.
struct Draws(u64);

impl Draws {
    fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(0x1405_7b7e_f767_814f);
        (self.0 >> 33) as usize % end.max(1)
    }
}

fn number(variable: &str, usual: u64) -> u64 {
    env::var(variable).map_or(usual, |text| text.parse().unwrap())
}

/// A fleet with files to read, and the folders in which verbs may write: where they run, for
/// temporary files, and the home.
struct Scene {
    fleet: Fleet,
    before: BTreeSet<PathBuf>,
}

impl Scene {
    fn new(fleet: Fleet) -> Self {
        for name in ["here", "temporary", "home"] {
            fs::create_dir(fleet.path(name)).unwrap();
        }
        Self { before: below(&fleet.path("")), fleet }
    }

    /// The result of a row.
    fn new_file(&self) -> PathBuf {
        self.fleet.path("here/new")
    }

    /// A command under a mask that allows others everything.
    fn command(&self, row: &str, tracer: &[&str]) -> Command {
        let arguments = row.split(' ').map(|word| file(&self.fleet, word, &self.new_file()));
        self.around(&crate::fleet::joulebus(arguments), tracer)
    }

    fn around(&self, inner: &Command, tracer: &[&str]) -> Command {
        let mut command = Command::new("sh");
        command.args(["-c", "umask 0; exec \"$@\"", "sh"]).args(tracer);
        command.arg(inner.get_program()).args(inner.get_args());
        command.current_dir(self.fleet.path("here")).env_remove("JOULEBUS_LOG");
        command.env("TMPDIR", self.fleet.path("temporary")).env("HOME", self.fleet.path("home"));
        for name in ["XDG_STATE_HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME", "XDG_RUNTIME_DIR"] {
            command.env_remove(name);
        }
        command
    }

    /// What is there that was not before.
    fn made(&self) -> BTreeSet<PathBuf> {
        below(&self.fleet.path("")).difference(&self.before).cloned().collect()
    }

    /// The same without what the next run removes: hidden folders and files beside results.
    fn named(&self) -> BTreeSet<PathBuf> {
        let mut made = self.made();
        made.retain(|path| !path.components().any(|part| is_hidden(Path::new(part.as_os_str()))));
        made
    }

    /// Waits for the processes that a killed one had started: each ends by itself.
    fn wait_for_its_processes(&self) {
        let here = fs::canonicalize(self.fleet.path("here")).unwrap();
        eventually("the processes of a killed one have ended", || {
            let mut processes = fs::read_dir("/proc").unwrap().flatten();
            !processes.any(|one| fs::read_link(one.path().join("cwd")).is_ok_and(|at| at == here))
        });
    }

    fn clear(&self) {
        for path in self.named() {
            let path = self.fleet.path("").join(path);
            let _ = fs::remove_file(&path).or_else(|_| fs::remove_dir_all(&path));
        }
    }

    /// Others can read no file of these but those that are meant for them.
    fn check_modes(&self, row: &str, paths: &BTreeSet<PathBuf>) {
        let shared = SHARED.split(", ").any(|verb| calls(row, verb));
        for path in paths {
            let path = self.fleet.path("").join(path);
            let found = fs::symlink_metadata(&path).unwrap();
            let mode = found.permissions().mode() & 0o777;
            assert!(shared || found.is_dir() || mode == 0o600, "{row}: {path:?} {mode:o}");
        }
    }
}

fn is_hidden(name: &Path) -> bool {
    let text = name.to_string_lossy();
    let numbers = text.strip_prefix(".joulebus-");
    numbers.is_some_and(|numbers| numbers.bytes().all(|one| one.is_ascii_digit() || one == b'-'))
}

/// All paths below a folder, relative to it.
fn below(folder: &Path) -> BTreeSet<PathBuf> {
    let (mut found, mut folders) = (BTreeSet::new(), vec![folder.to_owned()]);
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).into_iter().flatten().flatten() {
            if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                folders.push(entry.path());
            }
            found.insert(entry.path().strip_prefix(folder).unwrap().to_owned());
        }
    }
    found
}

/// The calls of a row's first thread that name or fill files, each with its number among all of
/// that call. Empty without strace.
fn traced(scene: &Scene, (expected, row): (i32, &str)) -> Vec<(String, usize)> {
    let seen = scene.fleet.path("trace");
    let trace = format!("trace={NAMING}");
    let seen_text = seen.display().to_string();
    let tracer = ["strace", "-f", "-qq", "--seccomp-bpf", "-e", &trace, "-o", &seen_text];
    let ended = scene.command(row, &tracer).output().unwrap();
    assert_eq!(code(&ended), expected, "{row}: {}", stderr(&ended));
    let text = fs::read_to_string(&seen).unwrap();
    fs::remove_file(seen).unwrap();
    let first = text.split_whitespace().next().unwrap_or_default();
    let (mut numbers, mut found) = (BTreeMap::new(), Vec::new());
    for line in text.lines() {
        let Some((process, line)) = line.split_once(char::is_whitespace) else { continue };
        let Some((call, _)) = line.trim_start().split_once('(') else { continue };
        if process == first && NAMING.split(',').any(|name| name == call) {
            let number: &mut usize = numbers.entry(call.to_owned()).or_default();
            *number += 1;
            if call != "openat" || line.contains("O_CREAT") || line.contains("O_TMPFILE") {
                found.push((call.to_owned(), *number));
            }
        }
    }
    found
}

fn can_trace() -> bool {
    let works = Command::new("strace").args(["-qq", "-e", "trace=none", "true"]).output();
    let works = works.is_ok_and(|output| output.status.success());
    if !works {
        println!("skipped: needs strace with the right to trace");
        assert_ne!(env::var("CI").as_deref(), Ok("true"), "no strace");
    }
    works
}

#[test]
fn a_verb_that_is_killed_leaves_its_whole_result_or_none_and_nothing_else() {
    let (kills, can_trace) = (number("JOULEBUS_KILLS", 2), can_trace());
    let mut draws = Draws(number("JOULEBUS_SEED", 61));
    let all: Vec<_> = leaves().iter().flat_map(|verb| rows(verb)).collect();
    for (expected, row) in all.into_iter().filter(|(_, row)| is_built(row)) {
        let fleet = Fleet::new();
        prepare(&fleet);
        let scene = Scene::new(fleet);
        let started = Instant::now();
        let moments = if can_trace { traced(&scene, (*expected, row)) } else { Vec::new() };
        if !can_trace {
            scene.command(row, &[]).output().unwrap();
        }
        let took = started.elapsed();
        let whole = scene.named();
        assert_eq!(scene.made(), whole, "{row}");
        assert!(whole.iter().all(|path| path.starts_with("here")), "{row}: {whole:?}");
        scene.check_modes(row, &whole);
        for kill in 0..kills {
            scene.clear();
            match moments.get(draws.below(moments.len())) {
                Some((call, number)) if kill % 2 == 0 => {
                    let inject = format!("inject={call}:signal=KILL:when={number}");
                    let trace = format!("trace={call}");
                    let tracer = ["strace", "-f", "-qq", "-e", &trace, "-e", &inject];
                    let tracer = [&tracer[..], &["-o", "/dev/null"]].concat();
                    scene.command(row, &tracer).output().unwrap();
                }
                _ => {
                    let program = Program::start(scene.command(row, &[]));
                    std::thread::sleep(took.mul_f64(draws.below(1_000) as f64 / 1e3));
                    program.end(Signal::KILL);
                }
            }
            let left = scene.named();
            assert!(left.is_empty() || left == whole, "{row}: {left:?} of {whole:?}");
        }
        scene.clear();
        let again = scene.command(row, &[]).output().unwrap();
        assert_eq!(code(&again), *expected, "{row}: {}", stderr(&again));
        assert_eq!(scene.made(), whole, "{row}");
        assert_eq!(scene.fleet.stale_files(), [""; 0].map(PathBuf::from), "{row}");
    }
}

#[test]
fn a_verb_that_runs_and_is_killed_leaves_a_readable_capture_and_nothing_else() {
    let kills = number("JOULEBUS_KILLS", 2);
    let mut draws = Draws(number("JOULEBUS_SEED", 61));
    for (row, wanted) in RUNS.iter().chain(&MORE).filter(|(row, _)| is_built(row)) {
        let fleet = Fleet::new();
        let inner = command(&fleet, row);
        let scene = Scene::new(fleet);
        let start = || Program::start(scene.around(&inner, &[]));
        let results = ["run.mcap", "new.training"].map(PathBuf::from);
        let mut pids = Vec::new();
        for _ in 0..kills {
            let program = start();
            pids.push(program.pid());
            std::thread::sleep(Duration::from_millis(draws.below(1_200) as u64));
            program.end(Signal::KILL);
            scene.wait_for_its_processes();
            let left = scene.named();
            assert!(left.iter().all(|path| results.contains(path)), "{row}: {left:?}");
            scene.check_modes(row, &left);
            let capture = scene.fleet.path("run.mcap");
            // Nothing is in it before the first second.
            if fs::metadata(&capture).is_ok_and(|found| found.len() > 0) {
                let again = scene.fleet.path("again.mcap");
                let recovered = output([Path::new("recover"), &capture, Path::new("-o"), &again]);
                assert!(matches!(code(&recovered), 0 | 3), "{row}: {}", stderr(&recovered));
                fs::remove_file(again).unwrap();
            }
            scene.clear();
        }
        // Objects that are younger than a third of a second may be under construction, so a run
        // that follows sooner leaves them to the one after it.
        eventually("the next run leaves nothing in shared memory", || {
            let mut next = start();
            next.wait_for_stderr(wanted);
            next.end(Signal::TERM);
            scene.wait_for_its_processes();
            scene.clear();
            assert!(scene.made().is_empty(), "{row}: {:?}", scene.made());
            scene.fleet.stale_files().is_empty()
        });
        if row.starts_with("demo") {
            let uid = rustix::process::getuid().as_raw();
            let folder = |pid: &u32| PathBuf::from(format!("/dev/shm/joulebus-{uid}-demo-{pid}"));
            // Of one that was killed before it had a config the folder is empty for a minute.
            let is_gone = |folder: PathBuf| below(&folder).is_empty();
            eventually("the next demo has removed the killed ones", || {
                output(["demo", "--robots", "2", "--duration", "1", "--no-capture"]).exits(0);
                pids.iter().map(folder).all(is_gone)
            });
        }
    }
}

#[test]
fn each_verb_is_in_one_of_the_tables_of_what_is_killed() {
    for verb in leaves() {
        let ends = !rows(&verb).is_empty();
        let runs = RUNS.iter().any(|(row, _)| calls(row, &verb));
        let long = LONG.split(", ").any(|name| name == verb);
        assert!(ends || runs || long, "{verb}");
    }
}
