//! The clocks of this host.
#![allow(unsafe_code)]

use std::io;
use std::mem::MaybeUninit;
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

/// Bounds of the realtime clock minus the monotonic one, ns. The difference changes only when the
/// realtime clock is set. `None` if it is negative: a host without a clock that has just booted.
#[must_use]
pub fn realtime_minus_monotonic_ns() -> Option<(u64, u64)> {
    let (before_ns, realtime_ns, after_ns) = (monotonic_ns(), unix_ns(), monotonic_ns());
    Some((realtime_ns.checked_sub(after_ns)?, realtime_ns.checked_sub(before_ns)?))
}

/// The kernel's view of the program that adjusts the realtime clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Synchronisation {
    /// A program adjusts it (`STA_UNSYNC` is not set).
    pub is_synchronised: bool,
    /// The largest error that was stated, and 500 µs more for each second since, ns.
    pub most_error_ns: u64,
}

/// State of the realtime clock, and of its adjustment by a program (`man 2 adjtimex`).
///
/// # Errors
/// The system call is refused, in some containers.
pub fn synchronisation() -> io::Result<Synchronisation> {
    let mut state = MaybeUninit::<libc::timex>::zeroed();
    // SAFETY: zeros are a valid `timex`, whose `modes` of 0 change nothing in the kernel.
    let state = unsafe {
        if libc::adjtimex(state.as_mut_ptr()) < 0 {
            return Err(io::Error::last_os_error());
        }
        state.assume_init()
    };
    let most_error_us = u64::try_from(state.maxerror).unwrap_or(u64::MAX);
    Ok(Synchronisation {
        is_synchronised: state.status & libc::STA_UNSYNC == 0,
        most_error_ns: most_error_us.saturating_mul(1_000),
    })
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

    #[test]
    fn realtime_minus_monotonic_lies_between_its_bounds_and_the_kernel_reports_whether_it_is_kept()
    {
        let (lo_ns, hi_ns) = realtime_minus_monotonic_ns().unwrap();
        assert!(lo_ns <= hi_ns);
        // Refused in some containers.
        if let Ok(found) = synchronisation() {
            // The kernel reports that itself above 16 s.
            assert!(!found.is_synchronised || found.most_error_ns <= 16_000_000_000, "{found:?}");
        }
    }
}
