//! Model files with arbitrary contents and a matching digest.

use safetensors::SafeTensors;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;

/// Metadata, and each tensor's name, shape and bytes.
pub type Contents = (BTreeMap<String, String>, Vec<(String, Vec<usize>, Vec<u8>)>);

/// A file with the given contents and a matching digest.
pub fn forged(
    metadata: &BTreeMap<String, String>,
    tensors: &[(String, Vec<usize>, Vec<u8>)],
) -> Vec<u8> {
    let mut digest = Sha256::new();
    let mut add = |bytes: &[u8]| {
        digest.update((bytes.len() as u64).to_le_bytes());
        digest.update(bytes);
    };
    for (key, value) in metadata {
        add(key.as_bytes());
        add(value.as_bytes());
    }
    let mut header = serde_json::Map::new();
    let mut data = Vec::new();
    for (name, shape, values) in tensors {
        add(name.as_bytes());
        add(&shape.iter().flat_map(|&n| (n as u64).to_le_bytes()).collect::<Vec<u8>>());
        add(values);
        let offsets = [data.len(), data.len() + values.len()];
        data.extend_from_slice(values);
        let entry = serde_json::json!({"dtype": "F32", "shape": shape, "data_offsets": offsets});
        header.insert(name.clone(), entry);
    }
    let mut metadata = metadata.clone();
    let sha256 = digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    metadata.insert("sha256".to_owned(), sha256);
    header.insert("__metadata__".to_owned(), serde_json::json!(metadata));
    let header = serde_json::Value::Object(header).to_string().into_bytes();
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend(header);
    bytes.extend(data);
    bytes
}

/// Contents of a file of ours, without its digest.
///
/// # Panics
/// The bytes are no file of ours.
pub fn contents(bytes: &[u8]) -> Contents {
    let (_, header) = SafeTensors::read_metadata(bytes).expect("own files are safetensors");
    let metadata = header.metadata().clone().expect("own files have metadata").into_iter();
    let file = SafeTensors::deserialize(bytes).expect("own files are safetensors");
    let mut tensors: Vec<_> = file
        .iter()
        .map(|(name, view)| (name.to_owned(), view.shape().to_vec(), view.data().to_vec()))
        .collect();
    tensors.sort();
    (metadata.filter(|(key, _)| key != "sha256").collect(), tensors)
}
