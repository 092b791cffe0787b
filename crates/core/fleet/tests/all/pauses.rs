//! What a pause costs, what a robot says when it is switched off, and what persons state.

use joulebus_fleet::{Fleet, FleetState, Ledger, SavedBattery};
use joulebus_settings::{Battery, Platform};
use joulebus_testkit_fleets::{self as world, MS, Source};
use joulebus_wire::{Budget, Sample, Statement, budget_flag, sample_flag};

const PERIOD_NS: u64 = 1_000 * MS;
const CAPACITY_J: f64 = 36_000.0;
const POWER_MAX_W: f32 = 20.0;

/// A robot that drives with 4 W and rests with 1 W.
struct Bench {
    fleet: Fleet,
    source: Source,
    now_ns: u64,
    seq: u64,
}

impl Bench {
    fn new() -> Self {
        let mut settings = world::settings(4);
        settings.intake.max_jump_ns = u64::MAX;
        settings.intake.leave_after_ns = 7_200_000 * MS;
        settings.platforms.truncate(1);
        let battery = Battery { initial_soc_lo: 0.9, ..Battery::new(CAPACITY_J, 0.0) };
        settings.platforms[0] = Platform {
            robots: vec![0..=9],
            period_ns: PERIOD_NS,
            stale_after_ns: 5 * PERIOD_NS,
            power_min_w: 0.0,
            power_max_w: POWER_MAX_W,
            battery: Some(battery),
            ..settings.platforms[0].clone()
        };
        let model = world::models().swap_remove(0);
        let fleet = Fleet::new(settings, vec![model]).expect("consistent settings");
        Self { fleet, source: Source::new(1, 1), now_ns: 7_200_000 * MS, seq: 0 }
    }

    fn send(&mut self, flags: u32, v_mps: f32, power_w: f32) -> Budget {
        self.now_ns += PERIOD_NS;
        self.seq += 1;
        let sample = Sample::new(1, self.seq, self.now_ns).command(v_mps, 0.0);
        let sample = sample.reading(power_w, self.now_ns).with(flags);
        self.source.tick(&mut self.fleet, &[sample], self.now_ns);
        self.budget()
    }

    /// Five minutes of driving and three of rest.
    fn work(&mut self) -> Budget {
        for _ in 0..300 {
            self.send(0, 0.1, 4.0);
        }
        for _ in 0..180 {
            self.send(0, 0.0, 1.0);
        }
        self.budget()
    }

    fn pause(&mut self, minutes: u64) -> Budget {
        self.now_ns += minutes * 60_000 * MS;
        self.fleet.tick(self.now_ns, false);
        self.budget()
    }

    fn state(&mut self, statement: Statement) -> Budget {
        self.fleet.take_statement(1, statement, self.now_ns);
        self.fleet.tick(self.now_ns, false);
        self.budget()
    }

    fn budget(&self) -> Budget {
        world::budget(&self.fleet, 1)
    }
}

/// Share of the battery that `watts` draw in some minutes.
fn share(watts: f64, minutes: f64) -> f64 {
    watts * 60.0 * minutes / CAPACITY_J
}

fn fell(before: &Budget, after: &Budget) -> f64 {
    f64::from(before.soc_lo) - f64::from(after.soc_lo)
}

#[test]
fn silence_costs_the_greatest_power_and_only_the_robots_own_off_what_it_draws_at_rest() {
    for (flags, most_w) in [(0, f64::from(POWER_MAX_W)), (sample_flag::OFF, 1.5)] {
        let mut bench = Bench::new();
        let worked = bench.work();
        assert!((worked.idle_w - 1.0).abs() < 0.05, "{worked:?}");
        let before = bench.send(flags, 0.0, 1.0);
        assert_eq!(before.flags & budget_flag::OFF != 0, flags != 0);
        assert!(before.pause_s < 1.0 && before.pause_note().is_none(), "{before:?}");
        let after = bench.pause(12);
        let lost = fell(&before, &after);
        assert!((lost / share(most_w, 12.0) - 1.0).abs() < 0.05, "{lost} at {most_w} W");
        assert!((f64::from(after.pause) / lost - 1.0).abs() < 0.05, "{after:?}");
        assert!((after.pause_s - 720.0).abs() < 3.0, "{after:?}");
        // The next message ends it: from there on silence costs the greatest power.
        let back = bench.send(0, 0.1, 4.0);
        assert_eq!(back.flags & budget_flag::OFF, 0);
        assert!(fell(&before, &back) <= lost + 0.01, "{back:?}");
        let again = bench.pause(3);
        let lost = fell(&back, &again);
        assert!((lost / share(POWER_MAX_W.into(), 3.0) - 1.0).abs() < 0.05, "{lost}");
        let note = again.pause_note().expect("it cost more than 1 %");
        assert!(note.starts_with("15 min without readings") && note.contains("battery 1 --full"));
    }
}

