//! Cost of a keyframe for the tick (a copy) and the checkpointer (the encoding): figures, no
//! guarantee.
//!
//! `cargo test --release -p joulebus-fleet --test all state_cost -- --ignored --nocapture`

use std::time::Instant;

use joulebus_fleet::{Fleet, FleetState};
use joulebus_testkit_fleets::{self as world, MS, PERIOD_NS, Source, healthy};
use joulebus_wire::Sample;

const START_NS: u64 = 60_000 * MS;

/// Robots of one platform that have sent enough samples to fill all state.
fn fleet(robots: u32) -> Fleet {
    let mut settings = world::settings(robots);
    settings.platforms.truncate(1);
    settings.platforms[0].robots = vec![0..=robots];
    let models = world::models().into_iter().take(1).collect();
    let mut fleet = Fleet::new(settings, models).expect("the settings agree with themselves");
    let mut source = Source::new(1, 1);
    for step in 0..20 {
        let now_ns = START_NS + step * PERIOD_NS;
        let sample = |robot| -> Sample { healthy(robot, step, now_ns, PERIOD_NS) };
        let frame: Vec<Sample> = (0..robots).map(sample).collect();
        source.tick(&mut fleet, &frame, now_ns);
    }
    fleet
}

/// Median time of `work`, µs.
fn median_us(mut work: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..31)
        .map(|_| {
            let begun = Instant::now();
            work();
            begun.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

#[test]
#[ignore = "prints figures: CONTRIBUTING.md has the command"]
fn what_a_keyframe_costs() {
    println!("robots   copy µs   encode µs   decode µs   restore µs   bytes a robot");
    for robots in [100, 1_000, 10_000, 100_000] {
        let mut fleet = fleet(robots);
        let mut state = fleet.state();
        // Evicts the columns from the cache, as between two ticks.
        let mut others = vec![1_u8; 64 << 20];
        let mut copies = Vec::new();
        for _ in 0..15 {
            others.iter_mut().for_each(|byte| *byte = byte.wrapping_add(1));
            let begun = Instant::now();
            fleet.state_into(&mut state);
            copies.push(begun.elapsed().as_secs_f64() * 1e6);
        }
        copies.sort_by(f64::total_cmp);
        let mut bytes = Vec::new();
        let encode_us = median_us(|| state.encode_into(&mut bytes));
        let decode_us = median_us(|| drop(FleetState::decode(&bytes).expect("encoded above")));
        let restore_us = median_us(|| fleet.restore_state(&state).expect("its own state"));
        println!(
            "{robots:6}  {:8.0}  {encode_us:10.0}  {decode_us:10.0}  {restore_us:11.0}  {:14.0}",
            copies[copies.len() / 2],
            bytes.len() as f64 / f64::from(robots)
        );
    }
}
