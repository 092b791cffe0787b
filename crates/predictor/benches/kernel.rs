//! Nanoseconds per robot of each kernel, by batch size: `cargo bench -p joulebus-predictor`.
//!
//! Weights are random: the arithmetic takes the same time for any finite weights. The figure is the
//! median of repetitions of about 5 ms each.

use joulebus_predictor::{
    Card, FEATURES, FeatureSet, Features, HIDDEN, Kernel, Layer, Network, Normalisation,
    Parameters, ResidualStats, Scores, TrainingRange,
};
use std::hint::black_box;
use std::time::Instant;

const BATCHES: [usize; 6] = [1, 7, 20, 100, 1_000, 10_000];
const REPETITIONS: usize = 31;

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
            feature_mean: [0.0; FEATURES],
            feature_std: [1.0; FEATURES],
            power_mean_w: 3.65,
            power_std_w: 0.375,
        },
        layers: [
            layer(FEATURES, first),
            layer(first, second),
            layer(second, third),
            layer(third, 1),
        ],
    };
    let card = Card {
        name: "random".to_owned(),
        source: "random weights".to_owned(),
        training_data: "none".to_owned(),
        training_data_sha256: String::new(),
        seed: 0,
        training_range: TrainingRange {
            feature_set: FeatureSet::Full,
            min: [-1.0; FEATURES],
            max: [1.0; FEATURES],
        },
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

fn median_ns_per_robot(network: &Network, inputs: &[Features]) -> f64 {
    let mut out_w = vec![0.0; inputs.len()];
    let calls = (10_000 / inputs.len()).max(1);
    let mut figures: Vec<f64> = (0..REPETITIONS)
        .map(|_| {
            let start = Instant::now();
            for _ in 0..calls {
                network.predict(black_box(inputs), black_box(&mut out_w));
            }
            start.elapsed().as_nanos() as f64 / (calls * inputs.len()) as f64
        })
        .collect();
    figures.sort_by(f64::total_cmp);
    figures[REPETITIONS / 2]
}

fn main() {
    let mut noise = Noise(7);
    let network = network(&mut noise);
    print!("{:>10}", "robots");
    for batch in BATCHES {
        print!("{batch:>10}");
    }
    println!("   (ns per robot)");
    for kernel in Kernel::ALL {
        let Some(network) = network.clone().with_kernel(kernel) else {
            continue;
        };
        print!("{:>10}", format!("{kernel:?}"));
        for batch in BATCHES {
            let inputs: Vec<Features> = (0..batch)
                .map(|_| std::array::from_fn(|_| noise.next()))
                .collect();
            print!("{:>10.0}", median_ns_per_robot(&network, &inputs));
        }
        println!();
    }
}
