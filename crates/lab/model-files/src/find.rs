//! Finds the network in a file with unknown names.

use super::layers::{Arrays, Named, any_widths, arrays_in, within};
use super::names::tokens;
use super::normalisation::{self, FoundNormalisation};
use super::{Checkpoint, Entry, EntryValue, FindError, activation};
use joulebus_predictor::{Activation, FeatureSet, HIDDEN, Layer};

/// A network as found, with its feature convention still unknown.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// The paper's features or the readings alone, by the width of the first layer.
    pub feature_set: FeatureSet,
    /// The activation of the hidden layers.
    pub activation: Activation,
    /// Source of the activation.
    pub activation_from: ActivationFrom,
    /// The layers, first to last: one to three hidden ones and the output.
    pub layers: Vec<FoundLayer>,
    /// True if the file's matrices have one row per input instead of per output.
    pub transposed: bool,
    /// True if the biases were assigned by name. Otherwise they were assigned by order.
    pub paired_by_name: bool,
    /// The statistics of the normalisation.
    pub normalisation: FoundNormalisation,
}

/// The source of the activation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActivationFrom {
    /// The caller named it.
    Caller,
    /// The file states it.
    File,
    /// GELU by the error function, the default of PyTorch and of the published model's paper: the
    /// file states none.
    Default,
}

/// A layer as found.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundLayer {
    /// Path of its weights.
    pub weight_path: String,
    /// Path of its biases.
    pub bias_path: String,
    /// Weights, one row of inputs per output, inputs in the file's order.
    pub layer: Layer,
}

impl Checkpoint {
    /// Finds the network: its arrays by their shapes within the smallest part of the file that has
    /// exactly one of each (or within `part`), its normalisation by name. Weights of other networks
    /// and optimizer moments in the same file are ignored. `activation` is that of the hidden
    /// layers, whatever the file states.
    ///
    /// # Errors
    /// [`FindError`]: no network, several or a larger one, numbers that are not finite, an
    /// unsupported activation, or an incomplete normalisation.
    pub fn find(
        &self,
        part: Option<&str>,
        activation: Option<Activation>,
    ) -> Result<Found, FindError> {
        let part_of = part.unwrap_or_default();
        let factor = self.entries.iter().find(|entry| {
            let path = &entry.path;
            let ends = ["weight_g", "weight_v", "weight_orig"];
            let is_factor =
                path.contains("parametrizations.") || ends.iter().any(|end| path.ends_with(end));
            within(path, part_of) && is_factor && matches!(entry.value, EntryValue::Tensor(_))
        });
        if let Some(entry) = factor {
            let path = entry.path.clone();
            return Err(FindError::Parametrised { path });
        }
        let arrays = self.arrays(part)?;
        let (activation, activation_from) = match activation {
            Some(asked) => (asked, ActivationFrom::Caller),
            None => match activation::stated(&self.entries)? {
                Some(stated) => (stated, ActivationFrom::File),
                None => (Activation::GeluErf, ActivationFrom::Default),
            },
        };
        let taken: Vec<&str> =
            arrays.weights.iter().chain(&arrays.biases).map(|named| named.0).collect();
        let rest = self.entries.iter().filter(|entry| !taken.contains(&&*entry.path));
        let widths: Vec<usize> = arrays.biases.iter().map(|bias| bias.1.values().len()).collect();
        if let Some(entry) = rest.clone().find(|entry| is_of_normalisation_layer(entry, &widths)) {
            let path = entry.path.clone();
            return Err(FindError::NormalisationLayer { path });
        }
        let normalisation = normalisation::find(rest, arrays.feature_set)?;
        let mut layers = Vec::with_capacity(HIDDEN.len() + 1);
        for (weight, bias) in arrays.weights.iter().zip(&arrays.biases) {
            layers.push(FoundLayer {
                weight_path: weight.0.to_owned(),
                bias_path: bias.0.to_owned(),
                layer: Layer {
                    weights: finite(weight, arrays.transposed)?,
                    bias: finite(bias, false)?,
                },
            });
        }
        Ok(Found {
            feature_set: arrays.feature_set,
            activation,
            activation_from,
            layers,
            transposed: arrays.transposed,
            paired_by_name: arrays.paired_by_name,
            normalisation,
        })
    }

