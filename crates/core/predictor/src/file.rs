//! Model files: safetensors with a complete description of the model in the metadata.
//!
//! The header is written here instead of by the `safetensors` crate, whose order of metadata varies
//! from run to run: the same model must give the same bytes.

use hmac_sha256::Hash as Sha256;
use joulebus_energy::EnergyModel;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use std::collections::BTreeMap;
use std::str::FromStr;

use crate::card::{ModelCard, ResidualStats, Scores, TrainedBlocks, TrainedRows, TrainingRange};
use crate::error::ModelError;
use crate::features::{FEATURE_NAMES, FeatureSet, Features, INPUTS};
use crate::gelu::Activation;
use crate::linear::Linear;
use crate::parameters::{Layer, Normalisation, Parameters, layer_sizes};

const FORMAT: &str = "joulebus-model";
const VERSION: &str = "1";
const KIND: &str = "network";
const CONVENTION: &str = "command in force and the readings up to now, newest first, forecast the \
                          next reading; derivatives over the true time step";
const FRESHNESS_CONVENTION: &str = "; reading_age_steps: samples since the newest reading was measured, \
                                    up to 30; reading_due: 1 if a new one is due with the next \
                                    sample by the interval learned from the stream, else 0";
/// Maximum size of a model file, bytes.
pub const MAX_MODEL_BYTES: usize = 1 << 20;

type Fields = BTreeMap<&'static str, String>;

pub(crate) fn weight_name(layer: usize) -> String {
    format!("layers.{layer}.weight")
}

pub(crate) fn bias_name(layer: usize) -> String {
    format!("layers.{layer}.bias")
}

/// The feature definitions of a set. Those of the paper's set never change.
fn convention(set: FeatureSet) -> String {
    let more = match set.needs_freshness() {
        true => FRESHNESS_CONVENTION,
        false => "",
    };
    format!("{CONVENTION}{more}")
}

/// First eight bytes of the SHA-256 in the model file.
pub(crate) fn content_hash(parameters: &Parameters, card: &ModelCard) -> u64 {
    let fields = fields(parameters, card);
    let tensors = tensors(parameters);
    leading_u64(&digest(
        fields.iter().map(|(key, value)| (*key, value.as_str())),
        tensors.iter().map(|tensor| (tensor.name.as_str(), &tensor.shape[..], &tensor.data[..])),
    ))
}

pub(crate) fn write(parameters: &Parameters, card: &ModelCard) -> Result<Vec<u8>, ModelError> {
    let mut fields = fields(parameters, card);
    let tensors = tensors(parameters);
    let sha256 = digest(
        fields.iter().map(|(key, value)| (*key, value.as_str())),
        tensors.iter().map(|tensor| (tensor.name.as_str(), &tensor.shape[..], &tensor.data[..])),
    );
    fields.insert("sha256", hex(&sha256));

    let mut header = serde_json::Map::new();
    header.insert("__metadata__".to_owned(), serde_json::json!(fields));
    let mut data = Vec::new();
    for tensor in &tensors {
        let start = data.len();
        data.extend_from_slice(&tensor.data);
        let entry = serde_json::json!({
            "dtype": "F32", "shape": tensor.shape, "data_offsets": [start, data.len()],
        });
        header.insert(tensor.name.clone(), entry);
    }
    let mut header = serde_json::Value::Object(header).to_string().into_bytes();
    header.resize(header.len().next_multiple_of(8), b' ');

    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.append(&mut header);
    bytes.append(&mut data);
    if bytes.len() > MAX_MODEL_BYTES {
        return Err(ModelError::TooLarge { found: bytes.len(), allowed: MAX_MODEL_BYTES });
    }
    Ok(bytes)
}

