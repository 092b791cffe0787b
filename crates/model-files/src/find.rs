//! Finds the network in a file with unknown names.

use super::names::tokens;
use super::normalisation::{self, FoundNormalisation};
use super::{Checkpoint, Entry, EntryValue, FindError, Tensor};
use joulebus_predictor::{Activation, FeatureSet, HIDDEN, Layer};

/// A network as found, with its feature convention still unknown.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// The paper's features or the readings alone, by the width of the first layer.
    pub feature_set: FeatureSet,
    /// The activation of the hidden layers: as stated in the file, or GELU by the error function,
    /// the default of PyTorch and of the published model's paper.
    pub activation: Activation,
    /// Whether the file states it.
    pub activation_stated: bool,
    /// The layers, first to last.
    pub layers: [FoundLayer; 4],
    /// Whether the file's matrices have one row per input instead of per output.
    pub transposed: bool,
    /// Whether the biases were assigned by name; otherwise by order.
    pub paired_by_name: bool,
    /// The statistics of the normalisation.
    pub normalisation: FoundNormalisation,
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
    /// and optimizer moments in the same file are ignored.
    ///
    /// # Errors
    /// [`FindError`]: no network or several, numbers that are not finite, an unsupported
    /// activation, or an incomplete normalisation.
    pub fn find(&self, part: Option<&str>) -> Result<Found, FindError> {
        let activation = activation(&self.entries)?;
        let set = match part {
            Some(part) => match arrays_in(&self.entries, part) {
                Some(set) => set,
                None => {
                    let asked = part.to_owned();
                    let found = complete_parts(&self.entries);
                    let found = names(found.iter().map(|(part, _)| part.as_str()));
                    return Err(FindError::NoSuchPart { asked, found });
                }
            },
            None => {
                let mut parts = complete_parts(&self.entries);
                match (parts.pop(), parts.is_empty()) {
                    (Some((_, set)), true) => set,
                    (Some((last, _)), false) => {
                        let parts = parts.iter().map(|(part, _)| part.as_str());
                        let found = names(parts.chain([last.as_str()]));
                        return Err(FindError::Several { found });
                    }
                    (None, _) => {
                        let found = shapes(&self.entries);
                        return Err(FindError::NoNetwork { found });
                    }
                }
            }
        };
        let taken: Vec<&str> = set.weights.iter().chain(&set.biases).map(|t| t.0).collect();
        let rest = self
            .entries
            .iter()
            .filter(|entry| !taken.contains(&&*entry.path));
        let normalisation = normalisation::find(rest, set.feature_set)?;
        let mut layers = Vec::with_capacity(4);
        for (weight, bias) in set.weights.iter().zip(&set.biases) {
            layers.push(FoundLayer {
                weight_path: weight.0.to_owned(),
                bias_path: bias.0.to_owned(),
                layer: Layer {
                    weights: finite(weight, set.transposed)?,
                    bias: finite(bias, false)?,
                },
            });
        }
        let Ok(layers) = <[FoundLayer; 4]>::try_from(layers) else {
            let found = shapes(&self.entries);
            return Err(FindError::NoNetwork { found });
        };
        Ok(Found {
            feature_set: set.feature_set,
            activation: activation.unwrap_or(Activation::GeluErf),
            activation_stated: activation.is_some(),
            layers,
            transposed: set.transposed,
            paired_by_name: set.paired_by_name,
            normalisation,
        })
    }
}

type Named<'a> = (&'a str, &'a Tensor);

/// The eight arrays of a network.
struct Arrays<'a> {
    feature_set: FeatureSet,
    transposed: bool,
    paired_by_name: bool,
    weights: [Named<'a>; 4],
    biases: [Named<'a>; 4],
}

/// The smallest parts of the file that hold a network, in the file's order.
fn complete_parts(entries: &[Entry]) -> Vec<(String, Arrays<'_>)> {
    let mut parts: Vec<&str> = vec![""];
    for entry in entries {
        let cuts = entry
            .path
            .match_indices('.')
            .map(|(at, _)| &entry.path[..at]);
        for part in cuts {
            if !parts.contains(&part) && parts.len() < MAX_PARTS {
                parts.push(part);
            }
        }
    }
    let complete: Vec<(&str, Arrays<'_>)> = parts
        .iter()
        .filter_map(|part| Some((*part, arrays_in(entries, part)?)))
        .collect();
    let contains = |outer: &str, inner: &str| outer != inner && within(inner, outer);
    let names: Vec<&str> = complete.iter().map(|(part, _)| *part).collect();
    let is_smallest = |part: &str| !names.iter().any(|other| contains(part, other));
    complete
        .into_iter()
        .filter(|(part, _)| is_smallest(part))
        .map(|(part, arrays)| (part.to_owned(), arrays))
        .collect()
}

/// Maximum number of parts searched.
const MAX_PARTS: usize = 512;

fn within(path: &str, part: &str) -> bool {
    part.is_empty()
        || path == part
        || path
            .strip_prefix(part)
            .is_some_and(|rest| rest.starts_with('.'))
}

/// The arrays of a network, if this part of the file has exactly one of each.
fn arrays_in<'a>(entries: &'a [Entry], part: &str) -> Option<Arrays<'a>> {
    let tensors: Vec<Named<'_>> = entries
        .iter()
        .filter(|entry| within(&entry.path, part) && !normalisation::is_statistic(&entry.path))
        .filter_map(|entry| match &entry.value {
            EntryValue::Tensor(tensor) => Some((entry.path.as_str(), tensor)),
            _ => None,
        })
        .collect();
    // Another program's definition of the reading age cannot be determined from numbers.
    [FeatureSet::Full, FeatureSet::PowerOnly]
        .into_iter()
        .flat_map(|set| [false, true].map(|transposed| (set, transposed)))
        .find_map(|(set, transposed)| arrays(&tensors, set, transposed))
}

