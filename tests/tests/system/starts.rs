//! What a start needs. That it is refused with the bytes needed and free is tested by `full_memory`
//! and in `bus` (`does_not_fit`).

use std::process::Command;

use joulebus_bus::{CapacityError, Ports, check_capacity};
use joulebus_config::Config;
use joulebus_testkit::assert_contains;
use joulebus_tests::{Arena, Child, Setup, figure};

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
