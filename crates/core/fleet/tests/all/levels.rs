//! A robot against its own earlier level, and what a person acknowledges as its new normal.

use joulebus_fleet::Fleet;
use joulebus_testkit_fleets::{self as world, MS, PERIOD_NS, Source};
use joulebus_wire::{Alarm, AlarmSet, Sample, Statement};

const ROBOT: u32 = 7;

/// A fleet with one robot, whose command does not change.
struct Bench {
    fleet: Fleet,
    source: Source,
    step: u64,
}

impl Bench {
    fn new() -> Self {
        let mut settings = world::settings(1);
        // 18 % of what the robot draws.
        settings.alarms.level_limit = 3.0;
        // The network is random, so its residuals are not judged.
        settings.alarms.settle_samples = 10_000;
        let fleet = Fleet::new(settings, world::models()).unwrap();
        Self { fleet, source: Source::new(1, 1), step: 0 }
    }

    fn tick(&mut self, power_w: f32) -> Option<Alarm> {
        self.step += 1;
        let now_ns = 60_000 * MS + self.step * PERIOD_NS;
        let scatter_w = 0.05 * (self.step as f32 * 0.31).sin();
        let sample = Sample::new(ROBOT, self.step, now_ns).command(0.1, 0.5);
        let sample = sample.reading(power_w + scatter_w, now_ns);
        self.source.tick(&mut self.fleet, &[sample], now_ns);
        self.raised()
    }

    /// The alarm of its level.
    fn raised(&self) -> Option<Alarm> {
        let alarms = AlarmSet(world::diagnostic(&self.fleet, ROBOT).alarms);
        alarms.iter().find(|alarm| alarm.is_of_level())
    }

    /// Draws the power for a minute. Returns the first alarm, and its time from the start, s.
    fn draw(&mut self, power_w: f32) -> Option<(Alarm, f64)> {
        let mut first = None;
        for tick in 0..60_000 * MS / PERIOD_NS {
            let raised = self.tick(power_w);
            first = first.or(raised.map(|alarm| (alarm, (tick * PERIOD_NS) as f64 * 1e-9)));
        }
        first
    }
}

#[test]
fn a_load_that_is_the_new_normal_is_quiet_and_a_further_change_is_found_as_soon() {
    let mut bench = Bench::new();
    assert_eq!(bench.draw(3.6), None);
    for (power_w, alarm) in [
        (3.6 * 1.4, Alarm::LevelHigh),
        (3.6 * 1.4 * 1.4, Alarm::LevelHigh),
        (3.6 * 1.4, Alarm::LevelLow),
        (3.6, Alarm::LevelLow),
    ] {
        let (found, after_s) = bench.draw(power_w).unwrap();
        assert!(found == alarm && after_s < 7.0, "{power_w} W: {found:?} after {after_s} s");
        assert_eq!(bench.raised(), Some(alarm), "it stays for the rest of the minute");
        bench.fleet.take_statement(ROBOT, Statement::NewNormal, 0);
        assert_eq!(bench.tick(power_w), None, "it ends in the next tick");
        assert_eq!(bench.draw(power_w), None, "{power_w} W");
    }
}

#[test]
fn a_new_normal_of_a_robot_that_is_not_judged_changes_nothing() {
    let mut bench = Bench::new();
    let state = |fleet: &Fleet| {
        let mut bytes = Vec::new();
        fleet.state().encode_into(&mut bytes);
        bytes
    };
    bench.fleet.take_statement(ROBOT, Statement::NewNormal, 0);
    bench.tick(3.6);
    let before = state(&bench.fleet);
    bench.fleet.take_statement(ROBOT + 1, Statement::NewNormal, 0);
    assert!(state(&bench.fleet) == before, "a robot that is not in the fleet");
}

/// Runs twenty robots from the id `first` on for 45 s, of which one draws `factor` times what the
/// others draw, from its first sample on. Returns the alarms of that robot, with their times, s, and
/// the number of those of the others.
fn among_others(first: u32, factor: f32, accepted: bool) -> (Vec<(Alarm, f64)>, usize) {
    let mut settings = world::settings(20);
    settings.alarms.settle_samples = 10_000;
    settings.platforms[2].energy_online = true;
    settings.alarms.level_limit = 8.0;
    let mut fleet = Fleet::new(settings, world::models()).unwrap();
    let (mut source, odd) = (Source::new(1, 1), first + 5);
    let mut raised = std::collections::BTreeMap::new();
    for step in 0..45_000 * MS / PERIOD_NS {
        let now_ns = 60_000 * MS + step * PERIOD_NS;
        let frame: Vec<Sample> = (first..first + 20)
            .map(|robot| {
                let own = 1.0 + 0.01 * (robot * 7 % 11) as f32;
                let power_w = if robot == odd { factor * 3.6 } else { 3.6 * own };
                let ripple_w = 0.05 * ((step + u64::from(robot)) as f32 * 0.31).sin();
                let sample = Sample::new(robot, step, now_ns).command(0.1, 0.5);
                sample.reading(power_w + ripple_w, now_ns)
            })
            .collect();
        source.tick(&mut fleet, &frame, now_ns);
        for robot in first..first + 20 {
            let alarms = AlarmSet(world::diagnostic(&fleet, robot).alarms);
            for alarm in alarms.iter().filter(|alarm| alarm.is_of_level()) {
                let at_s = (step * PERIOD_NS) as f64 * 1e-9;
                raised.entry((robot, alarm)).or_insert(at_s);
                if accepted {
                    fleet.take_statement(robot, Statement::NewNormal, 0);
                }
            }
        }
    }
    assert_eq!(fleet.drops().total(), 0);
    let accepted_ends = !accepted
        || AlarmSet(world::diagnostic(&fleet, odd).alarms).iter().all(|alarm| !alarm.is_of_level());
    assert!(accepted_ends, "a new normal is compared with others no longer");
    let (of_odd, others): (Vec<_>, Vec<_>) =
        raised.into_iter().partition(|((robot, _), _)| *robot == odd);
    (of_odd.into_iter().map(|((_, alarm), at_s)| (alarm, at_s)).collect(), others.len())
}

