//! The network's parameters, and its slow, obvious evaluation.

use crate::file;
use crate::kernel::{Engine, Kernel, LINE, Packed, SimdLevel, Tiling, fold, pairwise};
use crate::{
    Activation, FEATURE_NAMES, FeatureSet, Features, INPUTS, Linear, ModelError, ResidualStats,
    Rollouts, TrainingRange,
};

/// Widths of the hidden layers.
pub const HIDDEN: [usize; 3] = [64, 64, 32];

/// A dense layer.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Weights, row-major, one row of inputs for each output.
    pub weights: Vec<f32>,
    /// One bias for each output.
    pub bias: Vec<f32>,
}

/// Training statistics that scale features and power to zero mean and unit deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Normalisation {
    /// Mean of each feature, in its unit.
    pub feature_mean: Features,
    /// Standard deviation of each feature; 0 for a constant feature, which is then ignored.
    pub feature_std: Features,
    /// Mean power in watt.
    pub power_mean_w: f32,
    /// Standard deviation of power in watt, positive: the output scale.
    pub power_std_w: f32,
}

/// Everything that decides a forecast.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// The features that are read; entries of the others in the normalisation mean nothing.
    pub feature_set: FeatureSet,
    /// Statistics of the training data.
    pub normalisation: Normalisation,
    /// What follows each hidden layer.
    pub activation: Activation,
    /// Inputs→64, 64→64, 64→32, 32→1.
    pub layers: [Layer; 4],
}

/// Scores on held-out data, with persistence beside the network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scores {
    /// Number of forecasts scored.
    pub rows: u64,
    /// Coefficient of determination of the network.
    pub network_r2: f32,
    /// Mean absolute error of the network in watt.
    pub network_mae_w: f32,
    /// Coefficient of determination of persistence.
    pub persistence_r2: f32,
    /// Mean absolute error of persistence in watt.
    pub persistence_mae_w: f32,
}

/// Where a network comes from and how good it was.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelCard {
    /// Name for people.
    pub name: String,
    /// `simulation` or a description of the recordings.
    pub source: String,
    /// Description of the training data.
    pub training_data: String,
    /// SHA-256 of the training rows, hexadecimal.
    pub training_data_sha256: String,
    /// Seed of initial weights, batches and dropout.
    pub seed: u64,
    /// Range of the features in training.
    pub training_range: TrainingRange,
    /// Residuals on held-out data.
    pub residual: ResidualStats,
    /// Scores on held-out data.
    pub scores: Scores,
    /// The linear forecast fitted to the same rows, if there is one.
    pub linear: Option<Linear>,
}

/// A network that passed every check and is ready to run.
#[derive(Clone, Debug)]
pub struct Network {
    parameters: Box<Parameters>,
    card: Box<ModelCard>,
    packed: Box<Packed>,
    engine: Engine,
    tiling: Tiling,
    hash: u64,
}

impl Network {
    /// A network from its parts. Refuses wrong sizes, numbers that are not finite and statistics
    /// that contradict one another.
    pub fn new(parameters: Parameters, card: ModelCard) -> Result<Network, ModelError> {
        check_parameters(&parameters)?;
        check_card(&card, parameters.feature_set)?;
        let hash = file::content_hash(&parameters, &card);
        let packed = Box::new(Packed::new(&parameters));
        Ok(Network {
            parameters: Box::new(parameters),
            card: Box::new(card),
            packed,
            engine: Engine::best(),
            tiling: Tiling::ByInput,
            hash,
        })
    }

    /// Reads a model file. Each error names the part of the file with what was found and what is
    /// allowed; a file that was changed or cut anywhere is refused.
    pub fn from_safetensors(bytes: &[u8]) -> Result<Network, ModelError> {
        let (parameters, card) = file::read(bytes)?;
        Network::new(parameters, card)
    }

    /// The model file: the same bytes for the same network on every machine.
    pub fn to_safetensors(&self) -> Result<Vec<u8>, ModelError> {
        file::write(&self.parameters, &self.card)
    }

    /// The same network on another kernel, or `None` if this CPU can't run it.
    pub fn with_kernel(self, kernel: Kernel) -> Option<Network> {
        let engine = Engine::new(kernel)?;
        Some(Network { engine, ..self })
    }

    /// The kernel in use: the best that this CPU has, chosen once.
    pub fn kernel(&self) -> Kernel {
        self.engine.kernel()
    }

    /// The instructions of that kernel, for other work.
    pub fn simd_level(&self) -> SimdLevel {
        SimdLevel(self.engine)
    }

