//! The machine and the build of a measurement.

use std::collections::BTreeMap;
use std::fs;

use serde_json::Value;

/// The version pinned in the workspace.
const ICEORYX2: &str = "0.10.0";
/// Value of unknown properties.
const UNKNOWN: &str = "unknown";

/// Properties of a machine, a build or an input, by name.
pub(crate) type Facts = BTreeMap<String, Value>;

fn facts<const N: usize>(facts: [(&str, Value); N]) -> Facts {
    facts.map(|(name, value)| (name.to_owned(), value)).into()
}

/// This machine, as far as Linux reports it.
pub(crate) fn machine() -> Facts {
    let read = |path: &str| fs::read_to_string(path).unwrap_or_else(|_| UNKNOWN.to_owned());
    let setting = |path: &str| read(path).trim().to_owned();
    let cpuinfo = read("/proc/cpuinfo");
    let field = |name: &str| {
        let line = cpuinfo.lines().find(|line| line.starts_with(name));
        line.and_then(|line| line.split_once(':')).map_or(UNKNOWN, |(_, value)| value.trim())
    };
    let cpu = "/sys/devices/system/cpu";
    let boost = setting(&format!("{cpu}/cpufreq/boost"));
    let turbo = turbo(&boost, &setting(&format!("{cpu}/intel_pstate/no_turbo")));
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    facts([
        ("processor", field("model name").into()),
        ("processors", processors.into()),
        ("kernel", setting("/proc/sys/kernel/osrelease").into()),
        ("governor", setting(&format!("{cpu}/cpu0/cpufreq/scaling_governor")).into()),
        ("turbo", turbo.into()),
        ("virtual_machine", field("flags").split(' ').any(|flag| flag == "hypervisor").into()),
    ])
}

/// This program. Its target's CPU features are those of the whole program: kernels are dispatched
/// at run time.
pub(crate) fn build() -> Facts {
    let profile = if cfg!(debug_assertions) { "dev" } else { "release" };
    facts([
        ("joulebus", env!("CARGO_PKG_VERSION").into()),
        ("rustc", env!("BENCH_RUSTC").into()),
        ("iceoryx2", ICEORYX2.into()),
        ("profile", format!("{profile}, opt-level {}", env!("BENCH_OPT_LEVEL")).into()),
        ("target", env!("BENCH_TARGET").into()),
        ("target_features", env!("BENCH_TARGET_FEATURES").into()),
    ])
}

/// The two drivers report it with opposite meanings.
fn turbo(boost: &str, no_turbo: &str) -> &'static str {
    match (boost, no_turbo) {
        ("1", _) | (_, "0") => "on",
        ("0", _) | (_, "1") => "off",
        _ => UNKNOWN,
    }
}

/// Anonymous memory of this process: neither files nor shared memory. `None` if unknown.
pub(crate) fn anonymous_bytes() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
    let kilobytes: u64 = line.trim().trim_end_matches(" kB").parse().ok()?;
    Some(kilobytes * 1024)
}
