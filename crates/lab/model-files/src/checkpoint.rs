//! The contents of a model file of any format.

use joulebus_files::foreign;
use sha2::{Digest as _, Sha256};

use super::entry::{Container, Entry};
use super::error::{MAX_FILE_BYTES, ReadError};
use super::{archive, entries, onnx, own, state_dict, torch};
use joulebus_predictor::{ModelError, Network};

/// Contents of a model file.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    /// Format of the file.
    pub container: Container,
    /// Its entries, in the file's order.
    pub entries: Vec<Entry>,
    /// SHA-256 of the file, hexadecimal.
    pub sha256: String,
    /// The model, if the file is a joulebus model: as safetensors, arrays or ONNX.
    pub network: Option<Network>,
}

impl Checkpoint {
    /// Reads a file of any format, detected from its first bytes. Executes nothing, allocates
    /// nothing for sizes that the file merely claims, and never panics.
    ///
    /// # Errors
    /// [`ReadError`] with the location, what was found and what is allowed.
    pub fn read(bytes: &[u8]) -> Result<Checkpoint, ReadError> {
        let found = bytes.len();
        if found > MAX_FILE_BYTES {
            return Err(ReadError::TooLarge { found });
        }
        if bytes.starts_with(joulebus_dataset::npy::MAGIC) {
            return checkpoint(Container::Npy, bytes, entries::of_npy(bytes)?);
        }
        if bytes.starts_with(archive::MAGIC) {
            // A damaged archive is reported as the format that it had.
            let is_torch = bytes.windows(8).any(|window| window == b"data.pkl");
            let container = if is_torch { Container::TorchZip } else { Container::Npz };
            let members = archive::read(container, bytes)?;
            if let Some(found) = archive::foreign(&members) {
                return Err(ReadError::Kind { found });
            }
            return if torch::is_torch(&members) {
                checkpoint(container, bytes, torch::read_zip(&members)?)
            } else {
                let arrays = members.iter().map(|member| (&*member.name, &*member.bytes));
                let entries = entries::of_arrays(Container::Npz, arrays)?;
                checkpoint(Container::Npz, bytes, entries)
            };
        }
        if torch::is_legacy(bytes) {
            return checkpoint(Container::TorchLegacy, bytes, torch::read_legacy(bytes)?);
        }
        if own::is_safetensors(bytes) {
            return match own::is_foreign(bytes) {
                true => checkpoint(Container::StateDict, bytes, state_dict::entries(bytes)?),
                false => own_file(bytes),
            };
        }
        if let Some(network) = onnx::read(bytes) {
            let network = network?;
            return Ok(Checkpoint {
                container: Container::Onnx,
                entries: own::entries(&network),
                sha256: hex(&Sha256::digest(bytes)),
                network: Some(network),
            });
        }
        if bytes.starts_with(&[0x80]) {
            return checkpoint(Container::Pickle, bytes, entries::of_bare_pickle(bytes)?);
        }
        let head = bytes.get(..bytes.len().min(8)).unwrap_or_default();
        let found = match foreign::recognise(bytes) {
            _ if bytes.is_empty() => "the file is empty".to_owned(),
            Some(foreign) => format!("found {}", foreign.of_any_contents()),
            None => format!("found a file that begins with the bytes {head:02x?}"),
        };
        Err(ReadError::Kind { found })
    }

    /// The arrays of a directory: names without `.npy` and the bytes of each file.
    ///
    /// # Errors
    /// As [`Checkpoint::read`].
    pub fn from_arrays(arrays: &[(String, Vec<u8>)]) -> Result<Checkpoint, ReadError> {
        let found = arrays.iter().map(|(_, bytes)| bytes.len()).sum();
        if found > MAX_FILE_BYTES {
            return Err(ReadError::TooLarge { found });
        }
        let mut all = Vec::new();
        for (name, bytes) in arrays {
            all.extend(name.bytes());
            all.extend(bytes);
        }
        let arrays = arrays.iter().map(|(name, bytes)| (&**name, &**bytes));
        let entries = entries::of_arrays(Container::Arrays, arrays)?;
        checkpoint(Container::Arrays, &all, entries)
    }
}

fn checkpoint(
    container: Container,
    bytes: &[u8],
    entries: Vec<Entry>,
) -> Result<Checkpoint, ReadError> {
    let network = own::from_arrays(container, &entries)?;
    Ok(Checkpoint { container, network, entries, sha256: hex(&Sha256::digest(bytes)) })
}

fn own_file(bytes: &[u8]) -> Result<Checkpoint, ReadError> {
    let container = Container::Safetensors;
    let network = Network::from_safetensors(bytes).map_err(|error| match error {
        ModelError::Container(error) => ReadError::Part {
            container,
            part: format!("header, bytes 0 to {}", own::header_end(bytes)),
            detail: error.to_string(),
        },
        error => ReadError::Model(error),
    })?;
    Ok(Checkpoint {
        container,
        entries: own::entries(&network),
        sha256: hex(&Sha256::digest(bytes)),
        network: Some(network),
    })
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