pub(crate) fn read(bytes: &[u8]) -> Result<(Parameters, ModelCard), ModelError> {
    if bytes.len() > MAX_MODEL_BYTES {
        return Err(ModelError::TooLarge { found: bytes.len(), allowed: MAX_MODEL_BYTES });
    }
    let (_, header) = SafeTensors::read_metadata(bytes)?;
    let tensors = SafeTensors::deserialize(bytes)?;
    let metadata = header.metadata().iter().flatten();
    let metadata = Metadata(metadata.map(|(key, text)| (key.as_str(), text.as_str())).collect());

    metadata.must_be("format", FORMAT)?;
    metadata.must_be("format_version", VERSION)?;
    check_digest(&metadata, &tensors)?;
    metadata.must_be("kind", KIND)?;
    let activation_name = metadata.text("activation")?;
    let activation = Activation::from_name(activation_name)
        .ok_or_else(|| ModelError::field("activation", &activation_name, Activation::NAMES))?;
    let set_name = metadata.text("feature_set")?;
    let feature_set = FeatureSet::from_name(set_name)
        .ok_or_else(|| ModelError::field("feature_set", &set_name, FeatureSet::NAMES))?;
    metadata.must_be("convention", &convention(feature_set))?;
    metadata.must_be("features", &FEATURE_NAMES[feature_set.range()].join(","))?;

    let parameters = Parameters {
        feature_set,
        normalisation: Normalisation {
            feature_mean: metadata.per_feature("feature_mean", feature_set)?,
            feature_std: metadata.per_feature("feature_std", feature_set)?,
            power_mean_w: metadata.number("power_mean_w")?,
            power_std_w: metadata.number("power_std_w")?,
        },
        activation,
        layers: read_layers(&tensors, feature_set)?,
    };
    Ok((parameters, read_card(&metadata, feature_set)?))
}

/// Longest name of a model, bytes.
const MAX_NAME_BYTES: usize = 128;
/// Longest other text of a model's card, bytes.
const MAX_TEXT_BYTES: usize = 1 << 16;

fn read_card(metadata: &Metadata<'_>, feature_set: FeatureSet) -> Result<ModelCard, ModelError> {
    Ok(ModelCard {
        name: metadata.shown("name", MAX_NAME_BYTES)?,
        source: metadata.shown("source", MAX_TEXT_BYTES)?,
        training_data: metadata.shown("training_data", MAX_TEXT_BYTES)?,
        training_data_sha256: metadata.text("training_data_sha256")?.to_owned(),
        trained_rows: read_trained_rows(metadata)?,
        seed: metadata.number("seed")?,
        step_s: read_step(metadata)?,
        training_range: TrainingRange {
            feature_set,
            min: metadata.per_feature("feature_min", feature_set)?,
            max: metadata.per_feature("feature_max", feature_set)?,
        },
        residual: ResidualStats {
            std_w: metadata.number("residual_std_w")?,
            q05_w: metadata.number("residual_q05_w")?,
            q95_w: metadata.number("residual_q95_w")?,
        },
        scores: Scores {
            rows: metadata.number("score_rows")?,
            network_r2: metadata.number("score_network_r2")?,
            network_mae_w: metadata.number("score_network_mae_w")?,
            persistence_r2: metadata.number("score_persistence_r2")?,
            persistence_mae_w: metadata.number("score_persistence_mae_w")?,
        },
        linear: read_linear(metadata, feature_set)?,
        energy: read_energy(metadata)?,
    })
}

/// Older files and some imported models do not state it.
fn read_step(metadata: &Metadata<'_>) -> Result<Option<f32>, ModelError> {
    if !metadata.0.contains_key("step_s") {
        return Ok(None);
    }
    let step_s: f32 = metadata.number("step_s")?;
    match step_s > 0.0 && step_s.is_finite() {
        true => Ok(Some(step_s)),
        false => Err(ModelError::field("step_s", &step_s, "a time above 0 s")),
    }
}

