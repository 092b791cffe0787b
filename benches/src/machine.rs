//! The machine and the build of a measurement.

use std::fmt;
use std::fs;

use serde::{Deserialize, Serialize};

/// The version pinned in the workspace.
const ICEORYX2: &str = "0.10.0";
/// Value of unknown properties.
const UNKNOWN: &str = "unknown";

/// The machine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machine {
    /// Model name of the processor.
    pub processor: String,
    /// Processors that this process may use.
    pub processors: usize,
    /// Kernel of the operating system.
    pub kernel: String,
    /// Frequency governor, if known.
    pub governor: String,
    /// State of frequency boost, if known: `on`, `off`.
    pub turbo: String,
    /// True if it is a virtual machine, whose figures are noisy.
    pub virtual_machine: bool,
}

/// The build.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Build {
    /// Version of joulebus.
    pub joulebus: String,
    /// Version of the compiler.
    pub rustc: String,
    /// Version of iceoryx2.
    pub iceoryx2: String,
    /// `release` or `dev`, with the optimisation level.
    pub profile: String,
    /// Target triple.
    pub target: String,
    /// CPU features enabled for the whole program. Kernels are dispatched at run time.
    pub target_features: String,
}

impl Machine {
    /// This machine, as far as Linux reports it.
    pub fn here() -> Self {
        let cpuinfo = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let field = |name: &str| {
            let line = cpuinfo.lines().find(|line| line.starts_with(name))?;
            Some(line.split_once(':')?.1.trim().to_owned())
        };
        let flags = field("flags").unwrap_or_default();
        let cpu = "/sys/devices/system/cpu";
        Self {
            processor: field("model name").unwrap_or_else(|| UNKNOWN.to_owned()),
            processors: std::thread::available_parallelism().map_or(1, usize::from),
            kernel: setting("/proc/sys/kernel/osrelease"),
            governor: setting(&format!("{cpu}/cpu0/cpufreq/scaling_governor")),
            turbo: turbo(
                &setting(&format!("{cpu}/cpufreq/boost")),
                &setting(&format!("{cpu}/intel_pstate/no_turbo")),
            ),
            virtual_machine: flags.split_whitespace().any(|flag| flag == "hypervisor"),
        }
    }
}

impl Build {
    /// This program.
    pub fn here() -> Self {
        let profile = if cfg!(debug_assertions) { "dev" } else { "release" };
        Self {
            joulebus: env!("CARGO_PKG_VERSION").to_owned(),
            rustc: env!("BENCH_RUSTC").to_owned(),
            iceoryx2: ICEORYX2.to_owned(),
            profile: format!("{profile}, opt-level {}", env!("BENCH_OPT_LEVEL")),
            target: env!("BENCH_TARGET").to_owned(),
            target_features: env!("BENCH_TARGET_FEATURES").to_owned(),
        }
    }
}

fn setting(path: &str) -> String {
    fs::read_to_string(path).map_or_else(|_| UNKNOWN.to_owned(), |text| text.trim().to_owned())
}

/// The two drivers report it with opposite meanings.
fn turbo(boost: &str, no_turbo: &str) -> String {
    match (boost, no_turbo) {
        ("1", _) | (_, "0") => "on",
        ("0", _) | (_, "1") => "off",
        _ => UNKNOWN,
    }
    .to_owned()
}

impl fmt::Display for Machine {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { processor, processors, kernel, governor, turbo, virtual_machine } = self;
        write!(
            out,
            "{processor}, {processors} processors, Linux {kernel}, governor {governor}, turbo {turbo}"
        )?;
        if *virtual_machine {
            write!(out, ", virtual machine")?;
        }
        Ok(())
    }
}

impl fmt::Display for Build {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { joulebus, rustc, iceoryx2, profile, target, target_features } = self;
        write!(
            out,
            "joulebus {joulebus}, {rustc}, iceoryx2 {iceoryx2}, {profile}, {target} \
             ({target_features})"
        )
    }
}

/// Anonymous memory of this process: neither files nor shared memory. `None` if unknown.
pub(crate) fn anonymous_bytes() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
    let kilobytes: u64 = line.trim().trim_end_matches(" kB").parse().ok()?;
    Some(kilobytes * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_drivers_are_supported() {
        for (boost, no_turbo, found) in [
            ("1", UNKNOWN, "on"),
            ("0", UNKNOWN, "off"),
            (UNKNOWN, "0", "on"),
            (UNKNOWN, "1", "off"),
            (UNKNOWN, UNKNOWN, UNKNOWN),
        ] {
            assert_eq!(turbo(boost, no_turbo), found);
        }
    }

    #[test]
    fn the_build_names_its_compiler() {
        let build = Build::here();
        assert!(build.rustc.starts_with("rustc 1."), "{}", build.rustc);
        assert!(build.target.contains('-'), "{}", build.target);
        let manifest = include_str!("../../Cargo.toml");
        assert!(manifest.contains(&format!("iceoryx2 = {{ version = \"={}\"", build.iceoryx2)));
    }
}
