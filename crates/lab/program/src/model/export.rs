//! `joulebus model export`: exports a model for other programs.

use std::fmt;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use joulebus_model_files::{to_npz, to_onnx, to_python};
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::Output;
use serde::Serialize;

use joulebus_program::file::write;
use joulebus_program::model_source;

/// Export a model for Python, NumPy, PyTorch or any ONNX runtime
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus model export my.safetensors --out my.onnx\n  \
    joulebus model export my.safetensors --out my.npz\n  \
    joulebus model export my.safetensors --out predictor.py\n\n\
    ONNX: opset 17, input `features` (n, 11) in SI units as `model info` lists them, output \
    `power_w` (n, 1). The normalisation is part of the graph. Arrays carry `check_features` and \
    `check_power_w`, \
    rows with their forecasts, for testing a reimplementation of the network. Python: one file that needs \
    NumPy only, with the model inside and the paper's `EnergyPredictor`: `reset`, `step(v_cmd, w_cmd)`, \
    `step_with_correction(v_cmd, w_cmd, measured_power)`, in mW.")]
pub(crate) struct Args {
    /// A joulebus model (.safetensors), or builtin:NAME
    #[arg(value_name = "MODEL")]
    model: PathBuf,
    /// The output file
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Format of the file [default: by the extension of --out]
    #[arg(long, value_enum, value_name = "KIND")]
    to: Option<ExportFormat>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum ExportFormat {
    /// A joulebus model file
    Safetensors,
    /// An archive of NumPy arrays
    Npz,
    /// An ONNX graph
    Onnx,
    /// A Python module that needs NumPy only
    Python,
}

pub(super) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let out = &args.out;
    let kind = args.to.map_or_else(|| by_ending(out), Ok)?;
    let network = model_source::load(&args.model)?;
    let bytes = match kind {
        ExportFormat::Safetensors => network.to_safetensors()?,
        ExportFormat::Npz => to_npz(&network)?,
        ExportFormat::Onnx => to_onnx(&network)?,
        ExportFormat::Python => to_python(&network)?.into_bytes(),
    };
    write(out, &bytes)?;
    output.report(&ExportReport {
        file: out.display().to_string(),
        kind,
        model: network.card().name.clone(),
        model_hash: format!("{:016x}", network.hash()),
        bytes: bytes.len(),
    })?;
    Ok(Outcome::Done)
}

fn by_ending(out: &Path) -> Result<ExportFormat, UsageError> {
    let ending = out.extension().and_then(|ending| ending.to_str()).map(str::to_ascii_lowercase);
    match ending.as_deref() {
        Some("safetensors") => Ok(ExportFormat::Safetensors),
        Some("npz") => Ok(ExportFormat::Npz),
        Some("onnx") => Ok(ExportFormat::Onnx),
        Some("py") => Ok(ExportFormat::Python),
        _ => {
            let out = out.display();
            let what = format!("{out} does not end in .onnx, .npz, .py or .safetensors");
            Err(UsageError(format!("{what}. Name the format: --to FORMAT")))
        }
    }
}

#[derive(Debug, Serialize)]
struct ExportReport {
    file: String,
    kind: ExportFormat,
    model: String,
    model_hash: String,
    bytes: usize,
}

impl fmt::Display for ExportReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { file, model, model_hash, bytes, .. } = self;
        writeln!(out, "{file}: {model}, hash {model_hash}, {bytes} bytes")
    }
}