/// Older files and imported models do not state them.
fn read_trained_rows(metadata: &Metadata<'_>) -> Result<Option<TrainedRows>, ModelError> {
    let fields = ["trained_rows", "trained_blocks"];
    if !fields.iter().any(|field| metadata.0.contains_key(*field)) {
        return Ok(None);
    }
    let text = metadata.text("trained_blocks")?;
    let groups = text.split(';').filter(|group| !group.is_empty());
    let blocks: Option<Vec<TrainedBlocks>> = groups.map(read_blocks).collect();
    let allowed = "groups `rows:hashes` with `;` between them, a hash in 16 hexadecimal digits";
    Ok(Some(TrainedRows {
        rows: metadata.number("trained_rows")?,
        blocks: blocks.ok_or_else(|| {
            let start: String = text.chars().take(40).collect();
            ModelError::field("trained_blocks", &start, allowed)
        })?,
    }))
}

fn read_blocks(group: &str) -> Option<TrainedBlocks> {
    let (rows, hashes) = group.split_once(':')?;
    let (hashes, rest) = hashes.as_bytes().as_chunks::<16>();
    let hash = |digits: &[u8; 16]| {
        let is_hex = digits.iter().all(u8::is_ascii_hexdigit);
        let text = std::str::from_utf8(digits).ok().filter(|_| is_hex)?;
        u64::from_str_radix(text, 16).ok()
    };
    Some(TrainedBlocks {
        rows: rows.parse().ok().filter(|rows| *rows > 0)?,
        hashes: hashes.iter().map(hash).collect::<Option<_>>()?,
    })
    .filter(|_| rest.is_empty())
}

fn trained_blocks(blocks: &[TrainedBlocks]) -> String {
    let group = |group: &TrainedBlocks| {
        let hashes = group.hashes.iter().map(|hash| format!("{hash:016x}"));
        format!("{}:{}", group.rows, hashes.collect::<String>())
    };
    let groups: Vec<String> = blocks.iter().map(group).collect();
    groups.join(";")
}

/// Older files have no linear baseline, or one that reads velocities too.
fn read_linear(
    metadata: &Metadata<'_>,
    feature_set: FeatureSet,
) -> Result<Option<Linear>, ModelError> {
    let fields = ["linear_bias_w", "linear_weights", "linear_r2"];
    if !fields.iter().any(|field| metadata.0.contains_key(*field)) {
        return Ok(None);
    }
    let numbers = metadata.text("linear_weights")?.split(',').count();
    let feature_set = match numbers == FeatureSet::PowerOnly.inputs() {
        true => FeatureSet::PowerOnly,
        false => Linear::feature_set_beside(feature_set),
    };
    Ok(Some(Linear {
        feature_set,
        bias_w: metadata.number("linear_bias_w")?,
        weights: metadata.per_feature("linear_weights", feature_set)?,
        r2: metadata.number("linear_r2")?,
    }))
}

/// Older files and imported models have none.
fn read_energy(metadata: &Metadata<'_>) -> Result<Option<EnergyModel>, ModelError> {
    let Some(text) = metadata.0.get("energy") else {
        return Ok(None);
    };
    Ok(Some(EnergyModel::from_text(text)?))
}

