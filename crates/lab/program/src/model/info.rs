//! `joulebus model info`: contents of a model file.

use std::fmt;
use std::path::PathBuf;

use joulebus_model_files::{ActivationFrom, Checkpoint, Entry, EntryValue, Found, StatisticsFrom};
use joulebus_predictor::{Activation, FEATURE_NAMES, Network};
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;
use serde::Serialize;

/// Maximum number of entries shown as text. JSON has all.
const MAX_SHOWN: usize = 40;

/// Show the contents of a model file: layers, features, normalisation, training range, hash, scores
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus model info builtin:husky\n  \
    joulebus model info energy_predictor_full.pt --format json\n\n\
    For a file of another program it shows the contents, and where it found a network. Exit code \
    1: there is no network.")]
pub(crate) struct Args {
    /// A model file of any format, a directory of .npy files, or builtin:NAME
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// The part of the file with the network, if there are several
    #[arg(long, value_name = "PATH")]
    part: Option<String>,
    /// Activation of the hidden layers of another program's network, whatever the file states
    #[arg(long, value_name = "NAME", value_parser = super::activation)]
    activation: Option<Activation>,
}

pub(super) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let checkpoint = super::read(&args.file)?;
    let file = args.file.display().to_string();
    if let Some(network) = &checkpoint.network {
        let kind = checkpoint.container.to_string();
        output.report(&OwnReport::new(file, kind, &checkpoint.sha256, network))?;
        return Ok(Outcome::Done);
    }
    let report = ForeignReport::new(file, &checkpoint, args);
    output.report(&report)?;
    Ok(if report.problem.is_none() { Outcome::Done } else { Outcome::Failed })
}

/// A joulebus model.
#[derive(Debug, Serialize)]
struct OwnReport {
    file: String,
    kind: String,
    file_sha256: String,
    model: String,
    /// Identifies the contents.
    model_hash: String,
    source: String,
    training_data: String,
    training_data_sha256: String,
    /// Rows that it was trained on and that are recognised. None if its file does not state them.
    trained_rows: Option<u64>,
    /// Time between two steps at which it forecasts, s, if it is known.
    period_s: Option<f32>,
    seed: u64,
    feature_set: &'static str,
    activation: &'static str,
    parameters: usize,
    layers: Vec<LayerReport>,
    features: Vec<FeatureReport>,
    power_mean_w: f32,
    power_std_w: f32,
    residual: ResidualReport,
    scores: ScoreReport,
}

#[derive(Debug, Serialize)]
struct LayerReport {
    inputs: usize,
    outputs: usize,
}

/// A feature's statistics and training range, in its unit.
#[derive(Debug, Serialize)]
struct FeatureReport {
    name: &'static str,
    mean: f32,
    std: f32,
    min: f32,
    max: f32,
}

#[derive(Debug, Serialize)]
struct ResidualReport {
    std_w: f32,
    q05_w: f32,
    q95_w: f32,
}

#[derive(Debug, Serialize)]
pub(super) struct ScoreReport {
    rows: u64,
    r2: f32,
    mae_w: f32,
    persistence_r2: f32,
    persistence_mae_w: f32,
}

impl ScoreReport {
    pub(super) fn new(network: &Network) -> Self {
        let scores = network.card().scores;
        Self {
            rows: scores.rows,
            r2: scores.network_r2,
            mae_w: scores.network_mae_w,
            persistence_r2: scores.persistence_r2,
            persistence_mae_w: scores.persistence_mae_w,
        }
    }
}

impl fmt::Display for ScoreReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { rows, r2, mae_w, persistence_r2, persistence_mae_w } = self;
        write!(
            out,
            "{rows} rows: MAE {mae_w:.4} W, R² {r2:.4}; persistence: MAE {persistence_mae_w:.4} W, \
             R² {persistence_r2:.4}"
        )
    }
}

