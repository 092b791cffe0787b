//! Finds the layers of a network among arrays with unknown names, by their shapes.

use super::names::tokens;
use super::normalisation;
use super::{Entry, EntryValue, Tensor};
use joulebus_predictor::{FeatureSet, HIDDEN};

/// A path and its array.
pub(super) type Named<'a> = (&'a str, &'a Tensor);

/// Maximum number of matrices among which layers are searched.
const MAX_MATRICES: usize = 64;
/// Maximum number of layers of a network that is described in an error.
const MAX_LAYERS: usize = 16;
/// Maximum number of steps of a search.
const MAX_STEPS: usize = 20_000;

/// The arrays of a network, first layer to last.
pub(super) struct Arrays<'a> {
    pub(super) feature_set: FeatureSet,
    pub(super) transposed: bool,
    pub(super) paired_by_name: bool,
    pub(super) weights: Vec<Named<'a>>,
    pub(super) biases: Vec<Named<'a>>,
}

/// The network of a part of the file: the longest chain of matrices from the features to one
/// output. Every matrix of such a shape and every vector of such a length must belong to it.
/// `in_order` states that the file's order is that of the layers.
pub(super) fn arrays_in<'a>(
    entries: &'a [Entry],
    part: &str,
    in_order: bool,
) -> Option<Arrays<'a>> {
    let tensors = tensors_in(entries, part);
    // Another program's definition of the reading age cannot be determined from numbers.
    let mut best: Option<Arrays<'a>> = None;
    for feature_set in [FeatureSet::Full, FeatureSet::PowerOnly] {
        for transposed in [false, true] {
            let groups = groups(&tensors, transposed, in_order);
            let limit = |hidden: usize| HIDDEN.get(hidden).copied();
            let inputs = feature_set.inputs();
            for chain in chains(&groups, inputs, limit).into_iter().rev() {
                if best.as_ref().is_some_and(|best| best.weights.len() >= chain.len()) {
                    break;
                }
                let weights = members(&groups, &chain);
                if let Some((biases, paired_by_name)) =
                    biases(&tensors, &weights, transposed, in_order)
                {
                    best =
                        Some(Arrays { feature_set, transposed, paired_by_name, weights, biases });
                }
            }
        }
    }
    best
}

/// Widths of the longest network of any size in the file, inputs first, to describe one that
/// cannot run.
pub(super) fn any_widths(entries: &[Entry]) -> Option<Vec<usize>> {
    let tensors = tensors_in(entries, "");
    let mut best: Option<Vec<usize>> = None;
    for transposed in [false, true] {
        let groups = groups(&tensors, transposed, true);
        for inputs in groups.iter().map(|group| group.inputs) {
            let any = |hidden: usize| (hidden + 1 < MAX_LAYERS).then_some(usize::MAX);
            let Some(chain) = chains(&groups, inputs, any).pop() else {
                continue;
            };
            let outputs = chain.iter().map(|group| groups[*group].outputs);
            let widths: Vec<usize> = std::iter::once(inputs).chain(outputs).collect();
            if best.as_ref().is_none_or(|best| best.len() < widths.len()) {
                best = Some(widths);
            }
        }
    }
    best
}

pub(super) fn within(path: &str, part: &str) -> bool {
    part.is_empty()
        || path == part
        || path.strip_prefix(part).is_some_and(|rest| rest.starts_with('.'))
}

fn tensors_in<'a>(entries: &'a [Entry], part: &str) -> Vec<Named<'a>> {
    entries
        .iter()
        .filter(|entry| within(&entry.path, part) && !normalisation::is_statistic(&entry.path))
        .filter_map(|entry| match &entry.value {
            EntryValue::Tensor(tensor) => Some((entry.path.as_str(), tensor)),
            _ => None,
        })
        .collect()
}

/// The matrices of one shape, in the order of their layers.
struct Group<'a> {
    inputs: usize,
    outputs: usize,
    members: Vec<Named<'a>>,
}

/// The matrices by shape. None if there are too many for one network.
fn groups<'a>(tensors: &[Named<'a>], transposed: bool, in_order: bool) -> Vec<Group<'a>> {
    let mut groups: Vec<Group<'a>> = Vec::new();
    for named in tensors {
        let (outputs, inputs) = match *named.1.shape() {
            [outputs, inputs] if !transposed => (outputs, inputs),
            [inputs, outputs] => (outputs, inputs),
            _ => continue,
        };
        let same = |group: &Group<'a>| (group.inputs, group.outputs) == (inputs, outputs);
        match groups.iter().position(same) {
            Some(at) => groups[at].members.push(*named),
            None if groups.len() == MAX_MATRICES => return Vec::new(),
            None => groups.push(Group { inputs, outputs, members: vec![*named] }),
        }
    }
    groups.retain_mut(|group| {
        group.members.len() < MAX_LAYERS && in_layer_order(&mut group.members, in_order)
    });
    groups
}