fn fields(parameters: &Parameters, card: &ModelCard) -> Fields {
    let set = parameters.feature_set;
    let normalisation = &parameters.normalisation;
    let list_of = |set: FeatureSet, values: &Features| {
        let texts: Vec<String> = values[set.range()].iter().map(f32::to_string).collect();
        texts.join(",")
    };
    let list = |values: &Features| list_of(set, values);
    let mut fields = BTreeMap::from([
        ("format", FORMAT.to_owned()),
        ("format_version", VERSION.to_owned()),
        ("kind", KIND.to_owned()),
        ("activation", parameters.activation.name().to_owned()),
        ("convention", convention(set)),
        ("feature_set", set.name().to_owned()),
        ("features", FEATURE_NAMES[set.range()].join(",")),
        ("feature_mean", list(&normalisation.feature_mean)),
        ("feature_std", list(&normalisation.feature_std)),
        ("power_mean_w", normalisation.power_mean_w.to_string()),
        ("power_std_w", normalisation.power_std_w.to_string()),
        ("name", card.name.clone()),
        ("source", card.source.clone()),
        ("training_data", card.training_data.clone()),
        ("training_data_sha256", card.training_data_sha256.clone()),
        ("seed", card.seed.to_string()),
        ("feature_min", list(&card.training_range.min)),
        ("feature_max", list(&card.training_range.max)),
        ("residual_std_w", card.residual.std_w.to_string()),
        ("residual_q05_w", card.residual.q05_w.to_string()),
        ("residual_q95_w", card.residual.q95_w.to_string()),
        ("score_rows", card.scores.rows.to_string()),
        ("score_network_r2", card.scores.network_r2.to_string()),
        ("score_network_mae_w", card.scores.network_mae_w.to_string()),
        ("score_persistence_r2", card.scores.persistence_r2.to_string()),
        ("score_persistence_mae_w", card.scores.persistence_mae_w.to_string()),
    ]);
    if let Some(step_s) = card.step_s {
        fields.insert("step_s", step_s.to_string());
    }
    if let Some(TrainedRows { rows, blocks }) = &card.trained_rows {
        fields.insert("trained_rows", rows.to_string());
        fields.insert("trained_blocks", trained_blocks(blocks));
    }
    if let Some(linear) = &card.linear {
        fields.insert("linear_bias_w", linear.bias_w.to_string());
        fields.insert("linear_weights", list_of(linear.feature_set, &linear.weights));
        fields.insert("linear_r2", linear.r2.to_string());
    }
    if let Some(energy) = &card.energy {
        fields.insert("energy", energy.to_text());
    }
    fields
}

struct Tensor {
    name: String,
    shape: Vec<usize>,
    data: Vec<u8>,
}

fn tensors(parameters: &Parameters) -> Vec<Tensor> {
    let sizes = layer_sizes(parameters.feature_set);
    let bytes = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect();
    let mut tensors = Vec::new();
    for (number, (layer, (inputs, outputs))) in parameters.layers.iter().zip(sizes).enumerate() {
        let (bias, weights) = (bytes(&layer.bias), bytes(&layer.weights));
        tensors.push(Tensor { name: bias_name(number), shape: vec![outputs], data: bias });
        let shape = vec![outputs, inputs];
        tensors.push(Tensor { name: weight_name(number), shape, data: weights });
    }
    tensors
}

fn read_layers(
    tensors: &SafeTensors<'_>,
    feature_set: FeatureSet,
) -> Result<[Layer; 4], ModelError> {
    let mut layers = [const { Layer { weights: Vec::new(), bias: Vec::new() } }; 4];
    let sizes = layer_sizes(feature_set);
    let belongs = |name: &&str| {
        (0..sizes.len()).any(|number| **name == weight_name(number) || **name == bias_name(number))
    };
    if let Some(stranger) = tensors.names().into_iter().find(|name| !belongs(name)) {
        let allowed = 2 * sizes.len();
        return Err(ModelError::UnexpectedTensor { tensor: stranger.to_owned(), allowed });
    }
    for (number, (layer, (inputs, outputs))) in layers.iter_mut().zip(sizes).enumerate() {
        layer.weights = read_tensor(tensors, weight_name(number), &[outputs, inputs])?;
        layer.bias = read_tensor(tensors, bias_name(number), &[outputs])?;
    }
    Ok(layers)
}

fn read_tensor(
    tensors: &SafeTensors<'_>,
    name: String,
    shape: &[usize],
) -> Result<Vec<f32>, ModelError> {
    let Ok(view) = tensors.tensor(&name) else {
        return Err(ModelError::MissingTensor { tensor: name });
    };
    if view.dtype() != Dtype::F32 || view.shape() != shape {
        return Err(ModelError::Shape {
            tensor: name,
            found: format!("{:?} {:?}", view.dtype(), view.shape()),
            allowed: format!("{:?} {shape:?}", Dtype::F32),
        });
    }
    let (words, _) = view.data().as_chunks::<4>();
    Ok(words.iter().map(|word| f32::from_le_bytes(*word)).collect())
}

