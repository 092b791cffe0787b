//! Plain networks: safetensors with fixed names, as `joulebus.models.convert` of the Python package
//! writes them.

use std::collections::BTreeMap;

use hmac_sha256::Hash as Sha256;
use joulebus_predictor::{FEATURES, FeatureSet, HIDDEN, LAGS, Layer};
use safetensors::SafeTensors;
use safetensors::tensor::Dtype;

use crate::convention::{
    ACTIVATIONS, CommandConvention, Convention, DERIVATIVES, LAG_PLACES, MAGNITUDES, ORDERS, UNITS,
};

/// Maximum size of a plain network, bytes: the largest one has some 60 kB.
pub const MAX_FILE_BYTES: usize = 1 << 20;
/// Tensors beside the layers.
const STATISTICS: [&str; 4] = ["feature_mean", "feature_std", "power_mean", "power_std"];
/// Maximum relative difference between a statistic of the file and that which the statement gives.
const MAX_DIFFERENCE: f64 = 1e-5;

/// A network whose author states how its features were computed.
#[derive(Clone, Debug, PartialEq)]
pub struct Plain {
    pub(super) convention: Convention,
    /// One to three hidden layers and the output.
    pub(super) layers: Vec<Layer>,
    /// Mean and standard deviation of each input, in the file's order and units.
    pub(super) inputs: Vec<(f64, f64)>,
    /// Mean and standard deviation of the forecast, in the file's unit.
    pub(super) power: (f64, f64),
    /// SHA-256 of the file, hexadecimal.
    pub(super) sha256: String,
    /// Name of the file that was converted, and its SHA-256.
    pub(super) source: String,
}

/// Errors of reading a plain network. The caller adds the file's name.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum PlainError {
    #[error("the file has {found} bytes, a network has at most {MAX_FILE_BYTES}")]
    TooLarge { found: usize },
    #[error("not a complete safetensors file ({0}). Convert the network again")]
    Container(String),
    #[error("{part} {found}, allowed: {allowed}")]
    Part { part: String, found: String, allowed: String },
}

fn bad(part: &str, found: String, allowed: impl Into<String>) -> PlainError {
    PlainError::Part { part: part.to_owned(), found, allowed: allowed.into() }
}

impl Plain {
    /// Reads a plain network: `layers.0.weight` (outputs, inputs), `layers.0.bias`, …,
    /// `feature_mean`, `feature_std` (inputs), `power_mean`, `power_std`, and the convention as
    /// metadata.
    ///
    /// # Errors
    /// [`PlainError`] with what was found and what is allowed.
    pub fn read(bytes: &[u8]) -> Result<Plain, PlainError> {
        if bytes.len() > MAX_FILE_BYTES {
            return Err(PlainError::TooLarge { found: bytes.len() });
        }
        let container =
            |error: safetensors::SafeTensorError| PlainError::Container(error.to_string());
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(container)?;
        let file = SafeTensors::deserialize(bytes).map_err(container)?;
        let metadata = header.metadata().iter().flatten();
        let metadata: BTreeMap<&str, &str> =
            metadata.map(|(name, text)| (name.as_str(), text.as_str())).collect();

        let layers = layers(&file)?;
        let widths: Vec<usize> = layers.iter().map(|layer| layer.bias.len()).collect();
        let inputs = layers.first().map_or(0, |layer| layer.weights.len() / layer.bias.len());
        check_widths(inputs, &widths)?;
        let known = |name: &str| {
            STATISTICS.contains(&name)
                || (0..layers.len()).any(|at| names(at).contains(&name.to_owned()))
        };
        if let Some(name) = file.names().into_iter().find(|name| !known(name)) {
            let allowed = format!("layers.N.weight, layers.N.bias, {}", STATISTICS.join(", "));
            return Err(bad(
                &format!("tensor {name:?}"),
                "belongs to no network".to_owned(),
                allowed,
            ));
        }
        let pair = |quantity: &str, count: usize| -> Result<Vec<(f64, f64)>, PlainError> {
            let mean = statistic(&file, &format!("{quantity}_mean"), count, false)?;
            let std = statistic(&file, &format!("{quantity}_std"), count, true)?;
            Ok(mean.into_iter().zip(std).collect())
        };
        let text = |name: &str| metadata.get(name).copied().unwrap_or_default();
        let plain = Plain {
            convention: convention(&metadata, inputs == FEATURES)?,
            layers,
            inputs: pair("feature", inputs)?,
            power: pair("power", 1)?[0],
            sha256: Sha256::hash(bytes).iter().map(|byte| format!("{byte:02x}")).collect(),
            source: format!("{} {}", text("source"), text("source_sha256")).trim().to_owned(),
        };
        plain.check_stated_statistics()?;
        Ok(plain)
    }