#[test]
fn a_load_from_the_first_sample_on_is_found_beside_the_levels_of_other_robots() {
    for first in [0, 200] {
        for accepted in [false, true] {
            for (factor, expected) in
                [(1.0, None), (2.0, Some(Alarm::LevelHigh)), (0.4, Some(Alarm::LevelLow))]
            {
                let (found, others) = among_others(first, factor, accepted);
                let soon = found.iter().all(|(_, at_s)| *at_s <= 30.0);
                let alarms: Vec<Alarm> = found.iter().map(|(alarm, _)| *alarm).collect();
                assert!(soon && others == 0, "{first}, {factor}: {found:?}, {others} others");
                assert_eq!(alarms, Vec::from_iter(expected), "{first}, {factor}");
            }
        }
    }
}

#[test]
fn a_load_from_the_first_sample_on_that_is_taken_off_leaves_no_alarm() {
    for factor in [2.0, 3.0, 0.4] {
        let mut settings = world::settings(20);
        settings.platforms[2].energy_online = true;
        settings.alarms.level_limit = 8.0;
        let mut fleet = Fleet::new(settings, world::models()).unwrap();
        let (mut source, mut was_raised) = (Source::new(1, 1), false);
        for step in 0..240_000 * MS / PERIOD_NS {
            let now_ns = 60_000 * MS + step * PERIOD_NS;
            let is_loaded = step < 60_000 * MS / PERIOD_NS;
            let frame: Vec<Sample> = (200..220)
                .map(|robot| {
                    let own = 1.0 + 0.01 * (robot * 7 % 11) as f32;
                    let of_load = if is_loaded && robot == 205 { factor } else { 1.0 };
                    let ripple_w = 0.05 * ((step + u64::from(robot)) as f32 * 0.31).sin();
                    let sample = Sample::new(robot, step, now_ns).command(0.1, 0.5);
                    sample.reading(3.6 * own * of_load + ripple_w, now_ns)
                })
                .collect();
            source.tick(&mut fleet, &frame, now_ns);
            let alarms = AlarmSet(world::diagnostic(&fleet, 205).alarms);
            was_raised |= is_loaded && alarms.iter().any(|alarm| alarm.is_of_level());
        }
        let alarms = AlarmSet(world::diagnostic(&fleet, 205).alarms);
        let left: Vec<Alarm> = alarms.iter().filter(|alarm| alarm.is_of_level()).collect();
        assert!(was_raised && left.is_empty(), "{factor}: {was_raised} {left:?}");
    }
}

/// Alarms of a robot of a platform with a persistence model, at a power for 60 s and at a multiple
/// of it for 30 s. `command`: its velocities.
fn untrained(command: Option<(f32, f32)>, factor: f32) -> [Vec<Alarm>; 2] {
    let (mut fleet, mut source) = (world::fleet(1), Source::new(1, 1));
    let mut raised = [Vec::new(), Vec::new()];
    for step in 0..90_000 * MS / PERIOD_NS {
        let now_ns = 60_000 * MS + step * PERIOD_NS;
        let is_late = step >= 60_000 * MS / PERIOD_NS;
        let power_w = 3.6 * if is_late { factor } else { 1.0 };
        let sample = Sample::new(201, step, now_ns);
        let sample = command.map_or(sample, |(v, omega)| sample.command(v, omega));
        let sample = sample.reading(power_w + 0.05 * (step as f32 * 0.31).sin(), now_ns);
        source.tick(&mut fleet, &[sample], now_ns);
        let alarms = AlarmSet(world::diagnostic(&fleet, 201).alarms);
        raised[usize::from(is_late)].extend(alarms.iter().filter(|alarm| alarm.is_of_level()));
    }
    raised
}

#[test]
fn a_load_is_found_without_a_trained_model_and_without_commands() {
    for command in [Some((0.1, 0.5)), Some((0.0, 0.0)), None] {
        for (factor, expected) in
            [(1.0, None), (2.0, Some(Alarm::LevelHigh)), (0.4, Some(Alarm::LevelLow))]
        {
            let [before, after] = untrained(command, factor);
            assert_eq!(before, [], "{command:?}");
            assert_eq!(after.first().copied(), expected, "{command:?}, {factor}");
        }
    }
}

#[test]
fn a_robot_of_another_kind_has_a_mismatch_and_one_of_this_kind_has_none() {
    for (factor, expected) in [(1.0, false), (0.7, false), (2.0, false), (0.05, true)] {
        let mut bench = Bench::new();
        bench.draw(factor * 3.6);
        bench.draw(factor * 3.6);
        let alarms = AlarmSet(world::diagnostic(&bench.fleet, ROBOT).alarms);
        assert_eq!(alarms.has(Alarm::ModelMismatch), expected, "{factor}: {alarms:?}");
    }
}
