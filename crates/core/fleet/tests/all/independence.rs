//! The output of one robot depends on that robot's samples alone, except for what the robots of a
//! platform learn together: the bounds of its energy's errors, the shares of its outlook, the priors
//! of its lasting power and of its trust in commands, how its first forecasts start, and the alarms
//! of its level.

use joulebus_fleet::Fleet;
use joulebus_testkit_fleets::random::Noise;
use joulebus_testkit_fleets::{
    self as world, Bits, MS, PERIOD_NS, SLOW_NS, Source, fleet, forecast, healthy,
    own_bits as bits, place, quality,
};
use joulebus_wire::{InvalidReason, Quality, Sample, forecast_flag, sample_flag};
use proptest::prelude::*;

const START_NS: u64 = 60_000 * MS;
const ROBOT: u32 = 7;

/// A robot's samples: sometimes one is missing, has no reading or no command.
fn samples(robot: u32, period_ns: u64, steps: u64, noise: &mut Noise) -> Vec<Sample> {
    (0..steps)
        .filter_map(|step| {
            let mut sample = healthy(robot, step, START_NS + step * period_ns, period_ns);
            match noise.next_u64() % 20 {
                0 => return None,
                1 => sample.flags &= !sample_flag::POWER,
                2 => sample.flags |= sample_flag::CHARGING,
                3 if step > 40 => sample.flags |= sample_flag::DISCONTINUITY,
                _ => {}
            }
            Some(sample)
        })
        .collect()
}

/// The output of a robot after all its samples, alone in the fleet, one tick per sample; the last
/// sample arrives at `end_ns`.
fn alone(samples: &[Sample], end_ns: u64) -> Bits {
    let (mut fleet, mut source) = (fleet(1), Source::new(1, 1));
    let (last, before) = samples.split_last().expect("it has sent samples");
    for sample in before {
        source.tick(&mut fleet, &[*sample], sample.stamp_ns);
    }
    source.tick(&mut fleet, &[*last], end_ns);
    bits(&fleet, last.robot).expect("it has sent samples")
}

fn shuffle<T>(items: &mut [T], noise: &mut Noise) {
    for at in (1..items.len()).rev() {
        items.swap(at, (noise.next_u64() % (at as u64 + 1)) as usize);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, ..ProptestConfig::default() })]

    /// For any batch, slot, order within a frame, tick times and number of samples per tick.
    #[test]
    fn a_robots_output_is_the_same_alone_and_among_others(
        seed in any::<u64>(), others in 1u32..40, most_ticks_apart in 1u64..4,
    ) {
        let mut noise = Noise(seed);
        let mut ids: Vec<u32> = (0..=others).map(|n| n % 3 * 100 + n).collect();
        shuffle(&mut ids, &mut noise);
        let mut all: Vec<Vec<Sample>> = ids
            .iter()
            .map(|id| {
                let period_ns = if *id / 100 == 1 { SLOW_NS } else { PERIOD_NS };
                samples(*id, period_ns, 80, &mut noise)
            })
            .collect();
        let end_ns = START_NS + 81 * SLOW_NS;
        let expected: Vec<Bits> = all.iter().map(|samples| alone(samples, end_ns)).collect();

        let (mut fleet, mut source) = (fleet(others + 1), Source::new(1, 1));
        let mut now_ns = START_NS;
        while all.iter().any(|samples| samples.len() > 1) {
            now_ns += 1 + noise.next_u64() % (most_ticks_apart * PERIOD_NS);
            deliver(&mut fleet, &mut source, &mut all, now_ns, &mut noise);
            fleet.tick(now_ns, false);
        }
        prop_assert_eq!(fleet.drops().total(), 0);
        let last: Vec<Sample> = all.iter().map(|samples| samples[0]).collect();
        source.tick(&mut fleet, &last, end_ns);
        for (id, expected) in ids.iter().zip(expected) {
            prop_assert_eq!(bits(&fleet, *id), Some(expected), "robot {}", id);
        }
    }
}

/// Sends the samples due by `now_ns` as frames with the robots in random order, at most four
/// samples per robot, the limit of a tick. The last sample of each is held back.
fn deliver(
    fleet: &mut Fleet,
    source: &mut Source,
    all: &mut [Vec<Sample>],
    now_ns: u64,
    noise: &mut Noise,
) {
    let mut order: Vec<usize> = (0..all.len()).collect();
    for _ in 0..4 {
        shuffle(&mut order, noise);
        let mut frame = Vec::new();
        for at in &order {
            if all[*at].len() > 1 && all[*at][0].stamp_ns <= now_ns {
                frame.push(all[*at].remove(0));
            }
        }
        source.send(fleet, &frame, now_ns);
    }
}

