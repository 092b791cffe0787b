//! `joulebus model`: model files of this and of other programs.

mod compare;
mod export;
mod import;
mod info;

use std::path::Path;

use anyhow::Context as _;
use clap::Subcommand;
use joulebus_files::without_ending;
use joulebus_model_files::{Checkpoint, MAX_FILE_BYTES};
use joulebus_predictor::Activation;
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;

/// Inspect, import, export and compare model files
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus model info configs/models/gternal-sim.safetensors\n  \
    joulebus model import energy_predictor_full.npy --data recordings/ --out published.safetensors\n  \
    joulebus model export published.safetensors --out published.onnx\n  \
    joulebus model compare old.safetensors new.safetensors recordings/\n\n\
    Reads .npy (arrays and objects), .npz, .pt and .pth (zip and legacy), .safetensors and \
    directories of .npy. No code in a file is executed.")]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    Info(info::Args),
    Import(import::Args),
    Export(export::Args),
    Compare(compare::Args),
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    match &args.verb {
        Verb::Info(args) => info::run(args, output),
        Verb::Import(args) => import::run(args, output),
        Verb::Export(args) => export::run(args, output),
        Verb::Compare(args) => compare::run(args, output),
    }
}

/// An activation by name.
fn activation(name: &str) -> Result<Activation, String> {
    Activation::from_name(name).ok_or_else(|| format!("allowed: {}", Activation::NAMES))
}

/// Reads a model file of any format, or a directory of arrays.
fn read(path: &Path) -> anyhow::Result<Checkpoint> {
    let name = || format!("{}", path.display());
    if path.is_dir() {
        return Checkpoint::from_arrays(&arrays(path)?).with_context(name);
    }
    Checkpoint::read(&bytes(path)?).with_context(name)
}

/// The file's bytes, or those of `builtin:NAME`.
fn bytes(path: &Path) -> anyhow::Result<Vec<u8>> {
    if let Some(name) = path.to_str().and_then(|path| path.strip_prefix("builtin:")) {
        let known = || joulebus_config::builtin_models().collect::<Vec<_>>().join(", ");
        return joulebus_config::builtin_model(name)
            .map(|(_, bytes)| bytes.to_vec())
            .with_context(|| format!("there is no built-in model {name}, there are {}", known()));
    }
    joulebus_files::read(path, MAX_FILE_BYTES as u64)
        .with_context(|| format!("cannot read {}", path.display()))
}

/// The arrays in a directory, by name.
fn arrays(folder: &Path) -> anyhow::Result<Vec<(String, Vec<u8>)>> {
    let failed = || format!("cannot read the directory {}", folder.display());
    let mut arrays = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(failed)? {
        let path = entry.with_context(failed)?.path();
        let name = path.file_name().and_then(|name| name.to_str());
        if let Some(name) = name.and_then(|name| without_ending(name, "npy")) {
            arrays.push((name.to_owned(), bytes(&path)?));
        }
    }
    anyhow::ensure!(!arrays.is_empty(), "{} holds no .npy files", folder.display());
    arrays.sort();
    Ok(arrays)
}