struct Metadata<'a>(BTreeMap<&'a str, &'a str>);

impl Metadata<'_> {
    fn text(&self, field: &'static str) -> Result<&str, ModelError> {
        self.0.get(field).copied().ok_or(ModelError::MissingField { field })
    }

    /// A text that people are shown, in terminals and pages.
    fn shown(&self, field: &'static str, max_bytes: usize) -> Result<String, ModelError> {
        let text = self.text(field)?;
        if text.len() > max_bytes {
            let found = format!("{} bytes", text.len());
            return Err(ModelError::field(field, &found, format!("{max_bytes} bytes")));
        }
        match text.chars().find(|letter| letter.is_control()) {
            Some(found) => Err(ModelError::field(
                field,
                &format!("{found:?}"),
                "text without control characters",
            )),
            None => Ok(text.to_owned()),
        }
    }

    fn must_be(&self, field: &'static str, allowed: &str) -> Result<(), ModelError> {
        let found = self.text(field)?;
        if found == allowed { Ok(()) } else { Err(ModelError::field(field, &found, allowed)) }
    }

    fn number<T: FromStr>(&self, field: &'static str) -> Result<T, ModelError> {
        let text = self.text(field)?;
        text.parse().map_err(|_| ModelError::field(field, &text, "a number"))
    }

    fn per_feature(&self, field: &'static str, set: FeatureSet) -> Result<Features, ModelError> {
        let text = self.text(field)?;
        let allowed = || format!("{} numbers", set.inputs());
        let numbers: Result<Vec<f32>, _> = text.split(',').map(f32::from_str).collect();
        let numbers = numbers.map_err(|_| ModelError::field(field, &text, allowed()))?;
        if numbers.len() != set.inputs() {
            let found = format!("{} numbers", numbers.len());
            return Err(ModelError::field(field, &found, allowed()));
        }
        let mut features = [0.0; INPUTS];
        features[set.range()].copy_from_slice(&numbers);
        Ok(features)
    }
}

fn check_digest(metadata: &Metadata<'_>, tensors: &SafeTensors<'_>) -> Result<(), ModelError> {
    let stated = metadata.text("sha256")?;
    let fields = metadata.0.iter().filter(|(key, _)| **key != "sha256");
    let views: BTreeMap<&str, TensorView<'_>> = tensors.iter().collect();
    let found = hex(&digest(
        fields.map(|(key, value)| (*key, *value)),
        views.iter().map(|(name, view)| (*name, view.shape(), view.data())),
    ));
    if found == stated {
        Ok(())
    } else {
        Err(ModelError::Checksum { found, stated: stated.to_owned() })
    }
}

/// SHA-256 of metadata (without its own entry) and tensors, each ascending by name: every text and
/// every list is preceded by its length, every number is a little-endian u64.
fn digest<'a>(
    fields: impl Iterator<Item = (&'a str, &'a str)>,
    tensors: impl Iterator<Item = (&'a str, &'a [usize], &'a [u8])>,
) -> Vec<u8> {
    let mut digest = Sha256::new();
    let mut add = |bytes: &[u8]| {
        digest.update((bytes.len() as u64).to_le_bytes());
        digest.update(bytes);
    };
    for (key, value) in fields {
        add(key.as_bytes());
        add(value.as_bytes());
    }
    for (name, shape, data) in tensors {
        add(name.as_bytes());
        let shape: Vec<u8> = shape.iter().flat_map(|&n| (n as u64).to_le_bytes()).collect();
        add(&shape);
        add(data);
    }
    digest.finalize().to_vec()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The first eight bytes as a big-endian number.
pub(crate) fn leading_u64(digest: &[u8]) -> u64 {
    digest.iter().take(8).fold(0, |hash, &byte| hash << 8 | u64::from(byte))
}
