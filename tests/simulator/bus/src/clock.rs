//! The clocks of the simulated host.

use std::time::Duration;

use joulebus_simulated_host::{operation, time};

/// Time of the monotonic clock, ns.
pub fn monotonic_ns() -> u64 {
    operation();
    time::monotonic_ns()
}

/// Time since boot with suspend, ns. It is no operation, so that the permits of some workers change
/// nothing for the others.
pub fn boot_ns() -> u64 {
    time::boot_ns()
}

/// Time passes for all processes: the processor is one.
pub fn sleep(duration: Duration) {
    operation();
    time::pass(duration.as_nanos() as u64);
}

/// Wall-clock time, Unix ns.
pub fn unix_ns() -> u64 {
    operation();
    time::unix_ns()
}

/// Processor time: all time is.
pub fn thread_cpu_ns() -> u64 {
    monotonic_ns()
}

/// The id of this boot.
pub fn boot_id() -> std::io::Result<String> {
    Ok(format!("boot-{}", time::boots()))
}
