//! Parameters of a network: weights, normalisation and activation.

use crate::features::{FeatureSet, Features};
use crate::gelu::Activation;

/// Widths of the hidden layers.
pub const HIDDEN: [usize; 3] = [64, 64, 32];

/// A dense layer.
///
/// [`Parameters`] has an example.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Weights, row-major, one row of inputs per output.
    pub weights: Vec<f32>,
    /// One bias per output.
    pub bias: Vec<f32>,
}

/// Training statistics that scale features and power to zero mean and unit deviation.
///
/// [`Parameters`] has an example.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Normalisation {
    /// Mean of each feature, in its unit.
    pub feature_mean: Features,
    /// Standard deviation of each feature. It is 0 for a constant feature, which is then ignored.
    pub feature_std: Features,
    /// Mean power, W.
    pub power_mean_w: f32,
    /// Standard deviation of power, W, positive: the output scale.
    pub power_std_w: f32,
}

/// Everything that determines a forecast.
///
/// Weights that were trained elsewhere make a [`Network`](crate::Network):
///
/// ```
/// # use joulebus_predictor::{Activation, FeatureSet, HIDDEN, INPUTS, TrainingRange};
/// use joulebus_predictor::{Layer, ModelCard, Network, Normalisation, Parameters};
///
/// # let range = TrainingRange::of(FeatureSet::Full, [[1.0; INPUTS]].iter());
/// let layer = |inputs, outputs| Layer {
///     weights: vec![0.01; inputs * outputs],
///     bias: vec![0.0; outputs],
/// };
/// let [first, second, third] = HIDDEN;
/// let feature_set = FeatureSet::Full;
/// let parameters = Parameters {
///     feature_set,
///     normalisation: Normalisation {
///         feature_mean: [0.0; INPUTS],
///         feature_std: [1.0; INPUTS],
///         power_mean_w: 4.0,
///         power_std_w: 1.5,
///     },
///     activation: Activation::GeluErf,
///     layers: [
///         layer(feature_set.inputs(), first),
///         layer(first, second),
///         layer(second, third),
///         layer(third, 1),
///     ],
/// };
/// let network = Network::new(parameters, ModelCard::new(range))?;
/// // Features of 0 give the mean power.
/// assert_eq!(network.predict_reference_f32(&[0.0; INPUTS]), 4.0);
/// # Ok::<(), joulebus_predictor::ModelError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// The features read. Entries of the others in the normalisation are meaningless.
    pub feature_set: FeatureSet,
    /// Statistics of the training data.
    pub normalisation: Normalisation,
    /// The activation of the hidden layers.
    pub activation: Activation,
    /// Inputs→64, 64→64, 64→32, 32→1.
    pub layers: [Layer; 4],
}

/// Inputs and outputs of each layer.
pub(crate) fn layer_sizes(feature_set: FeatureSet) -> [(usize, usize); 4] {
    let [first, second, third] = HIDDEN;
    [(feature_set.inputs(), first), (first, second), (second, third), (third, 1)]
}
