//! Model files: refused, or read, written and read again without a changed bit, with the same
//! forecasts on every kernel.
//!
//! After a first byte of 0 an input is a file as it is. After any other it is the file's header (a
//! text up to a zero byte) and weights, which are repeated as often as the header needs; the file
//! gets a digest that fits it, as a careful forger would give it.

#[path = "../../crates/predictor/tests/forged/mod.rs"]
mod forged;

use joulebus_predictor::{Features, Kernel, Network, Tiling};
use safetensors::SafeTensors;

/// More weights than a header of ours can need.
const MOST_DATA_BYTES: usize = 64 << 10;
const ROWS: usize = 21;

pub(crate) fn run(bytes: &[u8]) -> bool {
    let Some((kind, bytes)) = bytes.split_first() else {
        return false;
    };
    if *kind == 0 {
        return read(bytes);
    }
    let Some(whole) = grown(bytes) else {
        return false;
    };
    if SafeTensors::deserialize(&whole).is_err() {
        return read(&whole);
    }
    let (metadata, tensors) = forged::contents(&whole);
    read(&forged::forged(&metadata, &tensors))
}

/// The file of a header and the beginning of its weights; none where the header is no text of a map.
fn grown(bytes: &[u8]) -> Option<Vec<u8>> {
    let end = bytes.iter().position(|byte| *byte == 0)?;
    let (header, data) = (&bytes[..end], &bytes[end + 1..]);
    let map: serde_json::Map<String, serde_json::Value> = serde_json::from_slice(header).ok()?;
    map.get("__metadata__")?.as_object()?;
    let ends = map
        .values()
        .filter_map(|entry| entry["data_offsets"][1].as_u64());
    let wanted = usize::try_from(ends.max().unwrap_or(0)).ok()?;
    let data = data.iter().cycle().take(wanted.min(MOST_DATA_BYTES));
    let length = (header.len() as u64).to_le_bytes();
    Some(length.iter().chain(header).chain(data).copied().collect())
}

fn read(bytes: &[u8]) -> bool {
    let network = match Network::from_safetensors(bytes) {
        Ok(network) => network,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            return false;
        }
    };
    let written = network
        .to_safetensors()
        .expect("what was read can be written");
    let again = Network::from_safetensors(&written).expect("what was written can be read");
    assert_eq!(again.parameters(), network.parameters());
    assert_eq!(again.card(), network.card());
    assert_eq!(again.hash(), network.hash());
    assert_eq!(again.to_safetensors().expect("valid"), written);
    same_forecasts(&network);
    true
}

/// Rows around the training's means, far from them, and of no numbers.
fn rows(network: &Network) -> [Features; ROWS] {
    let normalisation = network.parameters().normalisation;
    std::array::from_fn(|row| {
        std::array::from_fn(|feature| {
            let distance = (row * 7 + feature * 3) as f32 % 9.0 - 4.0;
            match row {
                0 => f32::MAX,
                1 => f32::NAN,
                _ => {
                    normalisation.feature_mean[feature]
                        + distance * normalisation.feature_std[feature]
                }
            }
        })
    })
}

fn same_forecasts(network: &Network) {
    let rows = rows(network);
    let expected = rows.map(|row| network.predict_reference_f32(&row).to_bits());
    for kernel in Kernel::ALL {
        for tiling in [Tiling::ByInput, Tiling::BatchMajor, Tiling::OutputMajor] {
            let Some(network) = network.clone().with_kernel(kernel) else {
                continue;
            };
            let mut found_w = [0.0; ROWS];
            network.with_tiling(tiling).predict(&rows, &mut found_w);
            assert_eq!(found_w.map(f32::to_bits), expected, "{kernel:?} {tiling:?}");
        }
    }
}