    /// The convention that the file states.
    pub fn convention(&self) -> &Convention {
        &self.convention
    }

    /// The features that the network reads.
    pub fn feature_set(&self) -> FeatureSet {
        match self.inputs.len() {
            LAGS => FeatureSet::PowerOnly,
            _ => FeatureSet::Full,
        }
    }

    /// Widths of the network, inputs first.
    pub fn widths(&self) -> Vec<usize> {
        let outputs = self.layers.iter().map(|layer| layer.bias.len());
        std::iter::once(self.inputs.len()).chain(outputs).collect()
    }

    /// Refuses statistics of derivatives and magnitudes other than those that the statement gives.
    fn check_stated_statistics(&self) -> Result<(), PlainError> {
        for feature in 2..self.inputs.len().saturating_sub(LAGS) {
            let place = self.place(feature, &self.convention);
            let (found, stated) =
                (self.inputs[place], self.normalisation(feature, &self.convention));
            let is_near = |found: f64, stated: f64| {
                (found - stated).abs() <= MAX_DIFFERENCE * found.abs().max(stated.abs())
            };
            if !(is_near(found.0, stated.0) && is_near(found.1, stated.1)) {
                let part = format!("input {place} of feature_mean and feature_std");
                let allowed = format!("{} and {} by {}", stated.0, stated.1, self.convention);
                return Err(bad(&part, format!("is {} and {}", found.0, found.1), allowed));
            }
        }
        Ok(())
    }
}

fn names(layer: usize) -> [String; 2] {
    [format!("layers.{layer}.weight"), format!("layers.{layer}.bias")]
}

/// The layers, whose numbers are finite and whose shapes agree.
fn layers(file: &SafeTensors<'_>) -> Result<Vec<Layer>, PlainError> {
    let mut layers: Vec<Layer> = Vec::new();
    while layers.is_empty() || file.tensor(&names(layers.len())[0]).is_ok() {
        let [weight, bias] = names(layers.len());
        let (shape, weights) = numbers(file, &weight)?;
        let before = layers.last().map(|layer| layer.bias.len());
        let (outputs, inputs) = match shape.as_slice() {
            [outputs, inputs]
                if *outputs > 0 && *inputs > 0 && before.is_none_or(|before| before == *inputs) =>
            {
                (*outputs, *inputs)
            }
            _ => {
                let inputs = before.map_or("inputs".to_owned(), |before| before.to_string());
                let allowed = format!("(outputs, {inputs})");
                return Err(bad(
                    &format!("tensor {weight:?}"),
                    format!("has shape {shape:?}"),
                    allowed,
                ));
            }
        };
        let (shape, biases) = numbers(file, &bias)?;
        if shape != [outputs] {
            let found = format!("has shape {shape:?}");
            return Err(bad(&format!("tensor {bias:?}"), found, format!("[{outputs}]")));
        }
        let finite = |name: &str, values: Vec<f64>| -> Result<Vec<f32>, PlainError> {
            let wrong = values.iter().position(|value| !(*value as f32).is_finite());
            match wrong {
                Some(at) => Err(bad(
                    &format!("tensor {name:?}"),
                    format!("has {} at position {at}", values[at]),
                    "finite numbers of f32",
                )),
                None => Ok(values.into_iter().map(|value| value as f32).collect()),
            }
        };
        debug_assert_eq!(weights.len(), outputs * inputs);
        layers.push(Layer { weights: finite(&weight, weights)?, bias: finite(&bias, biases)? });
    }
    Ok(layers)
}

