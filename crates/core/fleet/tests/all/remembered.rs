//! What the robots of a platform have shown serves the next one, and no robot decides it alone.

use joulebus_fleet::{ErrorCounts, Fleet, FleetState};
use joulebus_predictor::{FeatureSet, Model};
use joulebus_settings::{FleetSettings, Platform};
use joulebus_testkit_fleets::random;
use joulebus_testkit_fleets::{self as world, MS, PERIOD_NS, Source, budget};
use joulebus_wire::{Sample, sample_flag};

const START_NS: u64 = 60_000 * MS;
/// The mean of the network's energy model.
const MEAN_W: f32 = 3.7;
/// The robot that joins when the others have shown what they draw.
const NEXT: u32 = 77;

/// One platform of a hundred robots that learn online.
fn fleet() -> Fleet {
    let settings = world::learning(100);
    let platforms = vec![Platform { power_max_w: 80.0, ..settings.platforms[0].clone() }];
    let settings = FleetSettings { platforms, ..settings };
    Fleet::new(settings, vec![Model::Network(random::network(1, FeatureSet::Full))]).unwrap()
}

fn sample(robot: u32, step: u64, power_w: f32) -> Sample {
    let now_ns = START_NS + step * PERIOD_NS;
    let ripple = 0.05 * ((step + u64::from(robot)) as f32 * 0.7).sin();
    let command = 0.2 * ((step + u64::from(3 * robot)) as f32 * 0.02).sin();
    let sample = Sample::new(robot, step, now_ns).command(command, 0.0);
    sample.reading(power_w * (1.0 + ripple), now_ns)
}

/// Half a minute of robots, each at its power, W. Frames list them in this order.
fn run(fleet: &mut Fleet, robots: &[(u32, f32)]) {
    let mut source = Source::new(1, 1);
    for step in 0..1_000 {
        let frame: Vec<Sample> =
            robots.iter().map(|(robot, power_w)| sample(*robot, step, *power_w)).collect();
        source.tick(fleet, &frame, START_NS + step * PERIOD_NS);
    }
    // What the last samples have shown is remembered with the next tick.
    fleet.tick(START_NS + 999 * PERIOD_NS + 1, false);
}

fn seen(fleet: &Fleet) -> ErrorCounts<f32> {
    *fleet.remembered_errors().next().unwrap().1
}

/// Lasting power of the next robot after its first two readings, W, and the weight of its last
/// reading when it has its first forecast.
fn next(fleet: &mut Fleet, power_w: f32) -> (f32, f32) {
    let mut source = Source::new(2, 1);
    let mut lasting_w = 0.0;
    for step in 1_000..1_005 {
        source.tick(fleet, &[sample(NEXT, step, power_w)], START_NS + step * PERIOD_NS);
        if step == 1_001 {
            let shown = budget(fleet, NEXT);
            lasting_w = shown.usable_j / shown.time_to_empty_s;
        }
    }
    (lasting_w, fleet.learned(NEXT).unwrap().weights[0])
}

fn robots(count: u32, power_w: f32) -> Vec<(u32, f32)> {
    (0..count).map(|robot| (robot, power_w * (0.95 + 0.01 * (robot * 7 % 11) as f32))).collect()
}

#[test]
fn the_next_robot_is_taken_to_draw_what_the_fleet_draws_with_a_state_and_with_a_ledger() {
    let (alone_w, _) = next(&mut fleet(), MEAN_W);
    assert!((alone_w / MEAN_W - 1.0).abs() < 0.02, "{alone_w} W");
    for factor in [0.6, 1.6, 3.0] {
        let mut known = fleet();
        run(&mut known, &robots(64, factor * MEAN_W));
        let mut bytes = Vec::new();
        known.state().encode_into(&mut bytes);
        let mut restored = fleet();
        restored.restore_state(&FleetState::decode(&bytes).unwrap()).unwrap();
        let mut later = fleet();
        let (model, errors) = known.remembered_errors().next().unwrap();
        assert!(later.restore_errors(0, model, errors));
        // Levels of an earlier run say nothing of today's floor.
        assert_eq!(seen(&later), seen(&known).without_levels());
        assert_ne!(seen(&later), seen(&known));
        let (lasting_w, weight) = next(&mut known, MEAN_W);
        assert!((lasting_w / (factor * MEAN_W) - 1.0).abs() < 0.15, "{factor}: {lasting_w} W");
        assert_eq!((lasting_w, weight), next(&mut restored, MEAN_W));
        assert_eq!((lasting_w, weight), next(&mut later, MEAN_W));
    }
}

