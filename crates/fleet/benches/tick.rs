//! Where a tick's time goes, by fleet size, on one thread: `cargo bench -p joulebus-fleet`.
//!
//! Each round takes a frame with a sample of every robot and ticks, with everything written out;
//! between two rounds the network alone runs over as many rows, tile by tile. Figures are medians
//! over the rounds, ns per robot, and the tick as a multiple of the network. `cargo bench -p
//! joulebus-fleet -- 512` sets the slots in a tile, `-- learning` has every robot learn online: a
//! mixture, a level and a gain. `-- mixed` has three platforms, whose robots send in turn, `-- holes`
//! one sample in ten without a reading.

mod world;

use std::hint::black_box;
use std::time::Instant;

use joulebus_fleet::{Batch, Outputs, Stage};
use joulebus_predictor::INPUTS;
use world::{FRAMES, World};

const FLEETS: [usize; 5] = [100, 1_000, 10_000, 100_000, 300_000];
/// Rounds that are not counted: windows fill and alarms settle.
const WARM_UP: usize = 12;
/// Intake, the four stages of the tick, and the network alone.
const COLUMNS: [&str; 9] = [
    "intake", "features", "network", "bookkeep", "writing", "tick", "in two", "kernel", "ratio",
];

fn main() {
    let tile = std::env::args().find_map(|argument| argument.parse().ok());
    println!("ns per robot, medians; tiles of {tile:?} slots");
    print!("{:>8}", "robots");
    for name in COLUMNS {
        print!("{name:>10}");
    }
    println!();
    for robots in FLEETS {
        let mut bench = Bench::new(robots, tile);
        let rounds = (3_000_000 / robots).clamp(20, 2_000) + WARM_UP;
        let mut times: Vec<[f64; 8]> = (0..rounds).map(|round| bench.round(round)).collect();
        times.drain(..WARM_UP);
        let median = |column: usize| {
            let mut all: Vec<f64> = times.iter().map(|times| times[column]).collect();
            all.retain(|time| !time.is_nan());
            all.sort_by(f64::total_cmp);
            all[all.len() / 2] / robots as f64
        };
        print!("{robots:>8}");
        for column in 0..8 {
            print!("{:>10.1}", median(column));
        }
        println!("{:>10.2}", median(5) / median(7));
    }
}

struct Bench {
    world: World,
    batch: Batch,
    columns: Vec<Vec<f32>>,
    out_w: Vec<f32>,
}

impl Bench {
    fn new(robots: usize, tile: Option<usize>) -> Self {
        let mut world = World::new(robots);
        let noise = &mut world.noise;
        Self {
            columns: (0..INPUTS)
                .map(|_| (0..robots).map(|_| noise.next_f32()).collect())
                .collect(),
            world,
            batch: tile.map_or_else(Batch::default, Batch::of_slots),
            out_w: vec![0.0; robots],
        }
    }

    /// Times in ns: intake, four stages, the tick in one go, the tick with forecasts first (one of
    /// the two is NaN), the network alone.
    fn round(&mut self, round: usize) -> [f64; 8] {
        let (now_ns, taken_in_s) = self.world.take(round);
        let intake = taken_in_s * 1e9;
        let World {
            fleet,
            forecasts,
            diagnostics,
            budgets,
            ..
        } = &mut self.world;
        let turn = round % FRAMES;
        let outputs = Outputs {
            forecasts: &mut forecasts[turn],
            diagnostics: &mut diagnostics[turn],
            budgets: &mut budgets[turn],
        };
        let mut stages = [0.0; 4];
        let start = Instant::now();
        let mut last = start;
        let mut on = |stage: Stage| {
            let now = Instant::now();
            stages[stage as usize] += (now - last).as_nanos() as f64;
            last = now;
        };
        fleet.begin(now_ns, false);
        let mut shard = fleet.shard();
        let in_two = round % 2 == 1;
        if in_two {
            shard.forecast(&mut self.batch, outputs.forecasts, &mut on);
            shard.account(
                &mut self.batch,
                outputs.diagnostics,
                outputs.budgets,
                &mut on,
            );
        } else {
            shard.run(&mut self.batch, outputs, &mut on);
        }
        let tick = start.elapsed().as_nanos() as f64;
        black_box(&forecasts[turn]);
        let nan = f64::NAN;
        let [features, network, bookkeeping, writing] = if in_two { [nan; 4] } else { stages };
        let (one, two) = if in_two { (nan, tick) } else { (tick, nan) };
        let kernel = self.kernel();
        [
            intake,
            features,
            network,
            bookkeeping,
            writing,
            one,
            two,
            kernel,
        ]
    }

    fn kernel(&mut self) -> f64 {
        const TILE: usize = 512;
        let start = Instant::now();
        for (index, out_w) in self.out_w.chunks_mut(TILE).enumerate() {
            let (from, to) = (index * TILE, index * TILE + out_w.len());
            let column = |feature: usize| self.columns.get(feature).map(|column| &column[from..to]);
            // Freshness is not read: those columns may be empty.
            let columns = std::array::from_fn(|feature| column(feature).unwrap_or_default());
            self.world.model.predict_columns(black_box(columns), out_w);
        }
        black_box(&self.out_w);
        start.elapsed().as_nanos() as f64
    }
}
