//! Commands that a report proposes run as they are printed, in the state that they are printed in.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use joulebus_config::Config;
use joulebus_testkit::{assert_contains, lab_beside, left_behind};

use super::fleet::{Exits as _, Program, code, stderr, stdout};

/// Files that propose commands. Each has a walk in this file.
const SITES: [&str; 2] = ["lab/program/src/config_init.rs", "lab/train/src/report.rs"];

#[test]
fn every_place_that_proposes_commands_has_a_walk() {
    let crates = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let (mut folders, mut found) = (vec![crates.clone()], Vec::new());
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let is_source = path.components().any(|part| part.as_os_str() == "src");
            if path.is_dir() && !path.ends_with("tests") && !path.ends_with("target") {
                folders.push(path);
            } else if is_source
                && path.extension().is_some_and(|ending| ending == "rs")
                && fs::read_to_string(&path).unwrap().contains("\"next:\"")
            {
                let relative = path.strip_prefix(&crates).unwrap();
                found.push(relative.display().to_string());
            }
        }
    }
    found.sort();
    assert_eq!(found, SITES);
}

/// A user's empty home.
struct Home {
    folder: tempfile::TempDir,
    ran: Vec<String>,
}

impl Home {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap(), ran: Vec::new() }
    }

    fn shell(&self, line: &str) -> Command {
        let program = Path::new(env!("CARGO_BIN_EXE_joulebus"));
        let _ = lab_beside(env!("CARGO_BIN_EXE_joulebus"));
        let path = std::env::var("PATH").unwrap();
        let mut command = Command::new("sh");
        command
            .args(["-c", &format!("exec {line}")])
            .current_dir(self.folder.path())
            .env("HOME", self.folder.path())
            .env("XDG_STATE_HOME", self.folder.path().join("state"))
            .env("PATH", format!("{}:{path}", program.parent().unwrap().display()))
            .env_remove("JOULEBUS_LOG");
        command
    }

    /// Runs a line, and everything that it proposes.
    fn walk(&mut self, line: &str) -> String {
        let made = self.shell(line).output().unwrap();
        assert_eq!(code(&made), 0, "{line}: {}", stderr(&made));
        self.ran.push(line.to_owned());
        let printed = stdout(&made);
        let proposed = printed.lines().skip_while(|line| *line != "next:").skip(1);
        let proposed: Vec<String> = proposed.map(|line| line.trim().to_owned()).collect();
        let fleets = self.own_domains();
        let mut worker = None;
        for next in &proposed {
            if next.starts_with("joulebus run ") {
                let mut started = Program::start(self.shell(next));
                started.wait_for_stderr("ready:");
                worker = Some(started);
                self.ran.push(next.clone());
            } else {
                self.walk(next);
            }
        }
        drop(worker);
        for (prefix, root) in fleets {
            for path in left_behind(&prefix, &root) {
                let _ = fs::remove_file(&path).or_else(|_| fs::remove_dir_all(&path));
            }
        }
        printed
    }

    /// Gives the fleets that were written domains of this test: prefixes and roots.
    fn own_domains(&self) -> Vec<(String, PathBuf)> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let default = "root = \"/dev/shm/joulebus-{uid}\"";
        let mut own = Vec::new();
        for entry in fs::read_dir(self.folder.path()).unwrap() {
            let fleet = entry.unwrap().path().join("fleet.toml");
            let Ok(text) = fs::read_to_string(&fleet) else {
                continue;
            };
            if text.contains(default) {
                let number = NUMBER.fetch_add(1, Ordering::Relaxed);
                let root = format!("/dev/shm/jbnext-{}-{number}", std::process::id());
                fs::write(&fleet, text.replace(default, &format!("root = {root:?}"))).unwrap();
                let domain = Config::load(&fleet).unwrap().domain().unwrap();
                own.push((domain.shm_prefix().to_owned(), PathBuf::from(root)));
            }
        }
        own
    }

    fn write(&self, name: &str, header: &str, row: impl Fn(u32) -> String, rows: u32) {
        let path = self.folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let lines: Vec<String> = (0..rows).map(row).collect();
        fs::write(path, format!("{header}\n{}\n", lines.join("\n"))).unwrap();
    }
}