#[test]
fn where_first_forecasts_were_worse_than_the_last_reading_the_next_robot_starts_from_it() {
    // The network's weights are random.
    let mut bad = fleet();
    let (_, usual) = next(&mut fleet(), 30.0);
    run(&mut bad, &robots(12, 30.0));
    let (_, weight) = next(&mut bad, 30.0);
    assert!(usual < 0.05 && weight > 0.8, "{usual} before, {weight} after");
    // One such robot does not decide it.
    let mut one = fleet();
    run(&mut one, &robots(1, 30.0));
    assert_eq!(next(&mut one, 30.0).1, usual);
}

#[test]
fn one_robot_at_four_times_its_power_moves_no_other_by_a_twentieth() {
    for others in [2, 7, 11, 30] {
        let [usual, moved] = [1.0, 4.0].map(|factor| {
            let mut all = robots(others, MEAN_W);
            all.push((others, factor * MEAN_W));
            let mut fleet = fleet();
            run(&mut fleet, &all);
            next(&mut fleet, MEAN_W)
        });
        let by = (moved.0 / usual.0 - 1.0).abs();
        assert!(by <= 0.05, "beside {others}: {} W to {} W", usual.0, moved.0);
        assert!((moved.1 - usual.1).abs() <= 0.05, "beside {others}: {} to {}", usual.1, moved.1);
    }
}

#[test]
fn what_robots_draw_on_their_chargers_is_not_remembered() {
    let mut fleet = fleet();
    let mut source = Source::new(1, 1);
    for step in 0..1_500 {
        let of_step = |robot| sample(robot, step, 0.1 * MEAN_W).with(sample_flag::CHARGING);
        let frame: Vec<Sample> = (0..20).map(of_step).collect();
        source.tick(&mut fleet, &frame, START_NS + step * PERIOD_NS);
    }
    let [power, _, trust] = [0, 1, 2].map(|quantity| {
        seen(&fleet).groups.iter().map(|shown| shown[quantity][0]).fold(0.0, f32::max)
    });
    assert_eq!([power, trust], [0.0; 2]);
}

#[test]
fn the_order_of_robots_moves_no_bit_of_it_and_neither_does_a_refused_sample() {
    let all = robots(20, 1.3 * MEAN_W);
    let mut expected = fleet();
    run(&mut expected, &all);
    let mut reversed = fleet();
    run(&mut reversed, &all.iter().rev().copied().collect::<Vec<_>>());
    assert_eq!(seen(&reversed), seen(&expected));
    let (mut refusing, mut source) = (fleet(), Source::new(3, 1));
    for (step, power_w) in [f32::NAN, 1e9, -1e9, f32::INFINITY].into_iter().enumerate() {
        let now_ns = START_NS - 10_000 * MS + step as u64 * PERIOD_NS;
        let refused = Sample::new(50, step as u64, now_ns).reading(power_w, now_ns);
        source.tick(&mut refusing, &[refused], now_ns);
    }
    assert_eq!(refusing.drops().total(), 4);
    run(&mut refusing, &all);
    assert_eq!(seen(&refusing), seen(&expected));
    assert!(seen(&expected).groups.as_flattened().iter().any(|[weight, _]| *weight > 0.0));
}
