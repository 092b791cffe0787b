//! The clocks of this host.

use std::io;
use std::time::Duration;

use rustix::time::{ClockId, Timespec, clock_gettime};

/// Time of the monotonic clock, ns since boot without suspend. The same clock in every process of
/// the host.
#[must_use]
pub fn monotonic_ns() -> u64 {
    nanoseconds(clock_gettime(ClockId::Monotonic))
}

/// Time since boot with suspend, ns: for permits and leases, which end while a host sleeps.
#[must_use]
pub fn boot_ns() -> u64 {
    nanoseconds(clock_gettime(ClockId::Boottime))
}

/// Wall-clock time, ns since 1970. May jump: use as a label only, not for intervals.
#[must_use]
pub fn unix_ns() -> u64 {
    nanoseconds(clock_gettime(ClockId::Realtime))
}

/// Lets this thread sleep for `duration`.
pub fn sleep(duration: Duration) {
    std::thread::sleep(duration);
}

/// The id of this boot: monotonic times of different boots are not comparable.
///
/// # Errors
/// `/proc` cannot be read.
pub fn boot_id() -> io::Result<String> {
    Ok(std::fs::read_to_string("/proc/sys/kernel/random/boot_id")?.trim().to_owned())
}

/// Processor time that this thread has used, ns.
#[must_use]
pub fn thread_cpu_ns() -> u64 {
    nanoseconds(clock_gettime(ClockId::ThreadCPUTime))
}

fn nanoseconds(time: Timespec) -> u64 {
    u64::try_from(time.tv_sec)
        .unwrap_or(0)
        .saturating_mul(1_000_000_000)
        .saturating_add(u64::try_from(time.tv_nsec).unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_since_boot_with_suspend_is_not_behind_that_without() {
        let now_ns = monotonic_ns();
        assert!(boot_ns() >= now_ns);
    }
}
