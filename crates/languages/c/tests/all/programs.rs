//! The C library and its C++ layer, as users get them: installed, found by a compiler, run beside a
//! real worker in real shared memory. Without `cc` and `c++` the tests skip, and fail with CI=true.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::{fs, thread};

use joulebus_config::{Config, builtin_model};
use joulebus_plan_server::{PlanServer, Statements};
use joulebus_predictor::{INPUTS, Model, Network};
use joulebus_predictor_worker::Worker;
use joulebus_testkit::{Child, Ended, Member, PATIENCE, eventually, send_to_test};
use rustix::process::Signal;
use tempfile::TempDir;

const CONFIG: &str = "JOULEBUS_MEMBER_CONFIG";

pub(crate) fn member() {
    let Some(path) = std::env::var_os(CONFIG) else {
        return;
    };
    let config = Config::load(path).unwrap();
    let (stated, statements, taken) = Statements::channel();
    let server = PlanServer::start(&config, Some(stated)).unwrap();
    let mut worker = Worker::open(&config).unwrap();
    worker.take_statements_from(statements, taken);
    server.serve();
    server.wait_until_open();
    send_to_test("ready");
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            // Until the test asks for it, or has ended.
            let _ = std::io::stdin().lines().next();
            stop.store(true, Ordering::Relaxed);
        });
        while !stop.load(Ordering::Relaxed) {
            worker.poll().unwrap();
        }
    });
    let not_finite = worker.finish().samples_dropped.get("NotFinite").copied();
    let _ = server.finish();
    send_to_test(not_finite.unwrap_or(0));
}

/// A fleet of its own, with place for many planners.
struct Fleet {
    folder: TempDir,
    prefix: String,
}

impl Fleet {
    fn new() -> Self {
        static FLEETS: AtomicU32 = AtomicU32::new(0);
        let number = FLEETS.fetch_add(1, Ordering::Relaxed);
        // All of one length, so that none begins with another.
        let process = std::process::id() % 0x1_0000;
        let prefix = format!("jc{:02x}{process:04x}", number % 0x100);
        let folder = TempDir::with_prefix_in("joulebus-c-", "/dev/shm").unwrap();
        let root = folder.path().join("domain");
        let text = format!(
            r#"
            [fleet]
            name = "c"
            capacity = 100
            [domain]
            root = "{}"
            prefix = "{prefix}"
            [intake]
            max_sources = 8
            [readers]
            max_planners = 16
            [[platform]]
            file = "builtin:gternal"
            robots = ["0-99"]
            [platform.battery]
            capacity_wh = 5.0
            initial_soc_lo = 0.95
            "#,
            root.display()
        );
        fs::write(folder.path().join("fleet.toml"), text).unwrap();
        Self { folder, prefix }
    }

    fn config(&self) -> PathBuf {
        self.folder.path().join("fleet.toml")
    }

    fn worker(&self) -> Member {
        let mut command = Member::command();
        command.env(CONFIG, self.config());
        command.env("XDG_STATE_HOME", self.folder.path());
        let mut worker = Member::spawn("worker", command);
        assert_eq!(worker.next_line(), "ready");
        worker
    }

    /// A program beside the test.
    fn start(&self, program: &Path) -> Child {
        let mut command = Command::new(program);
        command.arg(self.config());
        Child::spawn(&program.display().to_string(), command)
    }

    fn run(&self, program: &Path, more: &[&str]) -> Ended {
        let mut command = Command::new(program);
        command.arg(self.config()).args(more);
        let ended = Child::spawn(&program.display().to_string(), command).wait();
        assert_eq!(ended.code(), Some(0), "{ended:#?}");
        ended
    }

    fn objects(&self) -> Vec<PathBuf> {
        let entries = fs::read_dir("/dev/shm").unwrap().flatten();
        let is_ours = |path: &PathBuf| {
            let name = path.file_name().unwrap_or_default();
            name.to_string_lossy().starts_with(&self.prefix)
        };
        entries.map(|entry| entry.path()).filter(is_ours).collect()
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        let left = self.objects();
        for object in &left {
            let _ = fs::remove_file(object);
        }
        if !thread::panicking() {
            assert_eq!(left, Vec::<PathBuf>::new(), "left behind");
        }
    }
}

