//! Sharding, tiles, threads and instruction sets do not affect the outputs, and the written output
//! equals the fleet's.

use joulebus_fleet::{Batch, Fleet, OutputRows, Outputs, Shard};
use joulebus_predictor::Kernel;
use joulebus_testkit_fleets::random::Noise;
use joulebus_testkit_fleets::{self as world, MS, PERIOD_NS, SLOW_NS, Source, healthy, row_bits};
use joulebus_wire::{Sample, sample_flag};
use proptest::prelude::*;

const START_NS: u64 = 60_000 * MS;
const ROBOTS: u32 = 300;

/// A frame with robots of all platforms mixed; some are missing, doubled, or invalid, and sometimes
/// whole platforms are silent until they leave.
fn frame(step: u64, now_ns: u64, noise: &mut Noise) -> Vec<Sample> {
    let mut samples = Vec::new();
    for place in 0..ROBOTS {
        let robot = place * 7 % ROBOTS;
        if (step / 90 + u64::from(robot) / 100).is_multiple_of(4) {
            continue;
        }
        let period_ns = if robot / 100 == 1 { SLOW_NS } else { PERIOD_NS };
        let mut sample = healthy(robot, 2 * step, now_ns, period_ns);
        match noise.next_u64() % 24 {
            0 | 1 => continue,
            2 => sample.power_w = f32::NAN,
            3 => sample.flags &= !sample_flag::POWER,
            4 => sample.flags &= !sample_flag::V,
            5 => {
                let mut earlier = sample;
                (earlier.seq, earlier.stamp_ns) = (sample.seq - 1, now_ns - period_ns / 3);
                earlier.measured_ns = earlier.measured_ns.min(earlier.stamp_ns);
                samples.push(earlier);
            }
            6 => sample.flags |= sample_flag::DISCONTINUITY,
            7 => sample = sample.state_of_charge((noise.next_u64() % 101) as f32 / 100.0),
            8 => sample = sample.return_energy((noise.next_u64() % 9_000) as f32),
            9 => sample.flags |= sample_flag::CHARGING | sample_flag::FULL,
            10 | 11 => sample.flags |= sample_flag::CHARGING,
            12 => sample.flags |= sample_flag::SWAPPED,
            _ => {}
        }
        samples.push(sample);
    }
    samples
}

/// Ticks a shard, split randomly and spread over threads.
fn scatter(shard: Shard<'_>, outputs: Outputs<'_>, seed: u64, depth: u32) {
    let mut noise = Noise(seed);
    if depth == 0 || shard.is_empty() {
        let mut batch = Batch::of_slots(1 + (noise.next_u64() % 700) as usize);
        return tick(shard, outputs, &mut batch, noise.next_u64().is_multiple_of(2));
    }
    let robots = (noise.next_u64() % (shard.len() as u64 + 1)) as usize;
    let (first, second) = shard.split_at(robots);
    assert!(first.len() >= robots && first.len() < robots + 64);
    let (to_first, to_second) = outputs.split_at(first.len());
    let (one, other) = (noise.next_u64(), noise.next_u64());
    std::thread::scope(|scope| {
        scope.spawn(move || scatter(second, to_second, other, depth - 1));
        scatter(first, to_first, one, depth - 1);
    });
}

fn tick(mut shard: Shard<'_>, outputs: Outputs<'_>, batch: &mut Batch, in_two: bool) {
    if !in_two {
        return shard.run(batch, outputs, &mut |_| {});
    }
    shard.forecast(batch, outputs.forecasts, &mut |_| {});
    shard.account(batch, outputs.secondary, &mut |_| {});
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases.min(12)))]

    #[test]
    fn no_bit_depends_on_tiles_shards_threads_or_the_processor(
        seed in any::<u64>(), depth in 0u32..4, kernel in prop::sample::select(&Kernel::ALL[..]),
    ) {
        let mut noise = Noise(seed);
        let new = |models| Fleet::new(world::learning(ROBOTS), models).expect("they agree");
        let mut whole = new(world::models());
        let mut shared = new(world::models_on(kernel));
        let mut source = Source::new(1, 1);
        let mut rows = OutputRows::new(ROBOTS as usize);
        let mut lengths = (usize::MAX, 0);
        for step in 1..260 {
            let now_ns = START_NS + step * SLOW_NS;
            let samples = frame(step, now_ns, &mut noise);
            let header = source.frame(samples.len());
            for fleet in [&mut whole, &mut shared] {
                fleet.take(&header, &samples, now_ns);
            }
            let missed = step % 50 == 0;
            let intake = whole.tick(now_ns, missed);
            prop_assert_eq!(shared.begin(now_ns, missed), intake);
            let robots = shared.len();
            prop_assert_eq!(robots, whole.len());
            scatter(shared.shard(), rows.outputs(robots), noise.next_u64(), depth);
            for place in 0..robots {
                let expected = row_bits(&whole.forecast(place));
                prop_assert_eq!(&row_bits(&rows.forecasts[place]), &expected, "step {}", step);
                prop_assert_eq!(row_bits(&shared.forecast(place)), expected);
                let expected = row_bits(&whole.diagnostic(place));
                prop_assert_eq!(row_bits(&rows.diagnostics[place]), expected, "step {}", step);
                let expected = row_bits(&whole.budget(place));
                prop_assert_eq!(row_bits(&rows.budgets[place]), expected, "step {}", step);
                let expected = row_bits(&whole.plan_state(place));
                prop_assert_eq!(row_bits(&rows.plan_states[place]), expected, "step {}", step);
                let expected = row_bits(&whole.outlook(place));
                prop_assert_eq!(row_bits(&rows.outlooks[place]), expected, "step {}", step);
            }
            if step > 100 {
                lengths = (lengths.0.min(robots), lengths.1.max(robots));
            }
        }
        prop_assert!(lengths.0 < lengths.1, "robots joined and left: {lengths:?}");
        prop_assert_eq!(whole.drops(), shared.drops());
        prop_assert_eq!(encoded(&whole), encoded(&shared), "internal state");
    }
}

fn encoded(fleet: &Fleet) -> Vec<u8> {
    let mut bytes = Vec::new();
    fleet.state().encode_into(&mut bytes);
    bytes
}
