//! Rows 20 and 24: impossible configurations are refused at the start with a message, and leave no
//! files.

use std::process::Command;

use joulebus_bus::{CapacityError, Ports, check_capacity};
use joulebus_config::Config;
use joulebus_testkit::assert_contains;
use joulebus_tests::{Arena, Child, Ended, Setup, figure, program};

/// A defect of the config, its form (a line replaced, or lines added), and parts that the message
/// must contain.
struct Wrong {
    what: &'static str,
    from: &'static str,
    to: &'static str,
    shows: &'static [&'static str],
}

const WRONG: &[Wrong] = &[
    Wrong {
        what: "a typo in a key",
        from: "capacity =",
        to: "capasity =",
        shows: &["fleet.toml:3", "capasity", "fleet.capacity", "robots"],
    },
    Wrong {
        what: "a typo in a section",
        from: "[tick]",
        to: "[tik]",
        shows: &["fleet.toml:7", "tik", "tick"],
    },
    Wrong {
        what: "a typo in a platform's key",
        from: "stale_after_s =",
        to: "stale_after =",
        shows: &["stale_after", "stale_after_s"],
    },
    Wrong {
        what: "another unit",
        from: "deadline_ms =",
        to: "deadline_s =",
        shows: &["deadline_s", "deadline_ms", "ms"],
    },
    Wrong {
        what: "out of range",
        from: "rate_hz = 200.0",
        to: "rate_hz = 2000.0",
        shows: &["fleet.toml:9", "2000", "1000", "Hz"],
    },
    Wrong {
        what: "not a number",
        from: "rate_hz = 200.0",
        to: "rate_hz = nan",
        shows: &["fleet.toml:9", "NaN", "0.1 to 1000", "Hz"],
    },
    Wrong {
        what: "text for a number",
        from: "rate_hz = 200.0",
        to: "rate_hz = \"200 Hz\"",
        shows: &["fleet.toml:9", "rate_hz"],
    },
    Wrong {
        what: "an unknown choice",
        from: "\"on_frame\"",
        to: "\"on_fram\"",
        shows: &["on_fram", "on_frame"],
    },
    Wrong {
        what: "a key twice",
        from: "policy =",
        to: "rate_hz = 1.0\npolicy =",
        shows: &["rate_hz"],
    },
    Wrong {
        what: "contradictory times",
        from: "leave_after_s = 60.0",
        to: "leave_after_s = 0.5",
        shows: &["leave_after_s", "stale_after_s", "0.5"],
    },
    Wrong { what: "not TOML", from: "[fleet]", to: "[fleet", shows: &["fleet.toml:1"] },
    Wrong {
        what: "an unknown built-in platform",
        from: "builtin:gternal",
        to: "builtin:gternel",
        shows: &["gternel", "gternal"],
    },
    Wrong {
        what: "a prefix in upper case",
        from: "\"jbt_\"",
        to: "\"JBT_\"",
        shows: &["prefix", "JBT_"],
    },
    Wrong {
        what: "an invalid robot range",
        from: "[\"0-99\"]",
        to: "[\"99-0\"]",
        shows: &["robots", "99-0"],
    },
];

#[test]
fn row_20_an_invalid_config_is_refused_with_line_key_nearest_key_and_unit_and_exit_code_2() {
    let arena = Arena::new(&Setup::default());
    let good = std::fs::read_to_string(arena.config()).unwrap();
    arena.worker().stop();
    let mut missed: Vec<String> = Vec::new();
    for wrong in WRONG {
        assert!(good.contains(wrong.from), "{}: {:?} in {good}", wrong.what, wrong.from);
        std::fs::write(arena.config(), good.replacen(wrong.from, wrong.to, 1)).unwrap();
        let mut check = Command::new(program("joulebus-under-test"));
        check.args(["config", "check"]).arg(arena.config());
        for (verb, command) in [
            ("run", arena.command(&["run"])),
            ("doctor", arena.command(&["doctor"])),
            ("config check", check),
        ] {
            let ended = Child::spawn(verb, command).wait();
            if ended.code() != Some(2) {
                missed.push(format!("{}: {verb}: {ended:?}", wrong.what));
            }
            let errors = ended.errors();
            for part in wrong.shows {
                if !errors.contains(part) {
                    missed.push(format!("{}: {verb}: no {part:?} in {errors}", wrong.what));
                }
            }
        }
        assert_eq!(arena.stale_files(), Vec::<std::path::PathBuf>::new(), "{}", wrong.what);
    }
    assert!(missed.is_empty(), "{}", missed.join("\n"));
    figure(
        "row 20, silent acceptances",
        format_args!("0 of {} wrong configs, each by three verbs", WRONG.len()),
    );
}