/// Sorts arrays of equal shape as their layers: by the numbers in their names, else by the order of
/// the file. Returns false if neither gives the order.
fn in_layer_order(members: &mut [Named<'_>], in_order: bool) -> bool {
    if members.len() < 2 {
        return true;
    }
    let split = |path: &str| -> (Vec<u64>, Vec<String>) {
        let mut numbers = Vec::new();
        let mut words = Vec::new();
        for token in tokens(path) {
            match token.parse() {
                Ok(number) => numbers.push(number),
                Err(_) => words.push(token),
            }
        }
        (numbers, words)
    };
    let mut keys: Vec<_> = members.iter().map(|member| split(member.0)).collect();
    let numbered = keys.iter().all(|key| key.1 == keys[0].1);
    keys.sort();
    keys.dedup();
    if numbered && keys.len() == members.len() {
        members.sort_by_key(|member| split(member.0).0);
        return true;
    }
    in_order
}

/// The chains of matrices from `inputs` to one output, as indices of groups, shortest first.
/// Every member of a group that is used must be used. `limit` is the greatest width of each hidden
/// layer, none beyond the last.
fn chains(
    groups: &[Group<'_>],
    inputs: usize,
    limit: impl Fn(usize) -> Option<usize>,
) -> Vec<Vec<usize>> {
    let mut complete = Vec::new();
    let mut open: Vec<Vec<usize>> = vec![Vec::new()];
    let mut steps = 0;
    while let Some(chain) = open.pop() {
        let width = chain.last().map_or(inputs, |last| groups[*last].outputs);
        for (at, group) in groups.iter().enumerate() {
            steps += 1;
            if steps > MAX_STEPS {
                return Vec::new();
            }
            let used = |of: usize, chain: &[usize]| chain.iter().filter(|one| **one == of).count();
            if group.inputs != width || used(at, &chain) == group.members.len() {
                continue;
            }
            let mut longer = chain.clone();
            longer.push(at);
            let is_whole = |of: &usize| used(*of, &longer) == groups[*of].members.len();
            if group.outputs == 1 && longer.len() > 1 && longer.iter().all(is_whole) {
                complete.push(longer.clone());
            }
            let is_allowed = limit(chain.len()).is_some_and(|limit| group.outputs <= limit);
            if is_allowed && group.outputs > 0 {
                open.push(longer);
            }
        }
    }
    complete.sort_by_key(Vec::len);
    complete
}

fn members<'a>(groups: &[Group<'a>], chain: &[usize]) -> Vec<Named<'a>> {
    let mut weights = Vec::with_capacity(chain.len());
    for (place, group) in chain.iter().enumerate() {
        let nth = chain[..place].iter().filter(|one| *one == group).count();
        weights.push(groups[*group].members[nth]);
    }
    weights
}

/// The bias of each layer, and whether they were assigned by name.
fn biases<'a>(
    tensors: &[Named<'a>],
    weights: &[Named<'a>],
    transposed: bool,
    in_order: bool,
) -> Option<(Vec<Named<'a>>, bool)> {
    let outputs_of = |weight: &Named<'a>| match *weight.1.shape() {
        [_, outputs] if transposed => outputs,
        [outputs, ..] => outputs,
        [] => 0,
    };
    let is_bias = |tensor: &Tensor, outputs: usize| match *tensor.shape() {
        [] => outputs == 1,
        [size] => size == outputs,
        [1, size] if transposed || size == 1 => size == outputs,
        [size, 1] if !transposed => size == outputs,
        _ => false,
    };
    let fitting = |outputs: usize| -> Vec<Named<'a>> {
        let free = |path: &str| weights.iter().all(|weight| weight.0 != path);
        let biases = tensors.iter().filter(|(path, tensor)| is_bias(tensor, outputs) && free(path));
        biases.copied().collect()
    };
    let layers_of = |outputs: usize| weights.iter().filter(|w| outputs_of(w) == outputs).count();
    let by_name = |weight: &Named<'a>| {
        let stem = stem(weight.0);
        let biases = fitting(outputs_of(weight));
        // Other vectors of this length, of a normalisation layer for example, would be left out.
        // A single number may be anything.
        if outputs_of(weight) > 1 && biases.len() != layers_of(outputs_of(weight)) {
            return None;
        }
        let mut same = biases.into_iter().filter(|(path, _)| self::stem(path) == stem);
        match (same.next(), same.next()) {
            (Some(only), None) => Some(only),
            _ => None,
        }
    };
    if let Some(biases) = weights.iter().map(by_name).collect() {
        return Some((biases, true));
    }
    let by_order = |place: usize| {
        let outputs = outputs_of(&weights[place]);
        let mut biases = fitting(outputs);
        if biases.len() != layers_of(outputs) || !in_layer_order(&mut biases, in_order) {
            return None;
        }
        let before = weights[..place].iter().filter(|w| outputs_of(w) == outputs);
        biases.get(before.count()).copied()
    };
    let biases: Option<Vec<Named<'a>>> = (0..weights.len()).map(by_order).collect();
    Some((biases?, false))
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

    #[test]
    fn layers_of_equal_shape_are_ordered_by_their_numbers_and_else_as_in_the_file() {
        let tensor: &'static Tensor = Box::leak(Box::new(Tensor::from_f32(vec![2, 2], &[0.0; 4])));
        let sorted = |paths: &[&'static str], in_order| -> Option<Vec<&'static str>> {
            let mut members: Vec<(&'static str, &'static Tensor)> =
                paths.iter().map(|path| (*path, tensor)).collect();
            let known = in_layer_order(&mut members, in_order);
            known.then(|| members.iter().map(|member| member.0).collect())
        };
        let numbered = ["net.10.weight", "net.3.weight"];
        assert_eq!(sorted(&numbered, false), Some(vec![numbered[1], numbered[0]]));
        let named = ["second.weight", "third.weight"];
        assert_eq!(sorted(&named, true), Some(named.to_vec()));
        assert_eq!(sorted(&named, false), None);
    }
}
