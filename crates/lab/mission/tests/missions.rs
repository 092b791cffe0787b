//! Missions keep the conditions that all policies share, and the comparison is fair.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use joulebus_mission::{CHOSEN, Outcome, Policy, Runs, Scenario, Summary, mission};

/// Eight minutes, in which every robot is charged at least once.
fn short() -> Scenario {
    Scenario { duration_s: 480.0, ..Scenario::default() }
}

#[test]
fn no_charger_takes_two_robots_and_every_joule_is_accounted_for() {
    for policy in CHOSEN {
        let outcome = mission(&short(), policy, 2001).unwrap();
        let name = policy.name();
        assert!(outcome.tasks > 50, "{name}: {outcome:?}");
        assert!(outcome.charges >= 20, "{name}: {outcome:?}");
        assert_eq!(outcome.shared_chargers, 0, "{name}");
        assert!(outcome.unaccounted_j < 1e-6, "{name}: {outcome:?}");
        // The fleet meters the energy that the monitors show.
        assert!(outcome.metered_error < 0.01, "{name}: {outcome:?}");
        let shares = [outcome.at_work, outcome.in_line, outcome.charger_use];
        assert!(shares.iter().all(|share| (0.0..1.0).contains(share)), "{name}: {outcome:?}");
    }
}

#[test]
fn the_same_seed_gives_the_same_mission_in_any_thread_and_another_seed_another() {
    let policy = CHOSEN[3];
    let here = mission(&short(), policy, 2002).unwrap();
    let there = std::thread::scope(|scope| {
        let thread = scope.spawn(|| mission(&short(), policy, 2002).unwrap());
        thread.join().unwrap()
    });
    assert_eq!(here, there);
    let bits = |outcome: &Outcome| [outcome.at_work, outcome.soc_before].map(f64::to_bits);
    assert_eq!(bits(&here), bits(&there));
    let other = mission(&short(), policy, 2003).unwrap();
    assert_ne!(here.at_work, other.at_work);
}

#[test]
fn robots_of_a_policy_that_believes_in_half_their_power_strand_and_are_counted() {
    let blind = Policy::Distance { power_w: 2.0, reserve: 0.05 };
    let blind = mission(&short(), blind, 2001).unwrap();
    let careful = mission(&short(), CHOSEN[3], 2001).unwrap();
    assert!(blind.stranded >= 3, "{blind:?}");
    assert!(careful.stranded < blind.stranded, "{careful:?}");
    // A stranded robot stays idle, and other robots do the rest of its task.
    assert!(blind.unaccounted_j < 1e-6, "{blind:?}");
}

#[test]
fn a_fleet_with_large_batteries_and_sound_robots_strands_under_no_policy() {
    let scenario = Scenario { capacity_j: 3600.0, dragging_share: 0.0, ..short() };
    for policy in CHOSEN {
        assert_eq!(mission(&scenario, policy, 2004).unwrap().stranded, 0, "{policy:?}");
    }
}

#[test]
fn the_best_baseline_is_the_one_with_most_tasks_that_strands_at_most_as_many() {
    let brief = Scenario { duration_s: 2.0, ..short() };
    let outcome = |tasks: u64, stranded: u64| Outcome {
        tasks,
        stranded,
        ..mission(&brief, CHOSEN[0], 1).unwrap()
    };
    let runs = |policy: Policy, tasks: u64, stranded: u64| Runs {
        policy,
        outcomes: vec![outcome(tasks, stranded); 10],
    };
    let all = [
        runs(CHOSEN[0], 90, 0),
        runs(CHOSEN[1], 100, 0),
        runs(CHOSEN[2], 120, 1),
        runs(CHOSEN[3], 110, 0),
    ];
    let verdict = Summary::new(short(), 1, &all).verdict.unwrap();
    assert_eq!(verdict.baseline, Some("distance"));
    let more = verdict.more.unwrap();
    assert!((more.value - 0.1).abs() < 1e-12 && more.lo <= more.value, "{more:?}");
    let all = [runs(CHOSEN[2], 120, 1), runs(CHOSEN[3], 110, 0)];
    assert_eq!(Summary::new(short(), 1, &all).verdict.unwrap().baseline, None);
}

#[test]
fn with_true_energies_nobody_strands_robots_charge_later_and_the_oracle_is_no_baseline() {
    let oracle = mission(&short(), Policy::Oracle, 2001).unwrap();
    let joulebus = mission(&short(), CHOSEN[3], 2001).unwrap();
    assert_eq!(oracle.stranded, 0, "{oracle:?}");
    assert!(oracle.soc_before < joulebus.soc_before, "{oracle:?} {joulebus:?}");
    assert!(oracle.unaccounted_j < 1e-6 && oracle.metered_error < 0.01, "{oracle:?}");
    let more = Outcome { tasks: 2 * joulebus.tasks, ..oracle };
    let runs =
        |policy: Policy, outcome: &Outcome| Runs { policy, outcomes: vec![outcome.clone(); 10] };
    let all = [runs(Policy::Oracle, &more), runs(CHOSEN[1], &joulebus), runs(CHOSEN[3], &joulebus)];
    let verdict = Summary::new(short(), 1, &all).verdict.unwrap();
    assert_eq!(verdict.baseline, Some("distance"));
}
