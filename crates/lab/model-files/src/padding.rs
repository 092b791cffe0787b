//! Smaller networks in the worker's size, with the same result.
//!
//! Missing units get zero weights in and out. Where hidden layers are missing, the output passes
//! through the others as a pair: f(z) − f(−z) = z for GELU in both forms and for relu.

use joulebus_predictor::{HIDDEN, Layer};

/// Two to four layers, the last with one output, as the worker's four. No layer is wider than
/// the worker's of the same place.
pub(super) fn padded(layers: &[Layer]) -> Option<[Layer; 4]> {
    let (last, hidden) = layers.split_last()?;
    let mut all: Vec<Layer> = Vec::with_capacity(HIDDEN.len() + 1);
    all.extend(hidden.iter().cloned());
    if let Some(missing) = HIDDEN.len().checked_sub(hidden.len()).filter(|missing| *missing > 0) {
        all.push(pair_of(last));
        all.extend(std::iter::repeat_n(pass(), missing - 1));
        all.push(Layer { weights: vec![1.0, -1.0], bias: vec![0.0] });
    } else {
        all.push(last.clone());
    }
    let [first, second, third, last] = <[Layer; 4]>::try_from(all).ok()?;
    let inputs = first.weights.len() / first.bias.len().max(1);
    let [one, two, three] = HIDDEN;
    Some([
        fill(&first, inputs, one)?,
        fill(&second, one, two)?,
        fill(&third, two, three)?,
        fill(&last, three, 1)?,
    ])
}

/// The output and its negative.
fn pair_of(last: &Layer) -> Layer {
    let negative = last.weights.iter().map(|weight| -weight);
    Layer {
        weights: last.weights.iter().copied().chain(negative).collect(),
        bias: last.bias.iter().flat_map(|bias| [*bias, -bias]).collect(),
    }
}

/// A pair, passed on.
fn pass() -> Layer {
    Layer { weights: vec![1.0, -1.0, -1.0, 1.0], bias: vec![0.0; 2] }
}

/// Pads a layer with zeros to this many inputs and outputs. `None` if it has more.
fn fill(layer: &Layer, inputs: usize, outputs: usize) -> Option<Layer> {
    let has = layer.weights.len() / layer.bias.len().max(1);
    if has == 0 || has > inputs || layer.bias.len() > outputs {
        return None;
    }
    let mut weights = Vec::with_capacity(inputs * outputs);
    for row in layer.weights.chunks(has) {
        weights.extend(row);
        weights.resize(weights.len() + inputs - has, 0.0);
    }
    weights.resize(inputs * outputs, 0.0);
    let mut bias = layer.bias.clone();
    bias.resize(outputs, 0.0);
    Some(Layer { weights, bias })
}
