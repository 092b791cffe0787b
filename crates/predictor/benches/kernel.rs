//! Nanoseconds per robot of each kernel, tiling and batch size, and their share of what the core
//! can multiply and add: `cargo bench -p joulebus-predictor --bench kernel [filter]`.
//!
//! Weights are random: the arithmetic takes the same time for any finite weights. Rounds go over
//! all cells in turn and the figure is the smallest, so that a busy machine spoils few of them; the
//! peak is measured within each round, by multiply-adds that wait for nothing.

#![allow(
    unsafe_code,
    reason = "the peak is measured with the CPU's own instructions"
)]

use joulebus_predictor::{
    Activation, FEATURES, FeatureSet, Features, HIDDEN, INPUTS, Kernel, Layer, Model, ModelCard,
    Network, Normalisation, Parameters, ReadingAge, ResidualStats, RolloutStart, Rollouts, Scores,
    Tiling, TrainingRange,
};
use std::hint::black_box;
use std::time::Instant;

const BATCHES: [usize; 11] = [1, 2, 3, 4, 7, 16, 20, 100, 1_000, 10_000, 100_000];
const ROUNDS: usize = 25;
/// Multiply-adds of one forecast.
const MACS: usize = FEATURES * 64 + 64 * 64 + 64 * 32 + 32;
/// Candidates and steps of the rollout.
const ROLLOUT: (usize, usize) = (1_024, 50);

/// A multiplicative generator is enough for weights that nobody trains.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    }

    fn column(&mut self, count: usize) -> Vec<f32> {
        (0..count).map(|_| self.next()).collect()
    }
}

fn network(noise: &mut Noise) -> Network {
    let [first, second, third] = HIDDEN;
    let mut layer = |inputs: usize, outputs: usize| Layer {
        weights: (0..inputs * outputs)
            .map(|_| noise.next() / (inputs as f32).sqrt())
            .collect(),
        bias: (0..outputs).map(|_| noise.next()).collect(),
    };
    let parameters = Parameters {
        feature_set: FeatureSet::Full,
        normalisation: Normalisation {
            feature_mean: [0.0; INPUTS],
            feature_std: [1.0; INPUTS],
            power_mean_w: 3.65,
            power_std_w: 0.375,
        },
        activation: Activation::GeluErf,
        layers: [
            layer(FEATURES, first),
            layer(first, second),
            layer(second, third),
            layer(third, 1),
        ],
    };
    let card = ModelCard {
        name: "random".to_owned(),
        source: "random weights".to_owned(),
        training_data: "none".to_owned(),
        training_data_sha256: String::new(),
        seed: 0,
        training_range: TrainingRange {
            feature_set: FeatureSet::Full,
            min: [-1.0; INPUTS],
            max: [1.0; INPUTS],
        },
        linear: None,
        residual: ResidualStats {
            std_w: 0.1,
            q05_w: -0.1,
            q95_w: 0.1,
        },
        scores: Scores {
            rows: 0,
            network_r2: 0.0,
            network_mae_w: 0.0,
            persistence_r2: 0.0,
            persistence_mae_w: 0.0,
        },
    };
    Network::new(parameters, card).expect("random weights are finite and of the right size")
}