impl OwnReport {
    fn new(file: String, kind: String, sha256: &str, network: &Network) -> Self {
        let card = network.card();
        let parameters = network.parameters();
        let normalisation = &parameters.normalisation;
        let set = network.feature_set();
        let layers = parameters.layers.iter();
        let layers: Vec<LayerReport> = layers
            .map(|layer| LayerReport {
                inputs: layer.weights.len() / layer.bias.len(),
                outputs: layer.bias.len(),
            })
            .collect();
        let feature = |number: usize| FeatureReport {
            name: FEATURE_NAMES[number],
            mean: normalisation.feature_mean[number],
            std: normalisation.feature_std[number],
            min: card.training_range.min[number],
            max: card.training_range.max[number],
        };
        Self {
            file,
            kind,
            file_sha256: sha256.to_owned(),
            model: card.name.clone(),
            model_hash: format!("{:016x}", network.hash()),
            source: card.source.clone(),
            training_data: card.training_data.clone(),
            training_data_sha256: card.training_data_sha256.clone(),
            trained_rows: card.trained_rows.as_ref().map(|trained| trained.rows),
            period_s: card.period_s(),
            seed: card.seed,
            feature_set: set.name(),
            activation: parameters.activation.name(),
            parameters: layers.iter().map(|layer| (layer.inputs + 1) * layer.outputs).sum(),
            layers,
            features: set.range().map(feature).collect(),
            power_mean_w: normalisation.power_mean_w,
            power_std_w: normalisation.power_std_w,
            residual: ResidualReport {
                std_w: card.residual.std_w,
                q05_w: card.residual.q05_w,
                q95_w: card.residual.q95_w,
            },
            scores: ScoreReport::new(network),
        }
    }
}

impl fmt::Display for OwnReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "{} ({}): {}", self.file, self.kind, self.model)?;
        writeln!(out, "hash          {}", self.model_hash)?;
        writeln!(out, "source        {}", self.source)?;
        writeln!(out, "training data {}", self.training_data)?;
        match self.trained_rows {
            Some(rows) => writeln!(out, "trained rows  {rows}, recognised by eval and report")?,
            None => writeln!(out, "trained rows  unknown: the file does not state them")?,
        }
        match self.period_s {
            Some(period_s) => writeln!(out, "period        {period_s} s")?,
            None => writeln!(out, "period        unknown: the file does not state it")?,
        }
        let first = self.layers.first().map_or(0, |layer| layer.inputs);
        let widths: Vec<String> = std::iter::once(first)
            .chain(self.layers.iter().map(|layer| layer.outputs))
            .map(|width| width.to_string())
            .collect();
        writeln!(
            out,
            "layers        {}, {}, {} parameters",
            widths.join("→"),
            self.activation,
            self.parameters
        )?;
        writeln!(
            out,
            "power         mean {:.4} W, deviation {:.4} W",
            self.power_mean_w, self.power_std_w
        )?;
        let ResidualReport { std_w, q05_w, q95_w } = self.residual;
        writeln!(out, "residuals     deviation {std_w:.4} W, 90 % in {q05_w:.4} to {q95_w:.4} W")?;
        writeln!(out, "scores        {}", self.scores)?;
        writeln!(
            out,
            "\n{:16} {:>12} {:>12} {:>12} {:>12}",
            "feature", "mean", "deviation", "min", "max"
        )?;
        for FeatureReport { name, mean, std, min, max } in &self.features {
            writeln!(out, "{name:16} {mean:12.5} {std:12.5} {min:12.5} {max:12.5}")?;
        }
        Ok(())
    }
}

/// A file of another program.
#[derive(Debug, Serialize)]
struct ForeignReport {
    file: String,
    kind: String,
    file_sha256: String,
    entries: Vec<EntryReport>,
    network: Option<FoundReport>,
    /// Reason that there is no network.
    problem: Option<String>,
}

#[derive(Debug, Serialize)]
struct EntryReport {
    path: String,
    what: String,
}

/// Location of a network.
#[derive(Debug, Serialize)]
pub(super) struct FoundReport {
    feature_set: &'static str,
    layers: Vec<FoundLayerReport>,
    activation: &'static str,
    activation_from: &'static str,
    /// True if the matrices have one row per input.
    transposed: bool,
    biases_paired_by: &'static str,
    normalisation: Vec<String>,
    normalisation_from: &'static str,
}

