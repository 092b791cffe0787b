//! The network's parameters, and its slow reference evaluation.

use crate::card::ModelCard;
use crate::check::{check_card, check_parameters};
use crate::error::ModelError;
use crate::features::{FeatureSet, Features, INPUTS};
use crate::file;
use crate::kernel::{Engine, Kernel, LINE, Packed, SimdLevel, Tiling, fold, pairwise};
use crate::nan::canonical;
use crate::parameters::Parameters;
use crate::rollout::Rollouts;

/// A network that passed every check.
///
/// ```no_run
/// use joulebus_predictor::{Model, Network};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let network = Network::from_safetensors(&std::fs::read("my.safetensors")?)?;
/// let card = network.card();
/// println!("{} of {}: R² {:.2}", card.name, card.source, card.scores.network_r2);
/// println!("{} inputs, kernel {:?}", network.feature_set().inputs(), network.kernel());
/// let model = Model::Network(network);
/// # Ok(())
/// # }
/// ```
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
    /// A network from its parts.
    ///
    /// # Errors
    /// [`ModelError`] on wrong sizes, numbers that are not finite and inconsistent statistics.
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

    /// Reads a model file.
    ///
    /// # Errors
    /// [`ModelError`] with the part of the file, the found and the allowed value. A file that was
    /// modified or truncated anywhere is refused.
    pub fn from_safetensors(bytes: &[u8]) -> Result<Network, ModelError> {
        let (parameters, card) = file::read(bytes)?;
        Network::new(parameters, card)
    }

    /// The model file: the same bytes for the same network on every machine.
    ///
    /// # Errors
    /// [`ModelError::TooLarge`] if names and descriptions on the card exceed the size limit of a
    /// model file.
    pub fn to_safetensors(&self) -> Result<Vec<u8>, ModelError> {
        file::write(&self.parameters, &self.card)
    }

    /// The same network on another kernel, or `None` if this CPU does not support it.
    pub fn with_kernel(self, kernel: Kernel) -> Option<Network> {
        let engine = Engine::new(kernel)?;
        Some(Network { engine, ..self })
    }

    /// The kernel in use: by default the best that this CPU supports.
    pub fn kernel(&self) -> Kernel {
        self.engine.kernel()
    }

    /// The instruction set of that kernel, for other loops.
    pub fn simd_level(&self) -> SimdLevel {
        SimdLevel(self.engine)
    }

    /// The same network with another tiling: for measurements and tests.
    pub fn with_tiling(self, tiling: Tiling) -> Network {
        Network { tiling, ..self }
    }

    /// The features read.
    pub fn feature_set(&self) -> FeatureSet {
        self.parameters.feature_set
    }

    /// The model card.
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

    /// Same as [`Model::predict`](crate::Model::predict).
    pub fn predict(&self, inputs: &[Features], out_w: &mut [f32]) {
        self.engine.rows(&self.packed, self.tiling, inputs, out_w);
    }

    /// Columns have the length of `out_w`. Those that are not read may be empty.
    pub(crate) fn predict_columns(&self, columns: &[&[f32]; INPUTS], out_w: &mut [f32]) {
        self.engine.columns(&self.packed, self.tiling, columns, out_w);
    }

    /// Lanes of checked rollouts from `first`, as many as `energy_j` has elements.
    pub(crate) fn rollout(
        &self,
        rollouts: &Rollouts<'_>,
        first: usize,
        energy_j: &mut [f32],
        power_w: Option<&mut [f32]>,
    ) {
        self.engine.rollout(
            (&self.packed, &self.card.training_range),
            rollouts,
            first,
            energy_j,
            power_w,
        );
    }

    /// One forecast in watt by plain loops: the definition of the network's bits. Allocates.
    ///
    /// The normalisation is folded into the first and the last layer, and the scale factors of
    /// GELU's segments into all four (`kernel/packed.rs`). A hidden output is its bias plus one
    /// fused multiply-add for each input, in order, and then GELU. The last output is sixteen
    /// products, to each of which the one sixteen further on is added by a fused multiply-add,
    /// added pairwise (half onto half), and then the bias. Every NaN becomes [`f32::NAN`]: CPUs and
    /// compilers disagree on its sign and payload, and bits must be comparable.
    pub fn predict_reference_f32(&self, row: &Features) -> f32 {
        let [hidden @ .., last] = fold(&self.parameters);
        let mut values = row[self.feature_set().range()].to_vec();
        for layer in &hidden {
            let rows = layer.weights.chunks(values.len()).zip(&layer.bias);
            let sums = rows.map(|(weights, &bias)| {
                let products = weights.iter().zip(&values);
                products.fold(bias, |sum, (&weight, &x)| x.mul_add(weight, sum))
            });
            values = sums.map(|sum| self.parameters.activation.scaled_value(sum)).collect();
        }
        let sums: [f32; LINE] = std::array::from_fn(|i| {
            let high = LINE + i;
            values[high].mul_add(last.weights[high], values[i] * last.weights[i])
        });
        canonical(pairwise(sums) + last.bias[0])
    }
}