/// Refuses networks that the worker does not run.
fn check_widths(inputs: usize, outputs: &[usize]) -> Result<(), PlainError> {
    let fits = match outputs {
        [hidden @ .., 1] => {
            [FEATURES, LAGS].contains(&inputs)
                && (1..=HIDDEN.len()).contains(&hidden.len())
                && hidden.iter().zip(HIDDEN).all(|(width, limit)| *width <= limit)
        }
        _ => false,
    };
    if fits {
        return Ok(());
    }
    let widths = std::iter::once(inputs).chain(outputs.iter().copied());
    let widths: Vec<String> = widths.map(|width| width.to_string()).collect();
    let allowed = "11→64→64→32→1 or smaller: 11 inputs, or the 5 readings alone, and one to three \
                   hidden layers of at most 64, 64 and 32 units. Train a smaller one";
    Err(bad("the network", format!("is {}", widths.join("→")), allowed))
}

/// Shape and values of a tensor.
fn numbers(file: &SafeTensors<'_>, name: &str) -> Result<(Vec<usize>, Vec<f64>), PlainError> {
    let part = || format!("tensor {name:?}");
    let Ok(view) = file.tensor(name) else {
        let allowed =
            format!("layers.N.weight, layers.N.bias from N = 0, {}", STATISTICS.join(", "));
        return Err(bad(&part(), "is missing".to_owned(), allowed));
    };
    let data = view.data();
    let values = match view.dtype() {
        Dtype::F32 => {
            data.as_chunks().0.iter().map(|word| f64::from(f32::from_le_bytes(*word))).collect()
        }
        Dtype::F64 => data.as_chunks().0.iter().map(|word| f64::from_le_bytes(*word)).collect(),
        other => return Err(bad(&part(), format!("has elements {other:?}"), "F32, F64")),
    };
    Ok((view.shape().to_vec(), values))
}

/// Means or deviations of `count` quantities.
fn statistic(
    file: &SafeTensors<'_>,
    name: &str,
    count: usize,
    is_deviation: bool,
) -> Result<Vec<f64>, PlainError> {
    let (shape, values) = numbers(file, name)?;
    let part = format!("tensor {name:?}");
    if values.len() != count || shape.len() > 1 {
        return Err(bad(&part, format!("has shape {shape:?}"), format!("{count} numbers")));
    }
    let fine = |value: f64| (value as f32).is_finite() && (!is_deviation || value >= 0.0);
    match values.iter().position(|value| !fine(*value)) {
        Some(at) => {
            let allowed = if is_deviation { "finite numbers from 0" } else { "finite numbers" };
            Err(bad(&part, format!("has {} at position {at}", values[at]), allowed))
        }
        None => Ok(values),
    }
}

/// The convention that the metadata state.
fn convention(
    metadata: &BTreeMap<&str, &str>,
    has_command: bool,
) -> Result<Convention, PlainError> {
    let command = || -> Result<CommandConvention, PlainError> {
        Ok(CommandConvention {
            lags: stated(metadata, "lags", &LAG_PLACES)?,
            derivative: stated(metadata, "derivative", &DERIVATIVES)?,
            // The last one cannot run.
            magnitude: stated(metadata, "magnitude", &MAGNITUDES[..MAGNITUDES.len() - 1])?,
        })
    };
    Ok(Convention {
        unit: stated(metadata, "unit", &UNITS)?,
        order: stated(metadata, "lag_order", &ORDERS)?,
        activation: stated(metadata, "activation", &ACTIVATIONS)?,
        command: has_command.then(command).transpose()?,
    })
}

fn stated<T: Copy>(
    metadata: &BTreeMap<&str, &str>,
    key: &str,
    names: &[(T, &'static str)],
) -> Result<T, PlainError> {
    let text = metadata.get(key);
    let value = names.iter().find(|(_, name)| text.is_some_and(|text| text == name));
    value.map(|(value, _)| *value).ok_or_else(|| {
        let found = text.map_or("is missing".to_owned(), |text| format!("is {text:?}"));
        let allowed: Vec<&str> = names.iter().map(|(_, name)| *name).collect();
        bad(&format!("metadata {key:?}"), found, allowed.join(", "))
    })
}