#[test]
fn what_a_person_states_holds_from_then_on_and_ends_the_cost_of_a_pause() {
    for (statement, soc, sd) in [
        (Statement::Full, 1.0, 0.01),
        (Statement::Charge(0.6), 0.6, 0.05),
        (Statement::Exchanged, 1.0, 0.05),
    ] {
        let mut bench = Bench::new();
        bench.work();
        bench.pause(25);
        let known = bench.state(statement);
        assert!((known.soc - soc).abs() < 1e-3 && (known.soc_sd - sd).abs() < 1e-3, "{known:?}");
        assert_eq!((known.pause_s < 2.0, known.pause_note()), (true, None), "{known:?}");
        // Only what comes after it counts.
        let later = bench.pause(3);
        let lost = fell(&known, &later);
        assert!((lost / share(POWER_MAX_W.into(), 3.0) - 1.0).abs() < 0.05, "{lost}");
        let back = bench.send(0, 0.1, 4.0);
        assert!(f64::from(back.soc) > f64::from(soc) - share(4.1, 3.0), "{back:?}");
        assert_eq!(u32::from(statement == Statement::Exchanged), back.battery_changes);
    }
}

#[test]
fn a_statement_reaches_a_robot_that_is_not_in_the_fleet_and_none_without_a_battery() {
    let mut bench = Bench::new();
    // One never came, one is of no platform, one was saved by an earlier run.
    for robot in [2, 77] {
        bench.fleet.take_statement(robot, Statement::Charge(0.3), bench.now_ns);
    }
    let ledger = Ledger::restored((0, 0), 0, 0, 0, bench.now_ns - 3_600_000 * MS);
    let budget = Budget {
        flags: budget_flag::BATTERY | budget_flag::CHARGE | budget_flag::OFF,
        soc: 0.5,
        soc_lo: 0.4,
        soc_hi: 0.6,
        idle_w: 1.0,
        mean_power_w: 4.0,
        ..Budget::default()
    };
    let saved = SavedBattery::new(&budget, 0);
    bench.fleet.restore(3, ledger, true, saved);
    bench.fleet.restore(0, ledger, true, saved);
    bench.fleet.take_statement(3, Statement::Charge(0.7), bench.now_ns);
    let mut source = Source::new(1, 1);
    let samples: Vec<Sample> = [0, 2, 3]
        .map(|robot| Sample::new(robot, 1, bench.now_ns + PERIOD_NS).command(0.0, 0.0))
        .map(|sample| sample.reading(1.0, bench.now_ns + PERIOD_NS))
        .into();
    source.tick(&mut bench.fleet, &samples, bench.now_ns + PERIOD_NS);
    let of = |robot| {
        let budgets = (0..bench.fleet.len()).map(|place| bench.fleet.budget(place));
        budgets.into_iter().find(|budget| budget.robot == robot).expect("it is in the fleet")
    };
    assert!((of(2).soc - 0.3).abs() < 1e-3 && (of(3).soc - 0.7).abs() < 2e-3, "{:?}", of(3));
    // The other was off for an hour, as it had said before the worker ended.
    let lost = 0.4 - f64::from(of(0).soc_lo);
    assert!((lost / share(1.5, 60.0) - 1.0).abs() < 0.05, "{lost}");
}

#[test]
fn statements_about_robots_that_never_came_cost_no_robot_its_account() {
    // Of four accounts two are saved, and one is of a robot of the fleet.
    let mut bench = Bench::new();
    bench.send(0, 0.1, 4.0);
    for robot in [0, 2] {
        let ledger = Ledger::restored((7, 0), 0, 0, 0, bench.now_ns);
        assert!(bench.fleet.restore(robot, ledger, true, None));
    }
    for robot in 3..=9 {
        bench.fleet.take_statement(robot, Statement::Charge(0.3), bench.now_ns);
    }
    // It leaves.
    bench.now_ns += 8_000_000 * MS;
    bench.fleet.tick(bench.now_ns, false);
    assert_eq!((bench.fleet.len(), bench.fleet.accounts_given_up()), (0, 0));
    let has = |robot| bench.fleet.ledger(robot).is_some();
    assert_eq!([0, 1, 2, 3, 4, 9].map(has), [true, true, true, true, false, false]);
}

#[test]
fn a_state_in_the_middle_of_it_goes_on_with_the_same_bits() {
    let mut bench = Bench::new();
    bench.work();
    bench.send(sample_flag::OFF, 0.0, 1.0);
    bench.pause(2);
    let mut bytes = Vec::new();
    bench.fleet.state().encode_into(&mut bytes);
    let mut other = Bench::new();
    other.fleet.restore_state(&FleetState::decode(&bytes).expect("its own")).expect("the same");
    (other.now_ns, other.seq) = (bench.now_ns, bench.seq);
    other.source = bench.source.clone();
    for bench in [&mut bench, &mut other] {
        bench.pause(1);
        bench.state(Statement::Charge(0.5));
        bench.send(0, 0.1, 4.0);
    }
    assert_eq!(format!("{:?}", bench.budget()), format!("{:?}", other.budget()));
    assert!((bench.budget().soc - 0.5).abs() < 0.01);
}
