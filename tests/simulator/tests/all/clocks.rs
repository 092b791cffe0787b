//! The clocks of the simulated host.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use joulebus_config::Config;
use simulated_bus as bus;
use simulated_connect::standby::{Permit, StandbyFiles};
use simulated_host::{self as host, time};
use simulated_worker::{RunError, Worker};

/// Pid and time of taking the lock distinguish workers: for two with one pid the clock must go on.
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

/// A permit ends while the host is suspended, although the monotonic clock stands still: another
/// host's worker serves by then.
#[test]
fn a_worker_whose_host_was_suspended_until_its_permit_had_ended_sends_nothing_more() {
    const SECOND: u64 = 1_000_000_000;
    for (suspended_s, holds) in [(0, true), (2, true), (4, false), (86_400, false)] {
        host::begin(1, SECOND);
        bus::begin();
        host::begin_life(11);
        host::enter(11, host::USUAL_COST_NS);
        let text = "[fleet]\nname = \"test\"\ncapacity = 4\n[domain]\nroot = \"/dev/shm/test\"\n\
                    [ledger]\ncheckpoint = \"\"\n\
                    [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-3\"]\n";
        let config = Config::parse(text, Path::new("/")).unwrap();
        let mut worker = Worker::open_standby(&config).unwrap();
        let until_ns = time::boot_ns() + 3 * SECOND;
        let permit = Permit { term: 1, until_ns, lease: 0 };
        permit.write(&StandbyFiles::new(&config).permit).unwrap();
        assert!(worker.stand_by(&AtomicBool::new(false)).unwrap());
        worker.poll().unwrap();
        let (monotonic_ns, wall_ns) = (time::monotonic_ns(), time::unix_ns());
        time::suspend(suspended_s * SECOND);
        assert_eq!(time::monotonic_ns(), monotonic_ns);
        assert_eq!(time::unix_ns(), wall_ns + suspended_s * SECOND);
        match worker.poll() {
            Ok(_) => assert!(holds, "{suspended_s} s"),
            Err(RunError::Permit(over)) => assert_eq!((holds, over.term), (false, 1)),
            Err(error) => panic!("{suspended_s} s: {error}"),
        }
        let _ = worker.finish();
        let _ = host::leave();
    }
}
