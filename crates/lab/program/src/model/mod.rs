//! `joulebus model`: model files.

mod compare;
mod export;
mod import;
mod info;

use clap::Subcommand;
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;

/// Inspect, import, export and compare model files
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus model info configs/models/gternal-sim.safetensors\n  \
    joulebus model import plain.safetensors --data recordings/ --out mine.safetensors\n  \
    joulebus model export mine.safetensors --out mine.onnx\n  \
    joulebus model compare old.safetensors new.safetensors recordings/\n\n\
    Networks of PyTorch, ONNX and NumPy are converted by `joulebus.models.convert` of the Python \
    package, and then imported.")]
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
