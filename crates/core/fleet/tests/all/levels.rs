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
