//! Model files of other programs: refused with the position of the fault, or read as a valid
//! network.

#[path = "../../crates/lab/model-files/tests/all/wrapped.rs"]
#[allow(dead_code)] // The tests also embed pickles in other formats.
pub(crate) mod wrapped;

use std::sync::OnceLock;

use joulebus_model_files::{Checkpoint, EntryValue, to_arrays, to_npz};
use joulebus_predictor::FeatureSet;
use joulebus_testkit_networks::random::network;

/// Maximum number of values read of a tensor.
const MAX_VALUES: usize = 1 << 16;

/// The input is the file.
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
            let kept = if size > MAX_VALUES { 0 } else { size };
            assert_eq!(tensor.values().len(), kept, "{}", entry.path);
        }
    }
    if let Ok(found) = checkpoint.find(None, None) {
        let mut inputs = found.feature_set.inputs();
        for found in &found.layers {
            let outputs = found.layer.bias.len();
            assert_eq!(found.layer.weights.len(), inputs * outputs);
            let mut values = found.layer.weights.iter().chain(&found.layer.bias);
            assert!(values.all(|value| value.is_finite()), "{}", found.weight_path);
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

/// A pickle inside a NumPy file, or inside a PyTorch file if bit 0 of the first byte is set.
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

/// Names of archive members that readers look for: first of our own arrays, then of others.
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

/// An archive with valid checksums; each member is: number of its name, length, bytes.
pub(crate) fn archive(bytes: &[u8]) -> bool {
    whole(&wrapped::zipped(&members(bytes)))
}

fn members(mut bytes: &[u8]) -> Vec<(&'static str, &[u8])> {
    let mut members = Vec::new();
    while let [name, low, high, rest @ ..] = bytes {
        let length = usize::from(u16::from_le_bytes([*low, *high]));
        let (member, rest) = rest.split_at(length.min(rest.len()));
        let name = names()[usize::from(*name) % names().len()].as_str();
        // The archive writer refuses duplicate names.
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
