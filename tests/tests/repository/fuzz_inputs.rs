//! Every seed of the fuzz targets and every input found by fuzzing, on stable Rust: nothing panics,
//! the assertions of each target hold, and each target accepts some of them.

#[path = "../../../fuzz/src/lib.rs"]
#[allow(dead_code, unreachable_pub, reason = "the fuzz targets use the rest")]
mod joulebus_fuzz;

use std::path::{Path, PathBuf};

use joulebus_fuzz::{TARGETS, seeds};

fn directory() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/seeds")
}

#[test]
fn every_target_accepts_some_of_its_seeds() {
    for target in TARGETS {
        let (mut inputs, mut accepted) = (0, 0);
        for file in std::fs::read_dir(directory().join(target.seeds)).unwrap() {
            let bytes = std::fs::read(file.unwrap().path()).unwrap();
            inputs += 1;
            accepted += usize::from(target.run(&bytes));
        }
        println!("figure: {}: {inputs} inputs, {accepted} accepted", target.name);
        assert!(accepted > 0, "{}: none of {inputs} is accepted", target.name);
    }
}

#[test]
fn newly_generated_seeds_are_accepted() {
    for target in TARGETS {
        let seeds = seeds::seeds();
        let mut own = seeds.iter().filter(|(directory, _, _)| *directory == target.seeds);
        assert!(own.any(|(_, _, bytes)| target.run(bytes)), "{}", target.name);
    }
}

#[test]
#[ignore = "regenerates fuzz/seeds after a change of a format"]
fn write_the_seeds() {
    seeds::write(&directory()).unwrap();
}