fn arrays<'a>(
    tensors: &[Named<'a>],
    feature_set: FeatureSet,
    transposed: bool,
) -> Option<Arrays<'a>> {
    let [first, second, third] = HIDDEN;
    let sizes = [
        (first, feature_set.inputs()),
        (second, first),
        (third, second),
        (1, third),
    ];
    let mut weights = Vec::new();
    for (outputs, inputs) in sizes {
        let shape = if transposed {
            [inputs, outputs]
        } else {
            [outputs, inputs]
        };
        let mut fitting = tensors.iter().filter(|(_, tensor)| tensor.shape() == shape);
        match (fitting.next(), fitting.next()) {
            (Some(only), None) => weights.push(*only),
            _ => return None,
        }
    }
    let weights = <[Named<'a>; 4]>::try_from(weights).ok()?;
    let is_bias = |tensor: &Tensor, outputs: usize| match *tensor.shape() {
        [] => outputs == 1,
        [size] => size == outputs,
        [1, size] if transposed || size == 1 => size == outputs,
        [size, 1] if !transposed => size == outputs,
        _ => false,
    };
    let biases_of = |outputs: usize| -> Vec<Named<'a>> {
        let biases = tensors
            .iter()
            .filter(|(_, tensor)| is_bias(tensor, outputs));
        biases.copied().collect()
    };
    let fitting: Vec<Vec<Named<'a>>> = sizes.iter().map(|size| biases_of(size.0)).collect();
    let by_name = |layer: usize| {
        let stem = stem(weights[layer].0);
        let mut same = fitting[layer]
            .iter()
            .filter(|(path, _)| self::stem(path) == stem);
        match (same.next(), same.next()) {
            (Some(only), None) => Some(*only),
            _ => None,
        }
    };
    let named: Option<Vec<Named<'a>>> = (0..4).map(by_name).collect();
    let is_whole = fitting[0].len() == 2 && fitting[2].len() == 1;
    if let (Some(biases), true) = (named, is_whole) {
        return Some(Arrays {
            feature_set,
            transposed,
            paired_by_name: true,
            weights,
            biases: <[Named<'a>; 4]>::try_from(biases).ok()?,
        });
    }
    // Without names, the first of the two biases of length 64 belongs to the first layer.
    match (
        fitting[0].as_slice(),
        fitting[2].as_slice(),
        fitting[3].as_slice(),
    ) {
        (&[first, second], &[third], &[last]) => Some(Arrays {
            feature_set,
            transposed,
            paired_by_name: false,
            weights,
            biases: [first, second, third, last],
        }),
        _ => None,
    }
}

/// A path without the component that distinguishes weights from biases: equal for the two arrays of
/// a layer.
fn stem(path: &str) -> Vec<String> {
    let same = |token: String| match token.as_str() {
        "weight" | "weights" | "kernel" | "w" | "coef" | "coefs" => "#".to_owned(),
        "bias" | "biases" | "b" | "intercept" | "intercepts" => "#".to_owned(),
        _ => token,
    };
    tokens(path).into_iter().map(same).collect()
}

fn finite(named: &Named<'_>, transposed: bool) -> Result<Vec<f32>, FindError> {
    let (path, tensor) = *named;
    let values = tensor.values();
    let wrong = values.iter().position(|value| !(*value as f32).is_finite());
    if let Some(index) = wrong {
        return Err(FindError::NotFinite {
            path: path.to_owned(),
            index,
            value: values[index],
        });
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

/// The activation, if the file holds layers that state it.
fn activation(entries: &[Entry]) -> Result<Option<Activation>, FindError> {
    let mut stated = None;
    for Entry { path, value } in entries {
        let says = path == "approximate" || path.ends_with(".approximate");
        let EntryValue::Text(found) = value else {
            continue;
        };
        if !says {
            continue;
        }
        let activation = match found.as_str() {
            "none" => Some(Activation::GeluErf),
            "tanh" => Some(Activation::GeluTanh),
            _ => None,
        };
        if activation.is_none() || (stated.is_some() && stated != activation) {
            return Err(FindError::Activation {
                path: path.clone(),
                found: found.clone(),
            });
        }
        stated = activation;
    }
    Ok(stated)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_weight_and_its_bias_share_a_stem_and_layers_do_not() {
        for (weight, bias) in [
            ("net.0.weight", "net.0.bias"),
            ("W1", "b1"),
            ("fc1_weight", "fc1_bias"),
            ("weights.0", "biases.0"),
            ("layers.3.kernel", "layers.3.bias"),
            ("coefs_.2", "intercepts_.2"),
        ] {
            assert_eq!(stem(weight), stem(bias), "{weight}");
        }
        assert_ne!(stem("net.0.weight"), stem("net.3.bias"));
        assert_ne!(stem("W1"), stem("b2"));
    }
}
