//! What threads are worth to a tick: `cargo bench -p joulebus-predictor-worker`.
//!
//! The same fleet ticks on one thread and on two in turns, with everything written out, each thread
//! on a processor of its own; between two ticks the process sleeps, as a worker does. Medians and
//! 99.9th percentiles, µs, and the median of one thread over that of two.

#[path = "../../fleet/benches/world/mod.rs"]
#[allow(dead_code)]
mod world;

use std::time::{Duration, Instant};

use joulebus_bus::Scheduling;
use joulebus_fleet::Outputs;
use joulebus_predictor_worker::TickPool;
use world::{FRAMES, World};

const FLEETS: [usize; 6] = [1_000, 2_000, 4_000, 10_000, 100_000, 300_000];
const ROUNDS: usize = 400;
const WARM_UP: usize = 12;
const SLEEP: Duration = Duration::from_millis(10);

fn main() {
    let scheduling = Scheduling {
        cpus: vec![0, 1],
        ..Scheduling::default()
    };
    for refused in scheduling.apply().into_iter().flatten() {
        println!("{refused}");
    }
    let crews = [2, 1].map(|threads| {
        TickPool::assemble(threads, 1, &scheduling).expect("threads can be started")
    });
    println!(
        "{:>8}{:>24}{:>24}{:>8}",
        "robots", "one thread", "two threads", "ratio"
    );
    for robots in FLEETS {
        let mut world = World::new(robots);
        let rounds = (4_000_000 / robots).clamp(40, ROUNDS) + WARM_UP;
        let mut times = [Vec::new(), Vec::new()];
        for round in 0..rounds {
            let (now_ns, _) = world.take(round);
            std::thread::sleep(SLEEP);
            let turn = round % FRAMES;
            let outputs = Outputs {
                forecasts: &mut world.forecasts[turn],
                diagnostics: &mut world.diagnostics[turn],
                budgets: &mut world.budgets[turn],
            };
            let start = Instant::now();
            world.fleet.begin(now_ns, false);
            crews[round % 2].run(world.fleet.shard(), outputs);
            if round >= WARM_UP {
                times[round % 2].push(start.elapsed().as_secs_f64() * 1e6);
            }
        }
        let [two, one] = times.map(|mut times| {
            times.sort_by(f64::total_cmp);
            let last = times.len() - 1;
            (times[last / 2], times[last * 999 / 1000])
        });
        println!(
            "{robots:>8}{:>12.0}{:>12.0}{:>12.0}{:>12.0}{:>8.2}",
            one.0,
            one.1,
            two.0,
            two.1,
            one.0 / two.0
        );
    }
}
