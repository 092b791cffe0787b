//! Settings of the three recorded platforms, and random networks.

use joulebus_predictor::{
    Activation, FEATURES, FeatureSet, INPUTS, Model, ModelCard, Network, Normalisation, Parameters,
    Persistence, ResidualStats, TrainingRange,
};
use joulebus_settings::{FleetSettings, Intake, Platform};
use joulebus_testkit_fleets::random::{self, Noise};

use crate::live;

pub(crate) const ROBOTINO: u32 = 1_000;
pub(crate) const HUSKY: u32 = 2_000;
pub(crate) const ROVER: u32 = 3_000;

pub(crate) fn settings() -> FleetSettings {
    let platform = |name: &str, first: u32, period_ns: u64| Platform {
        name: name.to_owned(),
        robots: vec![first..=first + 999],
        period_ns,
        stale_after_ns: 5 * period_ns,
        hold_max_ns: 1_000_000_000,
        stuck_after_ns: 10_000_000_000,
        power_min_w: -2_000.0,
        power_max_w: 5_000.0,
        v_max_mps: 5.0,
        omega_max_radps: 10.0,
        power_resolution_w: 0.01,
        battery: None,
        alarms: None,
        online: false,
        energy_online: true,
    };
    FleetSettings {
        capacity: 1_000,
        intake: Intake {
            max_samples_per_tick: 1_024,
            max_jump_ns: 10_000_000_000,
            leave_after_ns: 1_000_000_000_000,
            max_sources: 4,
        },
        platforms: vec![
            platform("robotino", ROBOTINO, 31_250_000),
            platform("husky", HUSKY, 153_846_154),
            platform("rover", ROVER, 33_333_333),
        ],
        ..live::settings()
    }
}

const RESIDUAL: ResidualStats = ResidualStats { std_w: 1.0, q05_w: -1.5, q95_w: 1.5 };

pub(crate) fn persistence() -> Model {
    Model::Persistence(Persistence::new(RESIDUAL).unwrap())
}

/// A network with random weights, normalised to the powers of a platform.
pub(crate) fn network(seed: u64, feature_set: FeatureSet, power_mean_w: f32) -> Model {
    let mut feature_mean = [0.1; INPUTS];
    feature_mean[6..FEATURES].fill(power_mean_w);
    let mut feature_std = [0.5; INPUTS];
    feature_std[6..FEATURES].fill(power_mean_w / 4.0);
    let parameters = Parameters {
        normalisation: Normalisation {
            feature_mean,
            feature_std,
            power_mean_w,
            power_std_w: power_mean_w / 4.0,
        },
        activation: Activation::GeluErf,
        ..random::parameters(&mut Noise(seed), feature_set)
    };
    let card = ModelCard {
        name: format!("random {seed}"),
        seed,
        training_range: TrainingRange { feature_set, min: [-10.0; INPUTS], max: [1_000.0; INPUTS] },
        residual: RESIDUAL,
        linear: None,
        ..random::card(feature_set)
    };
    Model::Network(Network::new(parameters, card).unwrap())
}

/// Networks for the platforms in the order of [`settings`]; the rover's needs no velocities.
pub(crate) fn networks() -> Vec<Model> {
    vec![
        network(1, FeatureSet::Full, 30.0),
        network(2, FeatureSet::Full, 300.0),
        network(3, FeatureSet::PowerOnly, 10.0),
    ]
}
