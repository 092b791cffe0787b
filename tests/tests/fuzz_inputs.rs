//! Every seed of the fuzz targets, and every input that fuzzing found, on stable: nothing panics,
//! what each target asserts holds, and each target accepts some of them.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on ends")]

#[path = "../../fuzz/src/lib.rs"]
#[allow(
    dead_code,
    unreachable_pub,
    reason = "the programs that are fuzzed use the rest"
)]
mod joulebus_fuzz;

use std::path::{Path, PathBuf};

use joulebus_fuzz::{TARGETS, seeds};

fn directory() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/seeds")
}

#[test]
fn every_target_takes_its_seeds() {
    for target in TARGETS {
        let (mut inputs, mut accepted) = (0, 0);
        for file in std::fs::read_dir(directory().join(target.seeds)).unwrap() {
            let bytes = std::fs::read(file.unwrap().path()).unwrap();
            inputs += 1;
            accepted += usize::from(target.run(&bytes));
        }
        println!(
            "figure: {}: {inputs} inputs, {accepted} accepted",
            target.name
        );
        assert!(
            accepted > 0,
            "{}: none of {inputs} is accepted",
            target.name
        );
    }
}

#[test]
fn seeds_that_are_written_now_are_accepted_too() {
    for target in TARGETS {
        let seeds = seeds::seeds();
        let mut own = seeds
            .iter()
            .filter(|(directory, _, _)| *directory == target.seeds);
        assert!(
            own.any(|(_, _, bytes)| target.run(bytes)),
            "{}",
            target.name
        );
    }
}

#[test]
#[ignore = "writes fuzz/seeds anew; for a change of a format"]
fn write_the_seeds() {
    seeds::write(&directory()).unwrap();
}
