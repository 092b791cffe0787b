//! Every truncation and every flipped byte of a file of each format is either an error that names
//! the location, or a model that passes all checks and has another hash — never a panic, never an
//! allocation by a claimed size.

use crate::fixture::fixture;
use joulebus_model_files::{Checkpoint, Entry, EntryValue, Found, to_npz};
use joulebus_predictor::Network;
use joulebus_testkit::counting;
use sha2::{Digest as _, Sha256};

/// Maximum total allocation for a file of some 30 kB, counting vectors each time they grow: its
/// numbers as f64 are 56 kB, and there are a few copies.
const MAX_BYTES: u64 = 4 << 20;

/// Result of reading a file.
#[derive(Debug, PartialEq, Eq)]
enum Outcome {
    Refused,
    /// The original model, from a file that differs in unused bytes.
    Same,
    /// Another model, or other numbers.
    Other,
}

/// Digest of everything that determines a forecast.
fn digest(found: &Found) -> Vec<u8> {
    let mut digest = Sha256::new();
    for found in &found.layers {
        for value in found.layer.weights.iter().chain(&found.layer.bias) {
            digest.update(value.to_le_bytes());
        }
    }
    digest.update(format!("{:?}", found.normalisation));
    digest.finalize().to_vec()
}

/// Reads a file as an import does.
fn read(bytes: &[u8]) -> Result<Vec<u8>, String> {
    let file = Checkpoint::read(bytes).map_err(|error| error.to_string())?;
    match file.network {
        Some(network) => Ok(network.hash().to_le_bytes().to_vec()),
        None => {
            file.find(None, None).map(|found| digest(&found)).map_err(|error| error.to_string())
        }
    }
}

fn outcome(bytes: &[u8], whole: &[u8], what: impl Fn() -> String) -> Outcome {
    let before = counting::bytes();
    let read = read(bytes);
    let allocated = counting::bytes() - before;
    assert!(allocated < MAX_BYTES, "{}: {allocated} bytes allocated", what());
    match read {
        Ok(read) if read == whole => Outcome::Same,
        Ok(_) => Outcome::Other,
        Err(error) => {
            // A location or a name is required in each message.
            let is_place = |c: char| c.is_ascii_digit() || c == '"' || c == '`';
            let names = error.contains(is_place) || bytes.is_empty();
            assert!(names, "{}: {error}", what());
            Outcome::Refused
        }
    }
}

/// The files, each with whether it has checksums of its numbers.
fn files() -> Vec<(&'static str, Vec<u8>, bool)> {
    let path =
        concat!(env!("CARGO_MANIFEST_DIR"), "/../../../configs/models/gternal-sim.safetensors");
    let own = std::fs::read(path).unwrap();
    let exported = to_npz(&Network::from_safetensors(&own).unwrap()).unwrap();
    vec![
        ("flat.npy", fixture("flat.npy"), false),
        ("state_dict.pt", fixture("state_dict.pt"), true),
        ("state_dict_legacy.pt", fixture("state_dict_legacy.pt"), false),
        ("compressed.npz", fixture("compressed.npz"), true),
        ("exported.npz", exported, true),
        ("gternal-sim.safetensors", own, true),
    ]
}

/// The bytes to flip: all outside of large arrays, and every 13th within; all of them with
/// `JOULEBUS_EVERY_BYTE`.
fn places(bytes: &[u8]) -> impl Iterator<Item = usize> {
    let every: usize = std::env::var("JOULEBUS_EVERY_BYTE").map_or(13, |_| 1);
    let structure = structure(bytes);
    (0..bytes.len()).filter(move |at| structure[*at] || at % every == 0)
}

/// Marks the bytes that are not floats: names, headers, opcodes, directories.
fn structure(bytes: &[u8]) -> Vec<bool> {
    let mut structure = vec![false; bytes.len()];
    let is_word = |window: &[u8]| window.iter().all(u8::is_ascii_graphic);
    let words = bytes.windows(4).enumerate().filter(|(_, window)| is_word(window));
    let mut mark = |from: usize, to: usize| {
        let to = to.min(bytes.len());
        structure[from.min(to)..to].fill(true);
    };
    mark(0, 512);
    mark(bytes.len().saturating_sub(1024), bytes.len());
    for (at, _) in words {
        mark(at.saturating_sub(24), at + 32);
    }
    structure
}

#[test]
fn every_truncation_is_an_error_with_its_location() {
    for (name, bytes, _) in files() {
        let whole = read(&bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
        for length in 0..bytes.len() {
            let cut = outcome(&bytes[..length], &whole, || format!("{name}, {length} bytes"));
            assert_eq!(cut, Outcome::Refused, "{name}, {length} bytes");
        }
        println!("figure: {name}: {} truncations, all refused, 0 panics", bytes.len());
    }
}

#[test]
fn every_flipped_byte_is_an_error_with_its_location_or_changes_the_hash() {
    for (name, mut bytes, has_checksums) in files() {
        let whole = read(&bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
        let (mut refused, mut same, mut other) = (0, 0, 0);
        for at in places(&bytes.clone()) {
            for mask in [0xff, 1 << (at % 8)] {
                bytes[at] ^= mask;
                match outcome(&bytes, &whole, || format!("{name}, byte {at}, mask {mask:#x}")) {
                    Outcome::Refused => refused += 1,
                    Outcome::Same => same += 1,
                    Outcome::Other => other += 1,
                }
                bytes[at] ^= mask;
            }
        }
        // Checksums detect every changed number. Changed names may still change which network is
        // found.
        assert!(!has_checksums || name.ends_with("npz") || other == 0, "{name}: {other} differ");
        assert!(refused > 0, "{name}");
        println!(
            "figure: {name}: flipped bytes: {refused} refused, {same} without effect, {other} change the hash, 0 panics"
        );
    }
}

#[test]
fn a_flipped_bit_in_any_number_of_a_file_without_checksums_changes_the_hash() {
    for name in ["flat.npy", "state_dict_legacy.pt"] {
        let bytes = fixture(name);
        let whole = read(&bytes).unwrap();
        let numbers = numbers(&Checkpoint::read(&bytes).unwrap().entries);
        let mut seen = 0;
        for at in (0..bytes.len()).step_by(29) {
            let mut flipped = bytes.clone();
            flipped[at] ^= 0x10;
            let Ok(file) = Checkpoint::read(&flipped) else {
                continue;
            };
            if self::numbers(&file.entries) != numbers {
                seen += 1;
                let hash = read(&flipped);
                assert!(hash.as_ref() != Ok(&whole), "{name}, byte {at}");
            }
        }
        assert!(seen > 500, "{name}: {seen}");
    }
}

/// The numbers of all arrays, as bits.
fn numbers(entries: &[Entry]) -> Vec<u64> {
    let mut numbers = Vec::new();
    for entry in entries {
        if let EntryValue::Tensor(tensor) = &entry.value {
            numbers.extend(tensor.values().iter().map(|value| value.to_bits()));
        }
    }
    numbers
}
