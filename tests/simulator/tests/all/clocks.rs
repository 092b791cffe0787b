//! The clocks of the simulated host.

use simulated_host::{self as host, time};

/// Pid and time of taking the lock tell workers apart: for two with one pid the clock must go on.
#[test]
fn the_wall_clock_goes_on_however_often_it_is_set_back() {
    for uptime_ns in [1, 315_360_000_000_000_001] {
        host::begin(1, uptime_ns);
        let begin_ns = time::unix_ns();
        for _ in 0..20 {
            time::set_wall_clock(-300_000_000_000_000_000);
            let before_ns = time::unix_ns();
            assert!(before_ns >= time::monotonic_ns());
            time::pass(1);
            assert_eq!(time::unix_ns(), before_ns + 1);
        }
        assert!(time::unix_ns() < begin_ns);
    }
}