#[test]
fn row_24_too_little_shared_memory_is_refused_at_the_start_with_needed_and_free_bytes() {
    let arena = Arena::new(&Setup {
        capacity: 1_000_000,
        max_planners: 256,
        max_sources: 256,
        buffer_frames: 256,
        ..Setup::default()
    });
    let refused = |name: &str, ended: &Ended| {
        assert_eq!(ended.signal(), None, "{name}: no SIGBUS: {ended:?}");
        assert_eq!(ended.code(), Some(1), "{name}: {ended:?}");
        let errors = ended.errors();
        let words: Vec<&str> = errors.split_whitespace().collect();
        let before = |word: &str| -> u64 {
            let at = words.iter().position(|found| *found == word).expect(word);
            words[at - 1].parse().unwrap_or_else(|_| words[at - 2].parse().expect(&errors))
        };
        let (needed, free) = (before("needed,"), before("free"));
        assert!(needed > free && free > 0, "{name}: {errors}");
        (needed, free)
    };
    let (needed, free) = refused("worker", &arena.run(&["run"]));
    let mut source = Child::spawn("source", arena.probe(&["source", "fleet"]));
    refused("source", &source.wait());
    assert_eq!(arena.stale_files(), Vec::<std::path::PathBuf>::new());
    figure("row 24, SIGBUS", format_args!("0; worker refused: {needed} bytes needed, {free} free"));
}

#[test]
fn the_default_fleet_fits_into_what_a_container_has() {
    // Docker's default for /dev/shm.
    const CONTAINER_BYTES: u64 = 64 << 20;
    let config = Config::load(concat!(env!("CARGO_MANIFEST_DIR"), "/../configs/fleet.toml"));
    let ports = Ports { sources: 2, workers: 1, planners: 4 };
    let needed = match check_capacity(&config.unwrap().limits(), ports) {
        Ok(report) => report.needed_bytes,
        Err(CapacityError::Memory { needed, .. }) => needed,
        Err(error) => panic!("{error}"),
    };
    assert!(needed <= CONTAINER_BYTES, "{needed} bytes");
    figure("the default fleet", format_args!("{needed} bytes with two sources and four planners"));
}

#[test]
fn without_the_right_to_lock_memory_the_worker_names_limit_and_remedy_and_works() {
    let arena = Arena::new(&Setup {
        more: "[worker]\nmemory = \"locked\"\n".to_owned(),
        ..Setup::default()
    });
    let command = arena.worker_command();
    let mut limited = Command::new("setpriv");
    // A user's process has the capability no more than one of root here.
    limited.args(["--inh-caps=-ipc_lock", "--bounding-set=-ipc_lock"]);
    limited.args(["prlimit", "--memlock=65536:65536"]);
    if Command::new("setpriv").arg("--dump").output().is_err() {
        return println!("skipped: setpriv is not installed");
    }
    limited.arg(command.get_program()).args(command.get_args());
    limited.env("XDG_STATE_HOME", arena.state()).env_remove("STATE_DIRECTORY");
    let mut worker = Child::spawn("worker", limited).at_drop(Child::stop);
    let line = worker.wait_for_line("memory was not locked");
    assert_contains(
        &line,
        "RLIMIT_MEMLOCK is 64 kB | LimitMEMLOCK=infinity | worker.memory".split(" | "),
    );
    worker.wait_for_line("ready:");
    let mut source = arena.source("fleet");
    let mut planner = arena.planner();
    let frame = [joulebus_tests::sample(3, 0, 1_000_000)];
    source.send(&frame);
    planner.answered(&frame);
}
