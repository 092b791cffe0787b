//! Model files of other programs: refused with a place, or read, and what is found in them is a
//! network.

#[path = "../../crates/model-files/tests/wrapped/mod.rs"]
#[allow(dead_code)] // The tests put a pickle into files of other kinds as well.
pub(crate) mod wrapped;

use std::sync::OnceLock;

use joulebus_model_files::{Checkpoint, EntryValue, to_arrays, to_npz};
use joulebus_predictor::FeatureSet;

use super::oracle::world::random::network;

/// Values that are kept of a tensor.
const MOST_VALUES: usize = 1 << 16;

/// A file as it is.
pub(crate) fn whole(bytes: &[u8]) -> bool {
    let checkpoint = match Checkpoint::read(bytes) {
        Ok(checkpoint) => checkpoint,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            return false;
        }
    };
    for entry in &checkpoint.entries {
        if let EntryValue::Tensor(tensor) = &entry.value {
            let size: usize = tensor.shape().iter().product();
            let kept = if size > MOST_VALUES { 0 } else { size };
            assert_eq!(tensor.values().len(), kept, "{}", entry.path);
        }
    }
    if let Ok(found) = checkpoint.find(None) {
        let mut inputs = found.feature_set.inputs();
        for found in &found.layers {
            let outputs = found.layer.bias.len();
            assert_eq!(found.layer.weights.len(), inputs * outputs);
            let mut values = found.layer.weights.iter().chain(&found.layer.bias);
            assert!(
                values.all(|value| value.is_finite()),
                "{}",
                found.weight_path
            );
            inputs = outputs;
        }
        assert_eq!(inputs, 1);
    }
    if let Some(network) = &checkpoint.network {
        let written = to_npz(network).expect("what was read can be written");
        let again = Checkpoint::read(&written).expect("what was written can be read");
        let again = again.network.expect("the same model");
        assert_eq!(again.hash(), network.hash());
    }
    true
}

/// A pickle in a file of NumPy and, by the first byte's lowest bit, in one of PyTorch.
pub(crate) fn pickle(bytes: &[u8]) -> bool {
    let Some((kind, pickle)) = bytes.split_first() else {
        return false;
    };
    match kind % 4 {
        0 => whole(&wrapped::in_npy(pickle)),
        1 => whole(&wrapped::in_zip(pickle)),
        2 => whole(&wrapped::in_legacy(pickle)[0]),
        _ => whole(&wrapped::in_legacy(pickle)[1]),
    }
}

/// Names that members of archives are looked for by: those of our own arrays, then those of others.
fn names() -> &'static [String] {
    static NAMES: OnceLock<Vec<String>> = OnceLock::new();
    NAMES.get_or_init(|| {
        let network = network(1, FeatureSet::PowerOnly);
        let arrays = to_arrays(&network).expect("a network of ours can be written");
        let own = arrays.into_iter().map(|(name, _)| format!("{name}.npy"));
        let others = [
            "a/data.pkl",
            "a/byteorder",
            "a/version",
            "a/data/0",
            "a/data/1",
            "a/constants.pkl",
            "arr_0.npy",
            "layer.weight.npy",
            "",
        ];
        own.chain(others.map(str::to_owned)).collect()
    })
}

/// An archive of members, whose checksums fit: number of the name, length, bytes.
pub(crate) fn archive(bytes: &[u8]) -> bool {
    whole(&wrapped::zipped(&members(bytes)))
}

fn members(mut bytes: &[u8]) -> Vec<(&'static str, &[u8])> {
    let mut members = Vec::new();
    while let [name, low, high, rest @ ..] = bytes {
        let length = usize::from(u16::from_le_bytes([*low, *high]));
        let (member, rest) = rest.split_at(length.min(rest.len()));
        let name = names()[usize::from(*name) % names().len()].as_str();
        // An archive's writer refuses to have two of a name.
        if !members.iter().any(|(known, _)| *known == name) {
            members.push((name, member));
        }
        bytes = rest;
    }
    members
}

/// An input of [`archive`].
pub(crate) fn packed(members: &[(&str, &[u8])]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for (name, member) in members {
        let number = names().iter().position(|known| known == name);
        bytes.push(number.expect("a name of the list") as u8);
        bytes.extend((member.len() as u16).to_le_bytes());
        bytes.extend(*member);
    }
    bytes
}
