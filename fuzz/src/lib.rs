//! The fuzz targets: one function for each kind of untrusted input. Each asserts the invariants of
//! the result, not only the absence of panics, and returns whether the input was accepted.
//!
//! The programs in `fuzz_targets` run them under libFuzzer; `tests/tests/repository/fuzz_inputs.rs`
//! of the parent workspace runs every seed and every finding through them on stable.

mod capture;
mod config;
mod frames;
mod input;
mod keyframes;
mod model;
#[allow(dead_code)] // Its tests use more of it.
mod oracle;
mod questions;
mod ros;
pub mod seeds;
mod trials;

use joulebus_testkit::counting;

#[global_allocator]
static ALLOCATOR: counting::Counting = counting::Counting;

/// A fuzz target.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// Its name and the name of its program.
    pub name: &'static str,
    /// Directory of its seeds.
    pub seeds: &'static str,
    run: fn(&[u8]) -> bool,
    /// Maximum heap memory at any time, bytes.
    max_bytes: u64,
}

const fn of(name: &'static str, most_mib: u64, run: fn(&[u8]) -> bool) -> Target {
    Target { name, seeds: name, run, max_bytes: most_mib << 20 }
}

/// All targets.
pub const TARGETS: [Target; 11] = [
    of("config", 16, config::run),
    of("frames", 16, frames::run),
    of("import", 24, capture::import),
    of("keyframes", 16, keyframes::run),
    of("model", 16, model::run),
    of("questions", 16, questions::run),
    Target { seeds: "mcap", ..of("recover", 24, capture::recover) },
    of("ros", 16, ros::run),
    Target { seeds: "mcap", ..of("scan", 24, capture::scan) },
    of("trial_csv", 16, trials::csv),
    of("trial_npy", 16, trials::npy),
];

impl Target {
    /// Runs one input; returns whether it was accepted.
    ///
    /// # Panics
    /// The input violates an assertion of the target, or exceeds its memory limit.
    pub fn run(&self, bytes: &[u8]) -> bool {
        let (accepted, peak_bytes) = counting::peak(|| (self.run)(bytes));
        let (name, most) = (self.name, self.max_bytes);
        assert!(peak_bytes <= most, "{name}: {peak_bytes} bytes, allowed are {most}");
        accepted
    }
}

/// The target with this name.
///
/// # Panics
/// There is none.
pub fn target(name: &str) -> Target {
    let found = TARGETS.into_iter().find(|target| target.name == name);
    found.unwrap_or_else(|| panic!("no target {name:?}"))
}

/// The program of a target: with cargo-fuzz the libFuzzer driver, otherwise a program that runs
/// the files in its arguments, so that a finding can be reproduced without nightly.
#[macro_export]
macro_rules! program {
    ($name:literal) => {
        #[cfg(fuzzing)]
        libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
            let _ = joulebus_fuzz::target($name).run(bytes);
        });

        #[cfg(not(fuzzing))]
        fn main() -> std::io::Result<()> {
            let target = joulebus_fuzz::target($name);
            for path in std::env::args_os().skip(1).map(std::path::PathBuf::from) {
                let accepted = target.run(&std::fs::read(&path)?);
                println!("{}: {}", path.display(), if accepted { "accepted" } else { "refused" });
            }
            Ok(())
        }
    };
}
