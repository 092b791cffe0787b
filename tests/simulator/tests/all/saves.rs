//! Saves of the ledger that are cut off at each of their steps.

use std::sync::atomic::AtomicBool;

use joulebus_simulator::panics::keep_panics;
use joulebus_simulator::scenario::{Fault, Role, Scenario, Setup};
use joulebus_simulator::world::run;

const MS: u64 = 1_000_000;
const SECOND: u64 = 1_000 * MS;

/// Accesses to the disk of a worker that starts after an interrupted save, and saves. Three files
/// are looked for. The one of the earlier save is opened, synced and renamed, after the one before
/// it, and the folder is synced. Then the folder is made, and a file created, written, synced and
/// renamed likewise. One more access is in the next save.
const ACCESSES: u64 = 3 + 5 + 7 + 1;

/// A small fleet to which nothing happens but `faults`.
fn scenario(seed: u64, faults: &[(u64, Fault)]) -> Scenario {
    let drawn = Scenario::new(seed, Some(40 * SECOND)).only(&[]);
    Scenario {
        setup: Setup {
            robots: 1,
            sources: 1,
            planners: 1,
            poll_every_ns: 0,
            clients: 0,
            displays: 0,
            bridges: 0,
            records: false,
            period_ns: 500 * MS,
            persistence: true,
            save_every_ns: 2 * SECOND,
            everything: true,
            ..drawn.setup
        },
        faults: faults.iter().copied().enumerate().collect(),
        ..drawn
    }
}

fn hold(scenario: &Scenario) {
    keep_panics();
    let outcome = run(scenario, &AtomicBool::new(false));
    assert_eq!(outcome.failure, None, "{:?}", scenario.faults);
    assert!(outcome.ticks > 0 && outcome.faults > 0);
}

/// The worker is killed at each step of a save, and the next one at each of its accesses to the
/// disk, from its first look on. The newest whole ledger is always still there.
#[test]
fn a_worker_killed_at_any_two_steps_of_its_saves_keeps_the_newest_ledger() {
    for first in 1..=7 {
        for second in 1..=ACCESSES {
            let twice = Fault::KillAtDisk(Role::Worker, first, second);
            hold(&scenario(1, &[(10 * SECOND, twice)]));
        }
    }
}

/// The same, with a power failure instead of the second kill, or at the first. What was synced is
/// still there, whichever other changes are.
#[test]
fn a_power_failure_at_any_step_of_a_save_leaves_what_was_synced() {
    for seed in 1..=6 {
        for accesses in 1..=ACCESSES {
            let fails = Fault::PowerLossAtDisk(Role::Worker, accesses, SECOND);
            hold(&scenario(seed, &[(10 * SECOND, fails)]));
            // The save before is cut off between its renames.
            let cut = Fault::KillAtDisk(Role::Worker, 6, accesses);
            let fails = Fault::PowerLossAtDisk(Role::Worker, 6, SECOND);
            hold(&scenario(seed, &[(10 * SECOND, cut), (10 * SECOND + MS, fails)]));
        }
    }
}

/// A save is cut off at each of its steps, and the power fails before the next worker has saved.
/// The ledger that the worker found lasts.
#[test]
fn what_a_worker_found_survives_a_power_failure_before_its_first_save() {
    /// Accesses that no worker has before the power fails.
    const NEVER: u64 = 1_000_000;
    for seed in 1..=6 {
        for step in 1..=7 {
            // It saves each 7.5 s; the one after 20 s is cut off.
            let cut = Fault::KillAtDisk(Role::Worker, step, NEVER);
            let fails = Fault::PowerLoss(SECOND);
            let faults = [(20 * SECOND, cut), (31_500 * MS, fails)];
            let mut scenario = scenario(seed, &faults);
            scenario.setup.save_every_ns = 10 * SECOND;
            hold(&scenario);
        }
    }
}