#[derive(Debug, Serialize)]
struct FoundLayerReport {
    inputs: usize,
    outputs: usize,
    weight: String,
    bias: String,
}

impl FoundReport {
    pub(super) fn new(found: &Found) -> Self {
        let layers = found.layers.iter().map(|found| FoundLayerReport {
            inputs: found.layer.weights.len() / found.layer.bias.len(),
            outputs: found.layer.bias.len(),
            weight: found.weight_path.clone(),
            bias: found.bias_path.clone(),
        });
        let by_name = found.paired_by_name;
        Self {
            feature_set: found.feature_set.name(),
            layers: layers.collect(),
            activation: found.activation.name(),
            activation_from: match found.activation_from {
                ActivationFrom::Caller => "as requested",
                ActivationFrom::File => "as the file states",
                ActivationFrom::Default => "the default: the file states none",
            },
            transposed: found.transposed,
            biases_paired_by: if by_name { "name" } else { "order" },
            normalisation: found.normalisation.sources.clone(),
            normalisation_from: match found.normalisation.from {
                StatisticsFrom::File => "the file",
                StatisticsFrom::Assumed => {
                    "the published model's documentation, if recordings agree: the file has none"
                }
                StatisticsFrom::Published => {
                    "the published model's documentation, as requested: the file has none"
                }
                StatisticsFrom::Recordings => "the recordings, as requested: the file has none",
            },
        }
    }
}

impl fmt::Display for FoundReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (number, layer) in self.layers.iter().enumerate() {
            let FoundLayerReport { inputs, outputs, weight, bias } = layer;
            writeln!(out, "layer {number}       {inputs}→{outputs}: {weight:?}, {bias:?}")?;
        }
        let rows = if self.transposed { "input" } else { "output" };
        let by = self.biases_paired_by;
        writeln!(out, "matrices      a row for each {rows}; biases paired by {by}")?;
        writeln!(out, "activation    {}, {}", self.activation, self.activation_from)?;
        writeln!(out, "normalisation from {}", self.normalisation_from)?;
        let by_recordings = self.normalisation_from.starts_with("the recordings");
        for source in self.normalisation.iter().filter(|_| !by_recordings) {
            writeln!(out, "              {source}")?;
        }
        Ok(())
    }
}

impl ForeignReport {
    fn new(file: String, checkpoint: &Checkpoint, args: &Args) -> Self {
        let found = checkpoint.find(args.part.as_deref(), args.activation);
        let (network, problem) = match found {
            Ok(found) => (Some(FoundReport::new(&found)), None),
            Err(error) => (None, Some(error.to_string())),
        };
        Self {
            file,
            kind: checkpoint.container.to_string(),
            file_sha256: checkpoint.sha256.clone(),
            entries: checkpoint.entries.iter().map(entry).collect(),
            network,
            problem,
        }
    }
}

fn entry(entry: &Entry) -> EntryReport {
    let what = match &entry.value {
        EntryValue::Tensor(tensor) => {
            let (shape, values) = (tensor.shape(), tensor.values());
            match values {
                [value] => format!("{} {shape:?} = {value}", tensor.element()),
                _ => format!("{} {shape:?}", tensor.element()),
            }
        }
        EntryValue::Number(number) => number.to_string(),
        EntryValue::Text(text) => format!("{text:?}"),
        EntryValue::Other(kind) => (*kind).to_owned(),
        _ => "something else".to_owned(),
    };
    EntryReport { path: entry.path.clone(), what }
}

impl fmt::Display for ForeignReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "{} ({}), SHA-256 {}", self.file, self.kind, self.file_sha256)?;
        for EntryReport { path, what } in self.entries.iter().take(MAX_SHOWN) {
            writeln!(out, "  {path:?}: {what}")?;
        }
        let more = self.entries.len().saturating_sub(MAX_SHOWN);
        if more > 0 {
            writeln!(out, "  and {more} more")?;
        }
        match (&self.network, &self.problem) {
            (Some(found), _) => write!(out, "\n{found}"),
            (None, problem) => {
                let problem = problem.as_deref().unwrap_or_default();
                writeln!(out, "\nno network: {problem}")
            }
        }
    }
}
