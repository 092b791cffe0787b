//! The clocks.
//!
//! All times within the simulator are simulated ns since its beginning. The monotonic clock begins
//! anew with each boot, and may run slightly too fast or slow, as while it is adjusted. The wall
//! clock may be set. While the host is suspended, the wall clock and the time since boot go on, and
//! nothing else does: so that time is no simulated time.

use std::cell::Cell;

/// Simulated beginning by the wall clock: 1 January 2030.
const BEGIN_UNIX_NS: u64 = 1_893_456_000_000_000_000;

#[derive(Clone, Copy)]
struct Clocks {
    now_ns: u64,
    /// The monotonic clock showed `of_ns` at `at_ns`, and runs `ppm` too fast.
    at_ns: u64,
    of_ns: u64,
    ppm: i64,
    wall_offset_ns: i64,
    /// Time of this boot for which the host was suspended.
    suspended_ns: u64,
    boots: u64,
}

thread_local! {
    static CLOCKS: Cell<Clocks> = const {
        Cell::new(Clocks {
            now_ns: 0,
            at_ns: 0,
            of_ns: 0,
            ppm: 0,
            wall_offset_ns: 0,
            suspended_ns: 0,
            boots: 0,
        })
    };
}

pub(crate) fn begin(uptime_ns: u64) {
    CLOCKS.set(Clocks {
        now_ns: 0,
        at_ns: 0,
        of_ns: uptime_ns,
        ppm: 0,
        wall_offset_ns: 0,
        suspended_ns: 0,
        boots: 1,
    });
}

fn change(of: impl FnOnce(&mut Clocks)) {
    let mut clocks = CLOCKS.get();
    of(&mut clocks);
    CLOCKS.set(clocks);
}

/// Simulated time, ns.
pub fn now_ns() -> u64 {
    CLOCKS.get().now_ns
}

/// Lets `ns` pass.
pub fn pass(ns: u64) {
    change(|clocks| clocks.now_ns += ns);
}

/// Lets time pass until `ns`, unless it is past.
pub fn pass_until(ns: u64) {
    change(|clocks| clocks.now_ns = clocks.now_ns.max(ns));
}

impl Clocks {
    /// The monotonic clock stands still for `ns` of simulated time.
    fn stop(&mut self, ns: u64) {
        self.of_ns = self.monotonic_ns();
        self.now_ns += ns;
        self.at_ns = self.now_ns;
    }

    fn monotonic_ns(&self) -> u64 {
        let elapsed = i128::from(self.now_ns - self.at_ns);
        let shown = elapsed + elapsed * i128::from(self.ppm) / 1_000_000;
        self.of_ns + u64::try_from(shown).unwrap_or(0)
    }
}

/// Time of the monotonic clock, ns.
pub fn monotonic_ns() -> u64 {
    CLOCKS.get().monotonic_ns()
}

/// Time since boot with suspend, ns.
pub fn boot_ns() -> u64 {
    let clocks = CLOCKS.get();
    clocks.monotonic_ns().saturating_add(clocks.suspended_ns)
}

/// Simulated time at which the monotonic clock will show `monotonic_ns`, give or take its drift.
pub fn simulated_ns(monotonic_ns: u64) -> u64 {
    let clocks = CLOCKS.get();
    clocks.now_ns.saturating_add(monotonic_ns.saturating_sub(clocks.monotonic_ns()))
}

/// Time of the wall clock, Unix ns.
pub fn unix_ns() -> u64 {
    let clocks = CLOCKS.get();
    (BEGIN_UNIX_NS + clocks.now_ns).saturating_add_signed(clocks.wall_offset_ns)
}

/// Sets the wall clock forward or back by `step_ns`, but not before the monotonic clock's time.
/// Linux refuses that too (`clock_settime`, since 4.3), so no wall clock stands still at 1970.
pub fn set_wall_clock(step_ns: i64) {
    let set_ns = i128::from(unix_ns()) + i128::from(step_ns);
    if set_ns >= i128::from(monotonic_ns()) {
        change(|clocks| clocks.wall_offset_ns = clocks.wall_offset_ns.saturating_add(step_ns));
    }
}

/// The host is suspended for `ns`, and wakes again.
pub fn suspend(ns: u64) {
    change(|clocks| {
        clocks.wall_offset_ns = clocks.wall_offset_ns.saturating_add_unsigned(ns);
        clocks.suspended_ns = clocks.suspended_ns.saturating_add(ns);
    });
}

/// The host is suspended for `ns` of simulated time, as one of several whose time goes on.
pub fn sleep(ns: u64) {
    change(|clocks| {
        clocks.stop(ns);
        clocks.suspended_ns = clocks.suspended_ns.saturating_add(ns);
    });
}

/// All clocks stand still for `ns` of simulated time, as those of a virtual machine that is paused.
pub fn stand_still(ns: u64) {
    change(|clocks| {
        clocks.stop(ns);
        clocks.wall_offset_ns = clocks.wall_offset_ns.saturating_sub_unsigned(ns);
    });
}

/// From now on the monotonic clock runs `ppm` millionths too fast.
pub fn drift(ppm: i64) {
    change(|clocks| {
        clocks.of_ns = clocks.monotonic_ns();
        clocks.at_ns = clocks.now_ns;
        clocks.ppm = ppm;
    });
}

/// The machine starts again: the monotonic clock begins at zero.
pub fn boot() {
    change(|clocks| {
        clocks.of_ns = 0;
        clocks.at_ns = clocks.now_ns;
        clocks.suspended_ns = 0;
        clocks.boots += 1;
    });
}

/// Number of the boot, from 1.
pub fn boots() -> u64 {
    CLOCKS.get().boots
}
