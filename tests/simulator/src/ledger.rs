//! The file of the fleet's ledger, as an operator finds it.

use std::path::{Path, PathBuf};

use joulebus_wire::fnv1a;
use serde::Deserialize;
use simulated_host::disk;

pub(crate) const LEDGER: &str = "/sim/ledger.json";

/// The head of a file.
#[derive(Deserialize)]
struct Head {
    schema: u32,
    generation: u64,
    fnv1a: String,
}

/// The newest generation with a whole file; 0 if there is none. `read` returns a file's bytes.
pub(crate) fn newest_whole(read: impl Fn(&Path) -> Option<Vec<u8>>) -> u64 {
    let names = ["", ".older", ".new"].map(|ending| PathBuf::from(format!("{LEDGER}{ending}")));
    let whole = names.iter().filter_map(|name| whole(&read(name)?));
    whole.max().unwrap_or(0)
}

/// The generation of a file, if its checksum is that of the text.
fn whole(bytes: &[u8]) -> Option<u64> {
    let text = std::str::from_utf8(bytes).ok()?;
    let (head, ledger) = text.strip_suffix('}')?.split_once(",\"ledger\":")?;
    let head: Head = serde_json::from_str(&format!("{head}}}")).ok()?;
    let summed = format!("[{},{},{ledger}]", head.schema, head.generation);
    (format!("{:016x}", fnv1a(summed.bytes())) == head.fnv1a).then_some(head.generation)
}

/// Changes a bit of the newest ledger.
pub(crate) fn damage(bits: u64) {
    let path = Path::new(LEDGER);
    if let Some(mut bytes) = disk::peek(path)
        && !bytes.is_empty()
        && has_another_generation(&bytes)
    {
        let place = bits as usize % bytes.len();
        bytes[place] ^= 1 << (bits >> 61);
        disk::put(path, bytes);
    }
}

/// True if the newest ledger is not the only one: about the only one an operator must be asked.
/// There is an earlier one, unless it was damaged too.
fn has_another_generation(newest: &[u8]) -> bool {
    let content = serde_json::from_slice::<serde_json::Value>(newest).unwrap_or_default();
    let is_first = content["generation"].as_u64().is_none_or(|number| number < 2);
    let is_aside = |path: &PathBuf| path.to_string_lossy().contains(".damaged-");
    let older = PathBuf::from(format!("{LEDGER}.older"));
    disk::peek(&older).is_some() || !(is_first || disk::names().iter().any(is_aside))
}
