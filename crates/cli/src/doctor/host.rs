//! Versions and clocks.

use std::time::Duration;

use joulebus_wire::SCHEMA_VERSION;
use rustix::thread::current_timer_slack;
use rustix::time::{ClockId, Timespec, clock_getres, clock_gettime};

use super::{Check, Status};

/// The version pinned in the workspace. Another minor version cannot join the same shared memory.
const ICEORYX2: &str = "0.10.0";
/// 2020-01-01: an earlier wall clock has not been set.
const NOT_SET_BEFORE_S: u64 = 1_577_836_800;
/// Maximum resolution of the monotonic clock: a coarser one distorts latencies.
const COARSE: Duration = Duration::from_micros(1);
/// Linux's default timer slack of a thread.
const USUAL_SLACK_NS: u64 = 50_000;

/// Versions that all processes of a fleet must share.
pub(super) fn versions() -> Check {
    let found = format!(
        "joulebus {}, iceoryx2 {ICEORYX2}, schema {SCHEMA_VERSION}",
        env!("CARGO_PKG_VERSION"),
    );
    Check::ok("versions", found)
}

pub(super) fn clocks() -> Vec<Check> {
    vec![monotonic(), wall(), slack()]
}

/// The clock used for intervals.
fn monotonic() -> Check {
    let name = "clock";
    let resolution = duration(clock_getres(ClockId::Monotonic));
    let source =
        std::fs::read_to_string("/sys/devices/system/clocksource/clocksource0/current_clocksource");
    let source = source.map_or_else(|_| "unknown".to_owned(), |text| text.trim().to_owned());
    let found = format!("monotonic, resolution {resolution:?}, source {source}");
    if resolution > COARSE {
        let remedy = "enable high-resolution timers. Do not trust latencies";
        return Check::new(name, Status::Warn, found, remedy);
    }
    if matches!(source.as_str(), "hpet" | "acpi_pm" | "jiffies") {
        let remedy = "reading this clock takes microseconds. Prefer tsc or kvm-clock";
        return Check::new(name, Status::Warn, found, remedy);
    }
    Check::ok(name, found)
}

/// The wall clock: used for labels, and for the order of a source's runs.
fn wall() -> Check {
    let name = "wall clock";
    let (now, up) =
        (duration(clock_gettime(ClockId::Realtime)), duration(clock_gettime(ClockId::Boottime)));
    let asleep = up.saturating_sub(duration(clock_gettime(ClockId::Monotonic)));
    let found = format!(
        "{} s since 1970, {} s since boot, {:.1} s of them asleep",
        now.as_secs(),
        up.as_secs(),
        asleep.as_secs_f64()
    );
    if now.as_secs() < NOT_SET_BEFORE_S || now < up {
        let remedy = "set the clock (NTP): runs of a source are ordered by their start time";
        return Check::new(name, Status::Warn, found, remedy);
    }
    Check::ok(name, found)
}

/// Timer slack: how late the kernel may end a sleep.
fn slack() -> Check {
    let name = "timer slack";
    match current_timer_slack() {
        Ok(slack_ns) if slack_ns <= USUAL_SLACK_NS => {
            Check::ok(name, format!("{slack_ns} ns. The worker sets its own to 1 ns"))
        }
        Ok(slack_ns) => {
            let remedy = "processes other than the worker wake that much later";
            Check::new(name, Status::Warn, format!("{slack_ns} ns"), remedy)
        }
        Err(error) => {
            let remedy = "ticks may start 50 µs late";
            Check::new(name, Status::Warn, format!("cannot be read: {error}"), remedy)
        }
    }
}

fn duration(time: Timespec) -> Duration {
    let seconds = u64::try_from(time.tv_sec).unwrap_or_default();
    Duration::new(seconds, u32::try_from(time.tv_nsec).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::ICEORYX2;

    #[test]
    fn the_version_shown_is_the_one_that_is_built_in() {
        let lock = concat!(env!("CARGO_MANIFEST_DIR"), "/../../Cargo.lock");
        let lock = std::fs::read_to_string(lock).unwrap();
        let entry = format!("name = \"iceoryx2\"\nversion = \"{ICEORYX2}\"\n");
        assert!(lock.contains(&entry), "{ICEORYX2} is not in Cargo.lock");
    }
}
