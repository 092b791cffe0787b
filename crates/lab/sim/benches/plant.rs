//! Robot-steps per second of the simulated live fleet, of the trials, and of the seven robots with
//! their barriers. One thread.
//!
//! `cargo bench -p joulebus-sim --bench plant`; figures on stderr, JSON on stdout.

use std::hint::black_box;
use std::time::Instant;

use joulebus_plant::Plant;
use joulebus_plant::arena::STEP_S;
use joulebus_plant::parts::Parts;
use joulebus_plant::protocol::{Protocol, SAMPLES};
use joulebus_sim::protocol::drive;
use joulebus_sim::scenario;

const REPEATS: u32 = 5;
const FLEET: usize = 1_000;
const FLEET_STEPS: usize = 1_000;
const SCENARIO_STEPS: usize = 20_000;

fn main() {
    let fleet = median(|seed| {
        let mut plant = Plant::new(seed, FLEET);
        for _ in 0..FLEET_STEPS {
            black_box(plant.step(STEP_S));
        }
        FLEET * FLEET_STEPS
    });
    let trials = median(|seed| {
        for protocol in Protocol::ALL {
            black_box(drive(protocol, seed));
        }
        Protocol::ALL.len() * SAMPLES
    });
    let mut solved_steps = 0;
    let robots = median(|seed| {
        let run = scenario::run(Parts::default(), seed, SCENARIO_STEPS);
        solved_steps = run.solved_steps;
        scenario::ROBOTS * SCENARIO_STEPS
    });
    let solved_share = solved_steps as f64 / SCENARIO_STEPS as f64;
    eprintln!("million robot-steps a second, one thread, median of {REPEATS}:");
    eprintln!("  live fleet of {FLEET}:          {:.2}", fleet / 1e6);
    eprintln!("  six trials, recorded:          {:.2}", trials / 1e6);
    eprintln!(
        "  seven robots, recorded:        {:.2} (a program solved in {:.0} % of the steps)",
        robots / 1e6,
        100.0 * solved_share
    );
    println!(
        "{{\"robot_steps_per_s\":{{\"fleet\":{fleet:.0},\"trials\":{trials:.0},\
         \"seven_robots\":{robots:.0}}},\"solved_share\":{solved_share:.4}}}"
    );
}

/// Robot-steps per second, median of runs with different seeds.
fn median(mut run: impl FnMut(u64) -> usize) -> f64 {
    let mut rates: Vec<f64> = (0..REPEATS)
        .map(|seed| {
            let start = Instant::now();
            let steps = run(u64::from(seed));
            steps as f64 / start.elapsed().as_secs_f64()
        })
        .collect();
    rates.sort_by(f64::total_cmp);
    rates[rates.len() / 2]
}