/// The library in a prefix of its own, and programs that use it.
struct Installed {
    folder: TempDir,
}

impl Installed {
    /// `None` without compilers.
    fn new() -> Option<Self> {
        for compiler in ["cc", "c++"] {
            let found = Command::new(compiler).arg("--version").output();
            if !found.is_ok_and(|output| output.status.success()) {
                eprintln!("skipped: no {compiler}");
                let required = std::env::var("CI").as_deref() == Ok("true");
                assert!(!required, "CI=true needs {compiler}");
                return None;
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let deps = std::env::current_exe().unwrap();
        let mut install = Command::new(root().join("tools/install_c.sh"));
        install.arg("--prefix").arg(folder.path().join("prefix"));
        install.arg("--from").arg(deps.parent().unwrap());
        succeeds(&mut install);
        Some(Self { folder })
    }

    /// Compiles a source of the repository with all warnings, against the shared library.
    fn program(&self, source: &str, more: &[&str]) -> PathBuf {
        let binary = self.folder.path().join(source.replace(['/', '.'], "-"));
        let (compiler, standard) = match Path::new(source).extension().unwrap().to_str() {
            Some("c") => ("cc", "-std=gnu11"),
            _ => ("c++", "-std=c++17"),
        };
        let prefix = self.folder.path().join("prefix");
        let (include, library) = (prefix.join("include"), prefix.join("lib"));
        let mut compile = Command::new(compiler);
        compile.args([standard, "-O1", "-g", "-Wall", "-Wextra", "-Werror", "-I"]);
        compile.arg(include).arg(root().join(source)).arg("-o").arg(&binary);
        compile.arg("-L").arg(&library).arg("-ljoulebus").args(more);
        compile.arg(format!("-Wl,-rpath,{}", library.display()));
        succeeds(&mut compile);
        binary
    }

    /// A source of robots 0 to 7.
    fn controller(&self) -> PathBuf {
        self.program("examples/c/controller.c", &[])
    }
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..")
}

fn succeeds(command: &mut Command) {
    let output = command.output().unwrap();
    let printed_text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}\n{printed_text}");
}

/// Reads lines of its output until one contains `part`.
fn until(child: &Child, read: &mut usize, part: &str) {
    loop {
        let lines = child.lines(*read, PATIENCE);
        let found = lines.iter().position(|line| line.contains(part));
        *read += found.map_or(lines.len(), |at| at + 1);
        match found {
            Some(_) => return,
            None => assert!(!lines.is_empty(), "no {part:?}: {}", child.tail()),
        }
    }
}

#[test]
fn misuse_is_refused_and_the_next_call_works() {
    let Some(installed) = Installed::new() else {
        return;
    };
    let source = "crates/languages/c/tests/programs/misuse.c";
    let program = installed.program(source, &["-pthread", "-lm"]);
    let fleet = Fleet::new();
    let mut worker = fleet.worker();
    let mut controller = fleet.start(&installed.controller());
    let printed_text = fleet.run(&program, &[]).text();
    let checks: usize = printed_text.trim_end_matches(" checks").parse().unwrap();
    assert!(checks > 150, "{checks}");
    controller.stop();
    // The sample that was not a number was refused by the worker, by its reason.
    assert_eq!(finished(&mut worker), "1");
}

/// Ends the worker. Returns its last line.
fn finished(worker: &mut Member) -> String {
    worker.send_line("end");
    let printed_text = worker.next_line();
    assert_eq!(worker.wait().code(), Some(0));
    printed_text
}

#[test]
fn the_cpp_layer_works_beside_a_worker_and_its_forecasts_have_the_bits_of_rust() {
    let Some(installed) = Installed::new() else {
        return;
    };
    let program = installed.program("crates/languages/c/tests/programs/layer.cpp", &["-pthread"]);
    let fleet = Fleet::new();
    let mut worker = fleet.worker();
    let mut controller = fleet.start(&installed.controller());
    let printed_text = fleet.run(&program, &[]).stdout;
    let (_, bytes) = builtin_model("gternal-sim").unwrap();
    let model = Model::Network(Network::from_safetensors(bytes).unwrap());
    let mut expected = Vec::new();
    for width in [11, INPUTS] {
        let value = |row: usize, feature: usize| match feature {
            0..6 => 0.01 * ((row + feature) % 13) as f32,
            _ => 3.0 + 0.1 * ((row * feature) % 17) as f32,
        };
        let known = |row, feature| {
            if feature < width { value(row, feature) } else { f32::NAN }
        };
        let row = |row| std::array::from_fn(|feature| known(row, feature));
        let rows: Vec<[f32; INPUTS]> = (0..150).map(row).collect();
        let mut power_w = vec![0.0; rows.len()];
        model.predict(&rows, &mut power_w);
        expected.extend(power_w.iter().map(|power_w| power_w.to_bits().to_string()));
    }
    assert_eq!(printed_text, expected);
    controller.stop();
    finished(&mut worker);
}

/// The examples of both languages. The worker is killed under a planner, and started again.
#[test]
fn the_examples_run_and_a_killed_worker_is_reported() {
    let Some(installed) = Installed::new() else {
        return;
    };
    for (controller, planner, wanted) in [
        ("examples/c/controller.c", "examples/c/planner.c", "8 of 8 robots will draw"),
        // Which asks with its twentieth frame.
        ("examples/cpp/controller.cpp", "examples/cpp/planner.cpp", "a trip of"),
    ] {
        let fleet = Fleet::new();
        let worker = fleet.worker();
        let mut source = fleet.start(&installed.program(controller, &[]));
        let mut reader = fleet.start(&installed.program(planner, &[]));
        let mut read = 0;
        until(&reader, &mut read, wanted);
        worker.kill();
        until(&reader, &mut read, "the worker has ended");
        // It ends after ten seconds without a frame, within which a worker may not start.
        reader.signal(Signal::STOP);
        let mut again = fleet.worker();
        reader.signal(Signal::CONT);
        until(&reader, &mut read, "tick ");
        source.stop();
        let printed_text = reader.stop().text();
        assert!(printed_text.ends_with(" 2 workers"), "{printed_text}");
        finished(&mut again);
    }
}

/// Lines of the adapter about charges and the tasks planned after them.
const CHARGES: [&str; 5] = [
    "a charge as planned: go on",
    "a charge that is cancelled at once: plan again",
    "a charge that ends with an unknown share: plan again",
    "a charge that is cancelled on the way: plan again",
    "a charge that is cancelled twice: go on",
];

/// A longer trajectory takes more of the battery. A time at rest and what is left are known too,
/// and a cancelled charge is noticed.
#[test]
fn the_adapter_answers_with_the_share_of_the_battery_that_a_trajectory_takes() {
    let Some(installed) = Installed::new() else {
        return;
    };
    let adapter = installed.program("examples/cpp/rmf_adapter.cpp", &[]);
    let fleet = Fleet::new();
    let mut worker = fleet.worker();
    let mut controller = fleet.start(&installed.controller());
    eventually("the robot's level is known", || {
        let printed_text = fleet.run(&adapter, &["7"]).stdout;
        let share = |line: &String| line.split(": ").nth(1)?.split(' ').next()?.parse().ok();
        let shares: Vec<f64> = printed_text.iter().filter_map(share).collect();
        // Three trajectories, a time at rest, and what is left.
        let [driven @ .., at_rest, left] = shares.as_slice() else { return false };
        driven.len() == 3
            && driven.windows(2).all(|pair| 0.0 < pair[0] && pair[0] < pair[1])
            && *at_rest > 0.0
            && (0.0..=100.0).contains(left)
            && CHARGES.into_iter().all(|line| printed_text.iter().any(|printed| printed == line))
    });
    controller.stop();
    finished(&mut worker);
}
