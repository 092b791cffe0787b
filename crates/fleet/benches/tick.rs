//! Where a tick's time goes, by fleet size, on one thread: `cargo bench -p joulebus-fleet`.
//!
//! Each round takes a frame with a sample of every robot and ticks, with everything written out;
//! between two rounds the network alone runs over as many rows, tile by tile. Figures are medians
//! over the rounds, ns per robot, and the tick as a multiple of the network. `cargo bench -p
//! joulebus-fleet -- 512` sets the slots in a tile.

#[path = "../../predictor/tests/random/mod.rs"]
#[allow(dead_code)]
mod random;

use std::hint::black_box;
use std::time::Instant;

use joulebus_fleet::{
    AlarmSettings, Batch, Battery, Fleet, Intake, IntervalSettings, Outputs, Platform, Settings,
    Stage,
};
use joulebus_predictor::{FEATURES, FeatureSet, Model};
use joulebus_wire::{Budget, Diagnostic, Forecast, SCHEMA_VERSION, Sample, SampleHeader};
use random::Noise;

const FLEETS: [usize; 5] = [100, 1_000, 10_000, 100_000, 300_000];
const PERIOD_NS: u64 = 33_333_333;
const MS: u64 = 1_000_000;
/// Rounds that are not counted: windows fill and alarms settle.
const WARM_UP: usize = 12;
/// Frames of memory that outputs take turns in, as in shared memory.
const FRAMES: usize = 3;
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
    fleet: Fleet,
    model: Model,
    batch: Batch,
    samples: Vec<Sample>,
    header: SampleHeader,
    forecasts: Vec<Vec<Forecast>>,
    diagnostics: Vec<Vec<Diagnostic>>,
    budgets: Vec<Vec<Budget>>,
    columns: Vec<Vec<f32>>,
    out_w: Vec<f32>,
    noise: Noise,
}

impl Bench {
    fn new(robots: usize, tile: Option<usize>) -> Self {
        let model = Model::Network(random::network(1, FeatureSet::Full));
        let settings = settings(robots as u32);
        let mut noise = Noise(3);
        Self {
            fleet: Fleet::new(settings, vec![model.clone()]).expect("the settings are fine"),
            model,
            batch: tile.map_or_else(Batch::default, Batch::of_slots),
            samples: (0..robots as u32)
                .map(|robot| Sample::new(robot, 0, 0))
                .collect(),
            header: SampleHeader {
                schema: SCHEMA_VERSION,
                source_id: 1,
                source_epoch: 1,
                ..SampleHeader::default()
            },
            forecasts: vec![vec![Forecast::default(); robots]; FRAMES],
            diagnostics: vec![vec![Diagnostic::default(); robots]; FRAMES],
            budgets: vec![vec![Budget::default(); robots]; FRAMES],
            columns: (0..FEATURES)
                .map(|_| (0..robots).map(|_| noise.next_f32()).collect())
                .collect(),
            out_w: vec![0.0; robots],
            noise,
        }
    }

    /// Times in ns: intake, four stages, the tick in one go, the tick with forecasts first (one of
    /// the two is NaN), the network alone.
    fn round(&mut self, round: usize) -> [f64; 8] {
        let now_ns = 60_000 * MS + round as u64 * PERIOD_NS;
        for sample in &mut self.samples {
            *sample = Sample::new(sample.robot, round as u64, now_ns)
                .command(0.2 * self.noise.next_f32(), self.noise.next_f32())
                .reading(3.6 + 0.3 * self.noise.next_f32(), now_ns);
        }
        let start = Instant::now();
        self.fleet.take(&self.header, &self.samples, now_ns);
        let intake = start.elapsed().as_nanos() as f64;
        self.header.samples_before += self.samples.len() as u64;

        let turn = round % FRAMES;
        let outputs = Outputs {
            forecasts: &mut self.forecasts[turn],
            diagnostics: &mut self.diagnostics[turn],
            budgets: &mut self.budgets[turn],
        };
        let mut stages = [0.0; 4];
        let start = Instant::now();
        let mut last = start;
        let mut on = |stage: Stage| {
            let now = Instant::now();
            stages[stage as usize] += (now - last).as_nanos() as f64;
            last = now;
        };
        self.fleet.begin(now_ns, false);
        let mut share = self.fleet.share();
        let in_two = round % 2 == 1;
        if in_two {
            share.forecast(&mut self.batch, outputs.forecasts, &mut on);
            share.account(
                &mut self.batch,
                outputs.diagnostics,
                outputs.budgets,
                &mut on,
            );
        } else {
            share.run(&mut self.batch, outputs, &mut on);
        }
        let tick = start.elapsed().as_nanos() as f64;
        black_box(&self.forecasts[turn]);
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
            let columns = std::array::from_fn(|feature| &self.columns[feature][from..to]);
            self.model.predict_columns(black_box(columns), out_w);
        }
        black_box(&self.out_w);
        start.elapsed().as_nanos() as f64
    }
}

fn settings(capacity: u32) -> Settings {
    Settings {
        capacity,
        intake: Intake {
            max_samples_per_tick: 8,
            max_jump_ns: 60_000 * MS,
            leave_after_ns: 30_000 * MS,
            max_sources: 64,
        },
        interval: IntervalSettings {
            coverage: 0.9,
            rate: 0.02,
        },
        alarms: AlarmSettings {
            bias_weight: 0.005,
            cusum_slack: 1.0,
            cusum_limit: 50.0,
            noise_weight: 0.005,
            noise_limit: 15.0,
            mismatch_limit: 1.5,
            settle_samples: 300,
            raise_samples: 15,
            clear_samples: 90,
            training_margin: 0.1,
        },
        platforms: vec![Platform {
            name: "wheeled".to_owned(),
            robots: vec![0..=capacity],
            period_ns: PERIOD_NS,
            stale_after_ns: 500 * MS,
            hold_max_ns: 500 * MS,
            stuck_after_ns: 10_000 * MS,
            power_min_w: 0.0,
            power_max_w: 20.0,
            v_max_mps: 2.0,
            omega_max_radps: 3.0,
            power_resolution_w: 0.01,
            battery: Some(Battery {
                capacity_j: 10_000.0,
                reserve: 0.1,
                initial_soc: 0.9,
                initial_soc_lo: 0.8,
            }),
        }],
    }
}