    /// The arrays of the network in a part, or in the only part that has one.
    fn arrays(&self, part: Option<&str>) -> Result<Arrays<'_>, FindError> {
        let in_order = self.container.is_ordered();
        let mut parts = complete_parts(&self.entries, in_order);
        if let Some(part) = part {
            return arrays_in(&self.entries, part, in_order).ok_or_else(|| {
                let found = names(parts.iter().map(|(part, _)| part.as_str()));
                FindError::NoSuchPart { asked: part.to_owned(), found }
            });
        }
        match (parts.pop(), parts.is_empty()) {
            (Some((_, arrays)), true) => Ok(arrays),
            (Some((last, _)), false) => {
                let parts = parts.iter().map(|(part, _)| part.as_str());
                let found = names(parts.chain([last.as_str()]));
                Err(FindError::Several { found })
            }
            (None, _) => Err(self.no_network()),
        }
    }

    /// Reason that there is no network.
    fn no_network(&self) -> FindError {
        match any_widths(&self.entries) {
            Some(widths) if !fits(&widths) => {
                let widths: Vec<String> = widths.iter().map(usize::to_string).collect();
                let found = widths.join("→");
                FindError::TooLarge { found }
            }
            _ => FindError::NoNetwork { found: shapes(&self.entries) },
        }
    }
}

/// True if an array is a vector of a layer of batch or layer normalisation, by its name and the
/// width of a layer.
fn is_of_normalisation_layer(entry: &Entry, widths: &[usize]) -> bool {
    let EntryValue::Tensor(tensor) = &entry.value else {
        return false;
    };
    let layers = ["norm", "bn", "ln", "batchnorm", "layernorm", "running"];
    let named = tokens(&entry.path).iter().any(|word| layers.contains(&word.as_str()));
    named && matches!(*tensor.shape(), [width] if width > 1 && widths.contains(&width))
}

/// True if the worker has a network of these widths, inputs first.
fn fits(widths: &[usize]) -> bool {
    let [inputs, hidden @ .., _] = widths else {
        return false;
    };
    let sets = [
        FeatureSet::Full,
        FeatureSet::PowerOnly,
        FeatureSet::Freshness,
        FeatureSet::PowerFreshness,
    ];
    sets.iter().any(|set| set.inputs() == *inputs)
        && hidden.len() <= HIDDEN.len()
        && hidden.iter().zip(HIDDEN).all(|(width, limit)| *width <= limit)
}

/// The smallest parts of the file that hold a network, in the file's order. Of nested parts with
/// networks of different depth, the deeper one's.
fn complete_parts(entries: &[Entry], in_order: bool) -> Vec<(String, Arrays<'_>)> {
    let mut parts: Vec<&str> = vec![""];
    for entry in entries {
        let cuts = entry.path.match_indices('.').map(|(at, _)| &entry.path[..at]);
        for part in cuts {
            if !parts.contains(&part) && parts.len() < MAX_PARTS {
                parts.push(part);
            }
        }
    }
    let complete: Vec<(&str, Arrays<'_>)> = parts
        .iter()
        .filter_map(|part| Some((*part, arrays_in(entries, part, in_order)?)))
        .collect();
    let found: Vec<(&str, usize)> =
        complete.iter().map(|(part, arrays)| (*part, arrays.weights.len())).collect();
    let is_chosen = |part: &str, layers: usize| {
        !found.iter().any(|&(other, others)| {
            let inside = other != part && within(other, part);
            let outside = other != part && within(part, other);
            (inside && others >= layers) || (outside && others > layers)
        })
    };
    complete
        .into_iter()
        .filter(|(part, arrays)| is_chosen(part, arrays.weights.len()))
        .map(|(part, arrays)| (part.to_owned(), arrays))
        .collect()
}

/// Maximum number of parts searched.
const MAX_PARTS: usize = 512;

fn finite(named: &Named<'_>, transposed: bool) -> Result<Vec<f32>, FindError> {
    let (path, tensor) = *named;
    let values = tensor.values();
    let wrong = values.iter().position(|value| !(*value as f32).is_finite());
    if let Some(index) = wrong {
        return Err(FindError::NotFinite { path: path.to_owned(), index, value: values[index] });
    }
    let values = values.iter().map(|value| *value as f32);
    let &[rows, columns] = tensor.shape() else {
        return Ok(values.collect());
    };
    if !transposed {
        return Ok(values.collect());
    }
    let values: Vec<f32> = values.collect();
    let column = |column: usize| values[column..].iter().step_by(columns).take(rows);
    Ok((0..columns).flat_map(column).copied().collect())
}

fn names<'a>(parts: impl Iterator<Item = &'a str>) -> String {
    let parts: Vec<String> = parts.map(|part| format!("{part:?}")).collect();
    match parts.as_slice() {
        [] => "none".to_owned(),
        parts => parts.join(", "),
    }
}

/// Summary of the arrays of a file.
fn shapes(entries: &[Entry]) -> String {
    let tensors: Vec<String> = entries
        .iter()
        .filter_map(|entry| match &entry.value {
            EntryValue::Tensor(tensor) => Some(format!("{} {:?}", entry.path, tensor.shape())),
            _ => None,
        })
        .collect();
    let more = tensors.len().saturating_sub(20);
    let mut shown: Vec<String> = tensors.into_iter().take(20).collect();
    if more > 0 {
        shown.push(format!("{more} more"));
    }
    match shown.as_slice() {
        [] => "no arrays".to_owned(),
        shown => shown.join(", "),
    }
}