/// Runs robots for 60 steps, one tick each, and returns their outputs at every step.
fn run(
    fleet: &mut Fleet,
    robots: &[u32],
    spoil: impl Fn(u32, u64, &mut Sample),
) -> Vec<Vec<Option<Bits>>> {
    let mut source = Source::new(1, 1);
    (0..60)
        .map(|step| {
            let now_ns = START_NS + step * PERIOD_NS;
            let frame: Vec<Sample> = robots
                .iter()
                .map(|robot| {
                    let mut sample = healthy(*robot, step, now_ns, PERIOD_NS);
                    spoil(*robot, step, &mut sample);
                    sample
                })
                .collect();
            source.tick(fleet, &frame, now_ns);
            robots.iter().map(|robot| bits(fleet, *robot)).collect()
        })
        .collect()
}

#[test]
fn an_invalid_robot_changes_no_bit_of_any_other() {
    let robots: Vec<u32> = (0..20).collect();
    let healthy = run(&mut fleet(20), &robots, |_, _, _| {});
    let values = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -f32::MAX, 1e-40, -1.0];
    for poisoned in [0, 7, 19] {
        let found = run(&mut fleet(20), &robots, |robot, step, sample| {
            if robot == poisoned && step >= 10 {
                let value = values[step as usize % values.len()];
                match step % 4 {
                    0 => sample.power_w = value,
                    1 => sample.v_mps = value,
                    2 => sample.omega_radps = value,
                    _ => sample.stamp_ns = u64::from(value.to_bits()) << 32,
                }
            }
        });
        for (step, (found, healthy)) in found.iter().zip(&healthy).enumerate() {
            for robot in robots.iter().map(|robot| *robot as usize) {
                let same = found[robot] == healthy[robot];
                assert!(same || robot == poisoned as usize, "robot {robot} at step {step}");
                assert!(!same || robot != poisoned as usize || step < 10, "nothing was invalid");
            }
        }
    }
}

#[test]
fn robots_beyond_the_capacity_change_no_bit_of_the_others() {
    let first: Vec<u32> = (0..10).collect();
    let all: Vec<u32> = (0..30).collect();
    let expected = run(&mut fleet(10), &first, |_, _, _| {});
    let found = run(&mut fleet(10), &all, |_, _, _| {});
    for (step, (found, expected)) in found.iter().zip(&expected).enumerate() {
        assert_eq!(found[..10], expected[..], "step {step}");
        assert!(found[10..].iter().all(Option::is_none), "step {step}");
    }
}

#[test]
fn a_reassigned_slot_has_no_state_of_its_last_robot_and_accounts_continue() {
    let (mut fleet, mut source) = (fleet(2), Source::new(1, 1));
    let mut send = |fleet: &mut Fleet, robot: u32, step: u64, now_ns: u64| {
        source.tick(fleet, &[healthy(robot, step, now_ns, PERIOD_NS)], now_ns);
    };
    for step in 0..20 {
        send(&mut fleet, ROBOT, step, START_NS + step * PERIOD_NS);
    }
    assert_eq!(forecast(&fleet, ROBOT).generation, 0);
    let account = fleet.ledger(ROBOT).expect("it has sent samples");
    let left_ns = START_NS + 19 * PERIOD_NS + 2_500 * MS + 1;
    fleet.tick(left_ns, false);
    assert!(fleet.is_empty());
    assert_eq!(fleet.ledger(ROBOT), Some(account), "the account of a departed robot");

    for step in 0..20 {
        let now_ns = left_ns + step * PERIOD_NS;
        send(&mut fleet, 8, step, now_ns);
        let shown = forecast(&fleet, 8);
        assert_eq!(shown.generation, 1);
        if step < 4 {
            assert_eq!(shown.quality(), Quality::Warmup { have: step as u16 + 1 });
            assert_eq!(shown.flags & forecast_flag::POWER, 0);
        }
        let sent: Vec<Sample> = (0..=step)
            .map(|step| healthy(8, step, left_ns + step * PERIOD_NS, PERIOD_NS))
            .collect();
        assert_eq!(bits(&fleet, 8), Some(alone(&sent, now_ns)), "step {step}");
    }

    let back_ns = left_ns + 19 * PERIOD_NS + 2_500 * MS + 1;
    fleet.tick(back_ns, false);
    send(&mut fleet, ROBOT, 40, back_ns);
    assert_eq!(forecast(&fleet, ROBOT).generation, 2);
    assert_eq!(forecast(&fleet, ROBOT).quality(), Quality::Warmup { have: 1 });
    let again = fleet.ledger(ROBOT).expect("it has sent samples");
    assert_eq!(again.drawn_uj, account.drawn_uj);
    assert_eq!(again.metered_ns, account.metered_ns);
    let away_ns = back_ns - (START_NS + 19 * PERIOD_NS);
    assert_eq!(again.unmetered_ns, account.unmetered_ns + away_ns);
}

