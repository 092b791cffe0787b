//! Exports a model as plain arrays or as an ONNX graph.

use prost::Message as _;

use joulebus_dataset::npy;
use joulebus_predictor::{Features, ModelError, Network};
use joulebus_statistics::noise::Noise;

use crate::arrays::{self, Array};
use crate::{npz, onnx};

/// Number of rows that exported arrays include with their forecasts.
pub const CHECK_ROWS: usize = 32;

/// Errors of exporting a model.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum ExportError {
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error(
        "the network reads the age of readings, which `step(v_cmd, w_cmd)` does not get. Export \
         it as .onnx or .npz, or train one without that input: `joulebus train … --features full`"
    )]
    ReadingAge,
}

/// The model as plain NumPy arrays: name without `.npy`, and the bytes of its file. All numbers are
/// `<f4`, in SI units.
///
/// - `layers.0.weight` (64, 11) … `layers.3.bias` (1): one row of inputs per output.
/// - `feature_mean`, `feature_std` (11), `power_mean_w`, `power_std_w` (scalars): the forecast is
///   the last layer times `power_std_w` plus `power_mean_w`. A feature that was constant in
///   training has no effect: its deviation is 1 and its weights are 0. The weights that the model
///   file has instead are in `constant_feature_weight`, only there where needed.
/// - `feature_min`, `feature_max` (11): the training range.
/// - `metadata` (text): the other contents of the model file, as JSON.
/// - `check_features` ([`CHECK_ROWS`], 11) and `check_power_w` ([`CHECK_ROWS`]): rows within the
///   training range and their forecasts, for testing a reimplementation of the network.
///
/// A network of readings alone has 5 instead of 11. One that reads the reading age has two more,
/// the last.
///
/// # Errors
/// [`ExportError`]: a card too long for a model file.
pub fn to_arrays(network: &Network) -> Result<Vec<(String, Vec<u8>)>, ExportError> {
    let metadata = arrays::metadata(&network.to_safetensors()?)?;
    let descr = format!("|S{}", metadata.len());
    let metadata = file(&descr, &[], metadata.as_bytes());
    let mut files = vec![(arrays::METADATA.to_owned(), metadata)];
    for Array { name, shape, values } in arrays::arrays(network) {
        files.push((name, plain(&shape, values.into_iter())));
    }
    let rows = check_rows(network);
    let mut forecasts_w = [0.0; CHECK_ROWS];
    network.predict(&rows, &mut forecasts_w);
    let set = network.feature_set();
    let inputs = rows.iter().flat_map(|row| row[set.range()].to_vec());
    let name = |what: &str| format!("{}{what}", arrays::CHECK);
    let shape = [CHECK_ROWS, set.inputs()];
    files.push((name("features"), plain(&shape, inputs)));
    files.push((name("power_w"), plain(&[CHECK_ROWS], forecasts_w.into_iter())));
    Ok(files)
}

/// The model as an archive of [`to_arrays`], uncompressed: the same bytes for the same model.
///
/// # Errors
/// As [`to_arrays`].
pub fn to_npz(network: &Network) -> Result<Vec<u8>, ExportError> {
    let arrays = to_arrays(network)?.into_iter();
    let members: Vec<_> = arrays.map(|(name, bytes)| (format!("{name}.npy"), bytes)).collect();
    Ok(npz::archive(&members))
}

/// The model as an ONNX graph, opset 17: input `features` (n, 11) in SI units, as the worker has
/// them, and output `power_w` (n, 1). The normalisation is part of the graph. GELU is written with
/// `Erf` (or `Tanh`), which every runtime knows, while the operator `Gelu` needs opset 20.
///
/// # Errors
/// [`ExportError`]: a card too long for a model file.
pub fn to_onnx(network: &Network) -> Result<Vec<u8>, ExportError> {
    let metadata = arrays::metadata(&network.to_safetensors()?)?;
    Ok(onnx::model(network, &metadata).encode_to_vec())
}

fn plain(shape: &[usize], values: impl Iterator<Item = f32>) -> Vec<u8> {
    let bytes: Vec<u8> = values.flat_map(f32::to_le_bytes).collect();
    file("<f4", shape, &bytes)
}

/// An array file in NumPy's format. `element` is the type and `contents` its bytes.
fn file(element: &str, shape: &[usize], contents: &[u8]) -> Vec<u8> {
    let mut bytes = npy::header(element, shape);
    bytes.extend(contents);
    bytes
}

/// Random rows within the training range.
fn check_rows(network: &Network) -> [Features; CHECK_ROWS] {
    let range = &network.card().training_range;
    let mut noise = Noise::new(network.hash(), 0);
    std::array::from_fn(|_| {
        std::array::from_fn(|feature| {
            if feature >= network.feature_set().end() {
                return 0.0;
            }
            let (min, max) = (range.min[feature], range.max[feature]);
            min + (max - min) * noise.uniform() as f32
        })
    })
}
