//! Random networks with both forms of GELU, and random rows.

use joulebus_energy::EnergyModel;
use joulebus_predictor::training::{TrainedBlocks, TrainedRows};
use joulebus_predictor::{
    Activation, FeatureSet, Features, HIDDEN, INPUTS, Layer, Linear, ModelCard, Network,
    Normalisation, Parameters, ResidualStats, Scores, TrainingRange,
};

/// A generator of random numbers, with its state.
#[derive(Debug)]
pub struct Noise(pub u64);

impl Noise {
    pub fn next_u64(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    /// Uniform on [-1, 1).
    pub fn next_f32(&mut self) -> f32 {
        (self.next_u64() >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    }
}

pub fn parameters(noise: &mut Noise, feature_set: FeatureSet) -> Parameters {
    let [first, second, third] = HIDDEN;
    let mut layer = |inputs: usize, outputs: usize| {
        let scale = (3.0 / inputs as f32).sqrt();
        Layer {
            weights: (0..inputs * outputs).map(|_| noise.next_f32() * scale).collect(),
            bias: (0..outputs).map(|_| noise.next_f32() * 0.3).collect(),
        }
    };
    let layers = [
        layer(feature_set.inputs(), first),
        layer(first, second),
        layer(second, third),
        layer(third, 1),
    ];
    let activation = Activation::ALL[(noise.next_u64() % 3) as usize];
    let mut feature_mean = [0.0; INPUTS];
    let mut feature_std = [0.0; INPUTS];
    for i in feature_set.range() {
        feature_mean[i] = noise.next_f32();
        feature_std[i] = 0.5 + noise.next_f32().abs();
    }
    Parameters {
        feature_set,
        normalisation: Normalisation {
            feature_mean,
            feature_std,
            power_mean_w: 3.65,
            power_std_w: 0.375,
        },
        activation,
        layers,
    }
}

/// A model card that fits all of them.
pub fn card(feature_set: FeatureSet) -> ModelCard {
    let mut min = [0.0; INPUTS];
    let mut max = [0.0; INPUTS];
    min[feature_set.range()].fill(-1.5);
    // Tests send readings of 3 to 4 W: what was trained on, or not.
    let is_full = feature_set.range().start == 0;
    max[feature_set.range()].fill(if is_full { 4.5 } else { 2.5 });
    ModelCard {
        name: "random".to_owned(),
        source: "random weights".to_owned(),
        training_data: "none, \"quoted\" and ünïcode".to_owned(),
        training_data_sha256: "00".repeat(32),
        trained_rows: Some(TrainedRows {
            rows: 1_000,
            blocks: vec![
                TrainedBlocks { rows: 64, hashes: vec![3, u64::MAX] },
                TrainedBlocks { rows: 17, hashes: vec![0] },
            ],
        }),
        seed: u64::MAX,
        step_s: None,
        training_range: TrainingRange { feature_set, min, max },
        residual: ResidualStats { std_w: 0.1, q05_w: -0.15, q95_w: 0.17 },
        scores: Scores {
            rows: 1_000,
            network_r2: 0.9,
            network_mae_w: 0.05,
            persistence_r2: 0.89,
            persistence_mae_w: 0.06,
        },
        linear: Some(linear(feature_set)),
        energy: Some(energy()),
    }
}

/// An energy model that reads commands.
fn energy() -> EnergyModel {
    let mut energy = EnergyModel::untrained(3.7);
    for (place, weight) in energy.command.weights.iter_mut().enumerate().skip(1) {
        *weight = 0.01 * place as f32;
    }
    energy.added_shares = [0.3; 6];
    energy.calibrated = 6;
    energy.errors = [[-0.2, -0.1, -0.05, -0.02, 0.0, 0.02, 0.05, 0.1, 0.2]; 6];
    energy
}

/// Mostly the last reading, plus small weights of all other features read.
fn linear(feature_set: FeatureSet) -> Linear {
    let feature_set = Linear::feature_set_beside(feature_set);
    let mut weights = [0.0; INPUTS];
    weights[feature_set.range()].fill(0.03);
    weights[6] = 0.8;
    Linear { feature_set, bias_w: 0.15, weights, r2: 0.88 }
}

/// A random network; the same for the same seed.
///
/// # Panics
/// Never: random weights are valid.
pub fn network(seed: u64, feature_set: FeatureSet) -> Network {
    let parameters = parameters(&mut Noise(seed), feature_set);
    Network::new(parameters, card(feature_set)).expect("random weights are a valid network")
}

/// A row of features of -3 to 3.
pub fn row(noise: &mut Noise) -> Features {
    std::array::from_fn(|_| 3.0 * noise.next_f32())
}
