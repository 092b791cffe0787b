//! What is fuzzed: a function for each kind of input that comes from elsewhere. Each asserts what
//! the input has to keep, not only that nothing panics, and says whether the input got through the
//! checks.
//!
//! The programs in `fuzz_targets` give them to libFuzzer; `tests/tests/fuzz_inputs.rs` of the
//! workspace above runs every seed and every input found so far through them, on stable.

mod capture;
mod checkpoints;
mod config;
#[path = "../../tests/counting.rs"]
mod counting;
mod frames;
mod input;
mod keyframes;
mod model;
#[allow(dead_code)] // Its tests use more of it.
mod oracle;
pub mod seeds;
mod trials;

/// Something to be fuzzed.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// Its name, and that of its program.
    pub name: &'static str,
    /// Directory of its seeds.
    pub seeds: &'static str,
    run: fn(&[u8]) -> bool,
    /// Most memory that may be taken at the same time, bytes.
    most_bytes: u64,
}

const fn of(name: &'static str, most_mib: u64, run: fn(&[u8]) -> bool) -> Target {
    Target {
        name,
        seeds: name,
        run,
        most_bytes: most_mib << 20,
    }
}

/// All targets. A scan holds a record of at most 64 MiB, an archive at most 32 MiB.
pub const TARGETS: [Target; 12] = [
    of("archive", 96, checkpoints::archive),
    of("checkpoint", 96, checkpoints::whole),
    of("config", 16, config::run),
    of("frames", 16, frames::run),
    of("import", 24, capture::import),
    of("keyframes", 16, keyframes::run),
    of("model", 16, model::run),
    of("pickle", 96, checkpoints::pickle),
    Target {
        seeds: "mcap",
        ..of("recover", 24, capture::recover)
    },
    Target {
        seeds: "mcap",
        ..of("scan", 24, capture::scan)
    },
    of("trial_csv", 16, trials::csv),
    of("trial_npy", 16, trials::npy),
];

impl Target {
    /// Runs one input; returns whether it was accepted.
    ///
    /// # Panics
    /// When the input breaks what the target asserts, or takes more memory than it may.
    #[must_use]
    pub fn run(&self, bytes: &[u8]) -> bool {
        let (accepted, peak_bytes) = counting::peak(|| (self.run)(bytes));
        let (name, most) = (self.name, self.most_bytes);
        assert!(
            peak_bytes <= most,
            "{name}: {peak_bytes} bytes, allowed are {most}"
        );
        accepted
    }
}

/// The target of that name.
///
/// # Panics
/// When there is none.
#[must_use]
pub fn target(name: &str) -> Target {
    let found = TARGETS.into_iter().find(|target| target.name == name);
    found.unwrap_or_else(|| panic!("no target {name:?}"))
}

/// The program of a target: under cargo-fuzz libFuzzer's, otherwise one that runs the files it is
/// given, so that a finding can be looked at without nightly.
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
                println!(
                    "{}: {}",
                    path.display(),
                    if accepted { "accepted" } else { "refused" }
                );
            }
            Ok(())
        }
    };
}