#[test]
fn the_first_owner_keeps_the_robot_and_the_second_source_changes_no_bit() {
    let expected = run(&mut fleet(2), &[ROBOT], |_, _, _| {});
    let (mut fleet, mut intruder) = (fleet(2), Source::new(2, 99));
    let mut first = Source::new(1, 1);
    for step in 0..60 {
        let now_ns = START_NS + step * PERIOD_NS;
        first.send(&mut fleet, &[healthy(ROBOT, step, now_ns, PERIOD_NS)], now_ns);
        let mut foreign = healthy(ROBOT, 1_000 + step, now_ns + 1, PERIOD_NS);
        foreign.power_w = if step % 2 == 0 { f32::NAN } else { 9.0 };
        intruder.tick(&mut fleet, &[foreign], now_ns);
        assert_eq!(bits(&fleet, ROBOT), expected[step as usize][0], "step {step}");
    }
    let named = fleet.refusals()[0];
    assert_eq!((named.robot, named.pid, named.count), (ROBOT, intruder.header.pid, 60));
}

#[test]
fn a_robot_without_a_slot_gets_one_when_another_leaves() {
    let (mut fleet, mut source) = (fleet(1), Source::new(1, 1));
    source.tick(&mut fleet, &[healthy(1, 0, START_NS, PERIOD_NS)], START_NS);
    for step in 1..200 {
        let now_ns = START_NS + step * PERIOD_NS;
        source.tick(&mut fleet, &[healthy(2, step, now_ns, PERIOD_NS)], now_ns);
        let stale = Quality::Invalid(InvalidReason::Stale);
        assert!(place(&fleet, 1).is_none() || step < 31 || forecast(&fleet, 1).quality() == stale);
    }
    assert!(place(&fleet, 1).is_none());
    assert!(forecast(&fleet, 2).expected_w().is_some());
}

#[test]
fn a_robots_output_in_a_fleet_of_several_tiles_is_the_same_as_alone() {
    const ROBOTS: u32 = 2_200;
    let build = |capacity: u32| {
        let mut settings = world::settings(capacity);
        settings.platforms.truncate(1);
        settings.platforms[0].robots = vec![0..=ROBOTS];
        let models = world::models().into_iter().take(1).collect();
        Fleet::new(settings, models).expect("the settings are consistent")
    };
    let play = |fleet: &mut Fleet, robots: &[u32]| {
        let mut source = Source::new(1, 1);
        for step in 0..30 {
            let now_ns = START_NS + step * PERIOD_NS;
            // A gap in the middle, silence at the end.
            let sends =
                |robot: &&u32| !((12..15).contains(&step) && robot.is_multiple_of(5) || step > 25);
            let frame: Vec<Sample> = robots
                .iter()
                .filter(sends)
                .map(|robot| healthy(*robot, step, now_ns, PERIOD_NS))
                .collect();
            source.tick(fleet, &frame, now_ns);
        }
    };
    let mut together = build(ROBOTS);
    play(&mut together, &(0..ROBOTS).collect::<Vec<u32>>());
    for robot in [0, 5, 1_022, 1_023, 1_024, 1_025, 2_047, 2_048, 2_195, 2_199] {
        let mut alone = build(1);
        play(&mut alone, &[robot]);
        assert_eq!(quality(&alone, robot), Quality::OpenLoop { steps: 3 });
        assert_eq!(bits(&together, robot), bits(&alone, robot), "robot {robot}");
    }
}
