//! Bags of rosbag2: one file, or a folder with the files of a bag that was split.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{Read as _, Seek as _};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, anyhow, bail};
use joulebus_capture_format::import::{Imported, Mapping, import_files};
use joulebus_capture_format::scan::Scan;
use joulebus_dataset::trial::is_capture;
use joulebus_files::{ends_in, without_ending};

/// Maximum size of `metadata.yaml`, bytes. It has some hundred a topic.
const MAX_METADATA_BYTES: u64 = 16 << 20;
/// Refusal of a file that rosbag2 wrote as SQLite.
const OF_SQLITE: &str = "a bag of SQLite. Convert it with `ros2 bag convert` or \
    `rosbags-convert`, or read it with `joulebus.read_bag` in Python";

/// A bag that was read.
#[derive(Debug)]
pub(super) struct BagRead {
    pub(super) imported: Imported,
    /// Parts that were not read, with reasons.
    pub(super) left_out: Vec<String>,
}

/// True if it is read as a bag.
pub(super) fn is_bag(path: &Path) -> bool {
    path.is_dir() || ends_in(path, "db3") || (ends_in(path, "mcap") && !is_capture(path))
}

/// Reads a bag.
///
/// # Errors
/// Nothing of it can be read, or the mapping does not fit it.
pub(super) fn read(path: &Path, name: &str, mapping: &Mapping) -> anyhow::Result<BagRead> {
    let mut left_out = Vec::new();
    let paths = if path.is_dir() { files_of(path, &mut left_out)? } else { vec![path.to_owned()] };
    let mut files = Vec::new();
    for part in &paths {
        match open_mcap(part) {
            Ok(file) => files.push((part.display().to_string(), file)),
            // The other files are read.
            Err(error) if paths.len() > 1 => left_out.push(format!("{error:#}")),
            Err(error) => return Err(error),
        }
    }
    if files.is_empty() {
        bail!("no file of it can be read: {}", left_out.join("; "));
    }
    let imported = import_files(&mut files, name, mapping)?;
    Ok(BagRead { imported, left_out })
}

/// Opens a file that begins like MCAP.
fn open_mcap(path: &Path) -> anyhow::Result<File> {
    let named = || path.display().to_string();
    let mut file = joulebus_files::open(path).with_context(named)?;
    if ends_in(path, "db3") {
        return Err(anyhow!(OF_SQLITE)).with_context(named);
    }
    Scan::new(&mut file).with_context(named)?;
    file.rewind().with_context(named)?;
    Ok(file)
}

/// The files of a bag's folder.
fn files_of(folder: &Path, left_out: &mut Vec<String>) -> anyhow::Result<Vec<PathBuf>> {
    let named = || folder.display().to_string();
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).with_context(named)? {
        let path = entry.with_context(named)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if let Some(unpacked) = unpacked(&name) {
            // Beside it, it is read already.
            if !folder.join(unpacked).exists() {
                left_out.push(format!(
                    "{name}: is compressed. First `zstd -d {name}`, or read the bag with \
                     `joulebus.read_bag` in Python"
                ));
            }
        } else if ends_in(&path, "mcap") && is_capture(&path) {
            left_out.push(format!("{name}: is a capture of joulebus. Import it by its own name"));
        } else if ends_in(&path, "db3") || ends_in(&path, "mcap") {
            files.push(path);
        }
    }
    for listed in listed_files(folder) {
        // A compressed file is named above. Its uncompressed name is read.
        let own = unpacked(&listed).unwrap_or(&listed);
        let is_there = |name: &str| folder.join(name).exists();
        if !is_there(own) && !is_there(&format!("{own}.zstd")) {
            left_out.push(format!("{listed}: metadata.yaml lists it, and it is missing"));
        }
    }
    left_out.sort();
    files.sort();
    if files.is_empty() {
        let why = left_out.first().map_or_else(String::new, |why| format!(" ({why})"));
        bail!("{}: no .mcap file is in this folder{why}", named());
    }
    Ok(files)
}

/// The name of a compressed file of a bag when it is unpacked.
fn unpacked(name: &str) -> Option<&str> {
    let own = without_ending(name, "zstd")?;
    ["db3", "mcap"].iter().any(|ending| ends_in(Path::new(own), ending)).then_some(own)
}

/// The names under `relative_file_paths` of `metadata.yaml`, if there is one: a list of plain or
/// quoted names, as rosbag2 writes it.
fn listed_files(folder: &Path) -> Vec<String> {
    let mut text = String::new();
    let read = joulebus_files::open(&folder.join("metadata.yaml"))
        .and_then(|file| file.take(MAX_METADATA_BYTES).read_to_string(&mut text));
    if read.is_err() {
        return Vec::new();
    }
    let lines = text.lines().map(str::trim);
    let after = lines.skip_while(|line| *line != "relative_file_paths:");
    let names = after.skip(1).map_while(|line| line.strip_prefix("- "));
    let names = names.map(|name| name.trim().trim_matches(['"', '\'']));
    // Older ones name the folder as well.
    let own = names.filter_map(|name| Path::new(name).file_name().and_then(OsStr::to_str));
    own.map(str::to_owned).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_lists_the_files_of_a_bag() -> std::io::Result<()> {
        let folder = tempfile::tempdir()?;
        assert_eq!(listed_files(folder.path()), Vec::<String>::new());
        let text = "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n    - bag_0.db3\n    \
                    - \"other/bag_1.db3\"\n  duration:\n    - not_a_file\n";
        fs::write(folder.path().join("metadata.yaml"), text)?;
        assert_eq!(listed_files(folder.path()), ["bag_0.db3", "bag_1.db3"]);
        Ok(())
    }
}