/// Load, A, and speed, m/s, of a robot in a row.
fn driven(row: u32, seed: u32) -> (f64, f64) {
    let step = f64::from(row) + 1_000.0 * f64::from(seed);
    let load_a = 1.5 + 0.2 * (0.07 * step).sin() + 0.05 * (2.9 * step).cos();
    (load_a, 0.2 + 0.1 * (0.03 * step).sin())
}

/// Columns of other names, the current of ROS's sign, in a folder below the one that is named.
#[test]
fn from_logs_with_names_of_their_own_to_a_worker() {
    let mut home = Home::new();
    for run in 0..4 {
        let row = |row| {
            let (load_a, v) = driven(row, run);
            let volt = 24.0 - 0.1 * load_a;
            format!("{},{volt:.4},{:.4},{v:.3},{:.3}", f64::from(row) / 200.0, -load_a, 0.1 * v)
        };
        home.write(&format!("runs/day/run{run}.csv"), "t,u,i,v_cmd,omega_cmd", row, 400);
    }
    let reading = "--map time=t,voltage_V=u,current_A=i --current discharge-negative";
    home.walk(&format!("joulebus config init --from runs {reading} -o lab"));
    let verbs = |verb: &str| home.ran.iter().filter(|line| line.contains(verb)).count();
    // Train's are a second config with the model.
    for (verb, count) in
        [("train trials", 1), ("eval", 1), ("config init", 2), ("publish trial", 2)]
    {
        assert_eq!(verbs(verb), count, "{verb}: {:#?}", home.ran);
    }
    let platform = fs::read_to_string(home.folder.path().join("lab/platforms/runs.toml")).unwrap();
    assert_contains(
        &platform,
        ["map = \"time=t,voltage_V=u,current_A=i\"", "current = \"discharge-negative\""],
    );
    // Every verb that reads the config reads the recordings as it was configured once.
    for line in [
        "joulebus data check runs --platform runs --config lab/fleet.toml",
        "joulebus eval runs --config lab/fleet.toml --resamples 0",
        "joulebus report runs --platform runs --config lab/fleet.toml --model builtin:gternal-sim -o page",
    ] {
        let printed = home.shell(line).output().unwrap().exits(0);
        assert!(!stderr(&printed).contains("implausible"), "{line}: {}", stderr(&printed));
    }
}

/// Several robots in one file, a name with a space, a finding that is accepted, a model at once.
#[test]
fn from_one_file_of_several_robots_to_a_trained_model_and_its_skill() {
    let mut home = Home::new();
    let robots = 5;
    let row = |row: u32| {
        let (robot, step) = (row % robots, row / robots);
        let (load_a, v) = driven(step, robot);
        // A monitor of the current that is dead, beside a power that works.
        format!("{robot},{},{:.4},0,{v:.3},{:.3}", f64::from(step) / 200.0, 24.0 * load_a, 0.1 * v)
    };
    let header = "robot_id,time,power_W,current_A,v_cmd,omega_cmd";
    home.write("my logs/fleet.csv", header, row, 400 * robots);
    let printed =
        home.walk("joulebus config init --from 'my logs' --train --accept constant -o 'my lab'");
    assert_contains(
        &printed,
        ["models/my_logs.safetensors", "held out, ", "skill ", "against the last reading"],
    );
    let platform = home.folder.path().join("my lab/platforms/my_logs.toml");
    assert_contains(&fs::read_to_string(platform).unwrap(), ["accept = \"constant\""]);
    // Whole robots are held out of one file.
    home.walk("joulebus train trials 'my logs' --accept constant --out m.safetensors");
    let model = home.shell("joulebus model info 'my lab/models/my_logs.safetensors'");
    assert_contains(&stdout(&{ model }.output().unwrap()), ["period        0.005"]);
}