/// Multiply-adds per nanosecond of this core with the vectors of `kernel`, if it has a peak worth
/// the name.
fn peak(kernel: Kernel) -> Option<f64> {
    const TURNS: usize = 20_000;
    let start = Instant::now();
    let macs = match kernel {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the caller shows only kernels that this CPU can run.
        Kernel::Avx512 => unsafe { x86::avx512(TURNS) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Kernel::Avx2 => unsafe { x86::avx2(TURNS) },
        _ => return None,
    };
    Some(macs as f64 / start.elapsed().as_nanos() as f64)
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;
    use std::hint::black_box;

    /// Sums that do not wait for one another: more than a multiply-add takes cycles times the two
    /// that can start in a cycle.
    const SUMS: usize = 12;

    #[target_feature(enable = "avx512f")]
    pub(super) fn avx512(turns: usize) -> usize {
        let (x, y) = (
            black_box(_mm512_set1_ps(0.5)),
            black_box(_mm512_set1_ps(1.0)),
        );
        let mut sums = [_mm512_setzero_ps(); SUMS];
        for _ in 0..turns {
            for sum in &mut sums {
                *sum = _mm512_fmadd_ps(*sum, x, y);
            }
        }
        black_box(sums);
        turns * SUMS * 16
    }

    #[target_feature(enable = "avx2,fma")]
    pub(super) fn avx2(turns: usize) -> usize {
        let (x, y) = (
            black_box(_mm256_set1_ps(0.5)),
            black_box(_mm256_set1_ps(1.0)),
        );
        let mut sums = [_mm256_setzero_ps(); SUMS];
        for _ in 0..turns {
            for sum in &mut sums {
                *sum = _mm256_fmadd_ps(*sum, x, y);
            }
        }
        black_box(sums);
        turns * SUMS * 8
    }
}

/// What is measured: a batch of a size, or a rollout.
#[derive(Clone, Copy, PartialEq)]
enum Way {
    Columns,
    Rows,
    RowsByRobot,
    Rollout,
}

struct Cell {
    kernel: Kernel,
    way: Way,
    batch: usize,
    ns_per_robot: f64,
}

struct Bench {
    network: Network,
    rows: Vec<Features>,
    columns: [Vec<f32>; INPUTS],
    starts: Vec<RolloutStart>,
    commands: [Vec<f32>; 2],
    out_w: Vec<f32>,
}

impl Bench {
    fn run(&mut self, cell: &Cell) -> f64 {
        let network = self.network.clone().with_kernel(cell.kernel);
        let network = network.expect("only kernels that this CPU can run have cells");
        let tiling = match cell.way {
            Way::RowsByRobot => Tiling::BatchMajor,
            _ => Tiling::ByInput,
        };
        let model = Model::Network(network.with_tiling(tiling));
        let robots = cell.batch
            * if cell.way == Way::Rollout {
                ROLLOUT.1
            } else {
                1
            };
        let calls = (6_000 / robots).max(1);
        let out_w = &mut self.out_w[..cell.batch];
        let start = Instant::now();
        for _ in 0..calls {
            match cell.way {
                Way::Rows | Way::RowsByRobot => {
                    model.predict(black_box(&self.rows[..cell.batch]), black_box(out_w));
                }
                Way::Columns => {
                    let columns = self.columns.each_ref().map(|column| &column[..cell.batch]);
                    model.predict_columns(black_box(columns), black_box(out_w));
                }
                Way::Rollout => {
                    let rollouts = Rollouts {
                        starts: &self.starts,
                        candidates: ROLLOUT.0,
                        steps: ROLLOUT.1,
                        step_s: 1.0 / 30.0,
                        v_mps: &self.commands[0],
                        omega_radps: &self.commands[1],
                    };
                    model
                        .rollout(black_box(&rollouts), 0..cell.batch, black_box(out_w), None)
                        .expect("the shapes fit");
                }
            }
        }
        start.elapsed().as_nanos() as f64 / (calls * robots) as f64
    }
}

fn main() {
    let filter = std::env::args().nth(1).unwrap_or_default();
    let mut noise = Noise(7);
    let network = network(&mut noise);
    let largest = BATCHES[BATCHES.len() - 1];
    let columns: [Vec<f32>; INPUTS] = std::array::from_fn(|_| noise.column(largest));
    let mut bench = Bench {
        network,
        rows: (0..largest)
            .map(|row| std::array::from_fn(|feature| columns[feature][row]))
            .collect(),
        columns,
        starts: vec![RolloutStart {
            command: None,
            lag_w: [3.65; 5],
            reading_age: ReadingAge::UNKNOWN,
        }],
        commands: std::array::from_fn(|_| noise.column(ROLLOUT.0 * ROLLOUT.1)),
        out_w: vec![0.0; largest],
    };

    let kernels = Kernel::ALL.into_iter().filter(|kernel| {
        kernel.is_available()
            && (format!("{kernel:?}").contains(&filter) || filter.starts_with('-'))
    });
    let mut cells = Vec::new();
    for kernel in kernels.clone() {
        let largest = if kernel == Kernel::Scalar {
            100
        } else {
            largest
        };
        for way in [Way::Columns, Way::Rows, Way::RowsByRobot] {
            let batches = BATCHES.into_iter().filter(|batch| *batch <= largest);
            cells.extend(batches.map(|batch| (kernel, way, batch)));
        }
        if kernel != Kernel::Scalar {
            cells.push((kernel, Way::Rollout, ROLLOUT.0));
        }
    }
    let mut cells: Vec<Cell> = cells
        .into_iter()
        .map(|(kernel, way, batch)| Cell {
            kernel,
            way,
            batch,
            ns_per_robot: f64::INFINITY,
        })
        .collect();
    let mut peaks = [0.0f64; Kernel::ALL.len()];
    for _ in 0..ROUNDS {
        for cell in &mut cells {
            let ns = bench.run(cell);
            cell.ns_per_robot = cell.ns_per_robot.min(ns);
        }
        for (peak_so_far, kernel) in peaks.iter_mut().zip(Kernel::ALL) {
            if kernel.is_available() {
                *peak_so_far = peak_so_far.max(peak(kernel).unwrap_or(0.0));
            }
        }
    }
    for (kernel, peak) in Kernel::ALL.into_iter().zip(peaks) {
        if kernels.clone().any(|shown| shown == kernel) {
            print(kernel, peak, &cells);
        }
    }
}

fn print(kernel: Kernel, peak: f64, cells: &[Cell]) {
    let figure = |way, batch| {
        let mut found = cells.iter();
        let found = found.find(|c| c.kernel == kernel && c.way == way && c.batch == batch);
        found.map(|cell| (cell.ns_per_robot, MACS as f64 / cell.ns_per_robot / peak))
    };
    println!("{kernel:?}: peak {peak:.1} multiply-adds a nanosecond; ns per robot, share of peak");
    println!(
        "{:>8}  {:>16}{:>16}{:>16}",
        "robots", "columns", "rows", "rows by robot"
    );
    for batch in BATCHES {
        print!("{batch:>8}  ");
        for way in [Way::Columns, Way::Rows, Way::RowsByRobot] {
            match figure(way, batch) {
                Some((ns, _)) if peak == 0.0 => print!("{ns:>16.1}"),
                Some((ns, share)) => print!("{ns:>10.1}{:>4.0} %", share * 100.0),
                None => print!("{:>16}", "-"),
            }
        }
        println!();
    }
    if let Some((ns, share)) = figure(Way::Rollout, ROLLOUT.0) {
        let (candidates, steps) = ROLLOUT;
        let whole_ms = ns * (candidates * steps) as f64 * 1e-6;
        println!(
            "rollout {candidates} x {steps}: {whole_ms:.2} ms, {ns:.1} ns a step, {:.0} %",
            share * 100.0
        );
    }
    println!();
}
