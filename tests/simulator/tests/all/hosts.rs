//! Fleets over several hosts, joined by links.

use std::sync::atomic::AtomicBool;

use joulebus_simulator::campaign::{Campaign, Totals, play};
use joulebus_simulator::panics::keep_panics;

const MINUTES_NS: u64 = 60_000_000_000;

fn played(first: u64, seeds: u64, duration_ns: u64) -> Totals {
    keep_panics();
    let duration_ns = Some(duration_ns);
    let campaign =
        Campaign { first, seeds, duration_ns, linked: true, threads: 2, ..Campaign::default() };
    play(&campaign, &AtomicBool::new(false), |_| {})
}

/// Samples and forecasts come once, in order and unchanged, one worker serves at a time, silence is
/// reported, and everything goes on after the last fault. `JOULEBUS_LINKED_HOURS` states how long
/// the seed `JOULEBUS_SIM_SEED` lasts instead.
#[test]
fn linked_hosts_survive_faults() {
    let variable = |name: &str| std::env::var(name).ok()?.parse::<u64>().ok();
    let totals = match variable("JOULEBUS_LINKED_HOURS") {
        Some(hours) => {
            played(variable("JOULEBUS_SIM_SEED").unwrap_or(1), 1, hours * 60 * MINUTES_NS)
        }
        None => played(1, 6, 3 * MINUTES_NS),
    };
    println!("figure: {totals}");
    assert!(totals.failed.is_empty(), "{totals}");
    assert!(totals.ticks > 0 && totals.faults > 0, "{totals}");
}

/// A seed means one run, to the nanosecond.
#[test]
fn a_seed_of_linked_hosts_is_played_again_exactly() {
    let [one, other] = [(); 2].map(|()| played(3, 1, MINUTES_NS).to_string());
    assert_eq!(one, other);
}
