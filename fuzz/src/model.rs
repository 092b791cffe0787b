//! Model files: refused, or read, written and read again bit for bit, with the same forecasts on
//! every kernel.
//!
//! If an input's first byte is 0, the rest is the file. Otherwise the rest is the file's header
//! (text up to a zero byte) and weights, repeated up to the size in the header; the file gets a
//! valid digest, so that mutations pass that check. If it is 2, the file is a plain network of another
//! program, which has no digest.

use joulebus_model_files::Plain;
use joulebus_predictor::{Features, Kernel, Network, Tiling};
use joulebus_testkit_fleets::forged;
use safetensors::SafeTensors;

/// More weights than any header of ours describes.
const MAX_DATA_BYTES: usize = 64 << 10;
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
    if *kind == 2 {
        return plain(&whole);
    }
    if SafeTensors::deserialize(&whole).is_err() {
        return read(&whole);
    }
    let (metadata, tensors) = forged::contents(&whole);
    read(&forged::forged(&metadata, &tensors))
}

/// The file of a header and the beginning of its weights; `None` if the header is no JSON object.
fn grown(bytes: &[u8]) -> Option<Vec<u8>> {
    let end = bytes.iter().position(|byte| *byte == 0)?;
    let (header, data) = (&bytes[..end], &bytes[end + 1..]);
    let map: serde_json::Map<String, serde_json::Value> = serde_json::from_slice(header).ok()?;
    map.get("__metadata__")?.as_object()?;
    let ends = map.values().filter_map(|entry| entry["data_offsets"][1].as_u64());
    let wanted = usize::try_from(ends.max().unwrap_or(0)).ok()?;
    let data = data.iter().cycle().take(wanted.min(MAX_DATA_BYTES));
    let length = (header.len() as u64).to_le_bytes();
    Some(length.iter().chain(header).chain(data).copied().collect())
}

fn plain(bytes: &[u8]) -> bool {
    match Plain::read(bytes) {
        Ok(plain) => {
            let widths = plain.widths();
            assert!([5, 11].contains(&widths[0]) && widths.ends_with(&[1]), "{widths:?}");
            assert!((3..=5).contains(&widths.len()), "{widths:?}");
            true
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            false
        }
    }
}

fn read(bytes: &[u8]) -> bool {
    let network = match Network::from_safetensors(bytes) {
        Ok(network) => network,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            return false;
        }
    };
    let written = network.to_safetensors().expect("what was read can be written");
    let again = Network::from_safetensors(&written).expect("what was written can be read");
    assert_eq!(again.parameters(), network.parameters());
    assert_eq!(again.card(), network.card());
    assert_eq!(again.hash(), network.hash());
    assert_eq!(again.to_safetensors().expect("valid"), written);
    same_forecasts(&network);
    true
}

/// Rows near the training means, far from them, and of NaN.
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