    /// The same network cut into other tiles: for measurements and tests.
    pub fn with_tiling(self, tiling: Tiling) -> Network {
        Network { tiling, ..self }
    }

    /// The features that are read.
    pub fn feature_set(&self) -> FeatureSet {
        self.parameters.feature_set
    }

    /// Where the network comes from.
    pub fn card(&self) -> &ModelCard {
        &self.card
    }

    /// Weights and normalisation.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Identifies the contents of the model file.
    pub fn hash(&self) -> u64 {
        self.hash
    }

    /// As [`Model::predict`](crate::Model::predict).
    pub fn predict(&self, inputs: &[Features], out_w: &mut [f32]) {
        self.engine.rows(&self.packed, self.tiling, inputs, out_w);
    }

    /// Columns have the length of `out_w`; those that are not read may be empty.
    pub(crate) fn predict_columns(&self, columns: &[&[f32]; INPUTS], out_w: &mut [f32]) {
        self.engine
            .columns(&self.packed, self.tiling, columns, out_w);
    }

    /// Lanes from `first` on of checked rollouts, as many as `energy_j` has places.
    pub(crate) fn rollout(
        &self,
        rollouts: &Rollouts<'_>,
        first: usize,
        energy_j: &mut [f32],
        power_w: Option<&mut [f32]>,
    ) {
        self.engine
            .rollout(&self.packed, rollouts, first, energy_j, power_w);
    }

    /// One forecast in watt by plain loops: the definition of the network's bits. Allocates.
    ///
    /// The normalisation is folded into the first and the last layer, and the factors of GELU's
    /// segments into all four (`kernel/packed.rs`). A hidden output is its bias
    /// plus one fused multiply-add for each input, in order, and then GELU. The last output is
    /// sixteen products, each joined by the one sixteen further on in a fused multiply-add, added
    /// in pairs (half onto half), and then the bias. Every NaN becomes [`f32::NAN`]: CPUs and
    /// compilers disagree on its sign and payload, so this is what lets bits be compared.
    pub fn predict_reference_f32(&self, row: &Features) -> f32 {
        let [hidden @ .., last] = fold(&self.parameters);
        let mut values = row[self.feature_set().range()].to_vec();
        for layer in &hidden {
            let rows = layer.weights.chunks(values.len()).zip(&layer.bias);
            let sums = rows.map(|(weights, &bias)| {
                let products = weights.iter().zip(&values);
                products.fold(bias, |sum, (&weight, &x)| x.mul_add(weight, sum))
            });
            values = sums
                .map(|sum| self.parameters.activation.scaled_value(sum))
                .collect();
        }
        let sums: [f32; LINE] = std::array::from_fn(|i| {
            let high = LINE + i;
            values[high].mul_add(last.weights[high], values[i] * last.weights[i])
        });
        canonical(pairwise(sums) + last.bias[0])
    }

    /// One forecast in watt in double precision with a true error function, for checks. Allocates.
    pub fn predict_reference_f64(&self, row: &Features) -> f64 {
        let Normalisation {
            feature_mean,
            feature_std,
            power_mean_w,
            power_std_w,
        } = self.parameters.normalisation;
        let normalised = |i: usize| {
            let std = f64::from(feature_std[i]);
            let inverse = if std > 0.0 { 1.0 / std } else { 0.0 };
            (f64::from(row[i]) - f64::from(feature_mean[i])) * inverse
        };
        let mut values: Vec<f64> = self.feature_set().range().map(normalised).collect();
        for (number, layer) in self.parameters.layers.iter().enumerate() {
            let hidden = number < HIDDEN.len();
            let dense = |(weights, &bias): (&[f32], &f32)| {
                let products = weights.iter().zip(&values).map(|(&w, &x)| f64::from(w) * x);
                let sum = f64::from(bias) + products.sum::<f64>();
                if hidden {
                    self.parameters.activation.value_f64(sum)
                } else {
                    sum
                }
            };
            values = layer
                .weights
                .chunks(values.len())
                .zip(&layer.bias)
                .map(dense)
                .collect();
        }
        values[0] * f64::from(power_std_w) + f64::from(power_mean_w)
    }
}

/// One bit pattern for every NaN: CPUs and compilers disagree on sign and payload.
#[inline(always)]
pub(crate) fn canonical(value: f32) -> f32 {
    if value.is_nan() { f32::NAN } else { value }
}

/// Inputs and outputs of each layer.
pub(crate) fn layer_sizes(feature_set: FeatureSet) -> [(usize, usize); 4] {
    let [first, second, third] = HIDDEN;
    [
        (feature_set.inputs(), first),
        (first, second),
        (second, third),
        (third, 1),
    ]
}

