//! The network in double precision with the exact activation: what kernels, trainers and converted
//! files are compared with.

use joulebus_predictor::{Activation, Features, Network};
use nalgebra::{DMatrix, DVector};

/// Forecasts of some rows, W.
pub fn forecasts_w(network: &Network, rows: &[Features]) -> Vec<f64> {
    let parameters = network.parameters();
    let normalisation = &parameters.normalisation;
    let layers = parameters.layers.clone().map(|layer| (layer.weights, layer.bias));
    let layers = Layers::new(&layers, parameters.activation);
    let normalised = |feature: usize, row: &Features| {
        let std = f64::from(normalisation.feature_std[feature]);
        let inverse = if std > 0.0 { 1.0 / std } else { 0.0 };
        (f64::from(row[feature]) - f64::from(normalisation.feature_mean[feature])) * inverse
    };
    let forecast_w = |row: &Features| {
        let inputs = network.feature_set().range().map(|feature| normalised(feature, row));
        layers.output(inputs.collect()) * f64::from(normalisation.power_std_w)
            + f64::from(normalisation.power_mean_w)
    };
    rows.iter().map(forecast_w).collect()
}

/// The forecast of one row, W.
pub fn forecast_w(network: &Network, row: &Features) -> f64 {
    forecasts_w(network, std::slice::from_ref(row))[0]
}

/// Layers of any widths. The last one has one output and no activation.
#[derive(Debug)]
pub struct Layers {
    layers: Vec<(DMatrix<f64>, DVector<f64>)>,
    activation: Activation,
}

impl Layers {
    /// Of each layer the weights, one row per output, and the biases.
    pub fn new(layers: &[(Vec<f32>, Vec<f32>)], activation: Activation) -> Self {
        let wide = |(weights, bias): &(Vec<f32>, Vec<f32>)| {
            let (rows, columns) = (bias.len(), weights.len() / bias.len());
            let weights = DMatrix::from_row_slice(rows, columns, weights).map(f64::from);
            (weights, DVector::from_column_slice(bias).map(f64::from))
        };
        Self { layers: layers.iter().map(wide).collect(), activation }
    }

    /// The output for normalised inputs.
    pub fn output(&self, inputs: Vec<f64>) -> f64 {
        let mut values = DVector::from_vec(inputs);
        for (number, (weights, bias)) in self.layers.iter().enumerate() {
            let sums = weights * values + bias;
            let is_last = number + 1 == self.layers.len();
            values = if is_last { sums } else { sums.map(|sum| self.activation.value_f64(sum)) };
        }
        values[0]
    }
}