fn check_parameters(parameters: &Parameters) -> Result<(), ModelError> {
    let sizes = layer_sizes(parameters.feature_set);
    for (number, (layer, (inputs, outputs))) in parameters.layers.iter().zip(sizes).enumerate() {
        check_values(&file::weight_name(number), &layer.weights, inputs * outputs)?;
        check_values(&file::bias_name(number), &layer.bias, outputs)?;
    }
    let Normalisation {
        feature_mean,
        feature_std,
        power_mean_w,
        power_std_w,
    } = parameters.normalisation;
    for i in parameters.feature_set.range() {
        if !feature_mean[i].is_finite() {
            let field = format!("feature_mean of {}", FEATURE_NAMES[i]);
            return Err(ModelError::field(field, &feature_mean[i], "finite numbers"));
        }
        let std_fine =
            feature_std[i] == 0.0 || (feature_std[i] > 0.0 && feature_std[i].recip().is_finite());
        if !(std_fine && feature_std[i].is_finite()) {
            let field = format!("feature_std of {}", FEATURE_NAMES[i]);
            return Err(ModelError::field(
                field,
                &feature_std[i],
                "0, or 1e-38 to 3e38",
            ));
        }
    }
    if !power_mean_w.is_finite() {
        return Err(ModelError::field(
            "power_mean_w",
            &power_mean_w,
            "finite numbers",
        ));
    }
    let power_std_fine = power_std_w > 0.0 && power_std_w.is_finite();
    if !power_std_fine {
        return Err(ModelError::field(
            "power_std_w",
            &power_std_w,
            "finite and > 0",
        ));
    }
    check_folded(parameters)
}

/// What the kernels compute with has to be finite too.
fn check_folded(parameters: &Parameters) -> Result<(), ModelError> {
    let names = ["first", "second", "third", "last"];
    for (name, layer) in names.into_iter().zip(fold(parameters)) {
        let mut values = layer.weights.iter().chain(&layer.bias);
        if let Some(value) = values.find(|value| !value.is_finite()) {
            let field = format!("scale folded into the {name} layer");
            return Err(ModelError::field(field, value, "finite numbers"));
        }
    }
    Ok(())
}

fn check_values(tensor: &str, values: &[f32], expected: usize) -> Result<(), ModelError> {
    if values.len() != expected {
        return Err(ModelError::Shape {
            tensor: tensor.to_owned(),
            found: format!("{} values", values.len()),
            allowed: format!("{expected} values"),
        });
    }
    match values.iter().position(|value| !value.is_finite()) {
        Some(index) => Err(ModelError::NotFinite {
            tensor: tensor.to_owned(),
            index,
            value: values[index],
        }),
        None => Ok(()),
    }
}

fn check_linear(linear: Option<&Linear>, feature_set: FeatureSet) -> Result<(), ModelError> {
    let Some(linear) = linear else {
        return Ok(());
    };
    let allowed = Linear::feature_set_beside(feature_set);
    if linear.feature_set != allowed {
        return Err(ModelError::field(
            "feature set of linear_weights",
            linear.feature_set.name(),
            allowed.name(),
        ));
    }
    linear.check()
}

fn check_card(card: &ModelCard, feature_set: FeatureSet) -> Result<(), ModelError> {
    card.residual.check()?;
    let TrainingRange {
        feature_set: range_set,
        min,
        max,
    } = card.training_range;
    if range_set != feature_set {
        let allowed = feature_set.name();
        return Err(ModelError::field(
            "feature set of training_range",
            range_set.name(),
            allowed,
        ));
    }
    for i in feature_set.range() {
        let ordered = min[i].is_finite() && max[i].is_finite() && min[i] <= max[i];
        if !ordered {
            let field = format!("training range of {}", FEATURE_NAMES[i]);
            return Err(ModelError::field(
                field,
                &format!("{} to {}", min[i], max[i]),
                "ascending",
            ));
        }
    }
    check_linear(card.linear.as_ref(), feature_set)?;
    let Scores {
        network_r2,
        network_mae_w,
        persistence_r2,
        persistence_mae_w,
        ..
    } = card.scores;
    for (field, value) in [
        ("score_network_r2", network_r2),
        ("score_network_mae_w", network_mae_w),
        ("score_persistence_r2", persistence_r2),
        ("score_persistence_mae_w", persistence_mae_w),
    ] {
        if !value.is_finite() {
            return Err(ModelError::field(field, &value, "finite numbers"));
        }
    }
    Ok(())
}
