//! `joulebus model info`: contents of a model file.

use std::fmt;
use std::path::PathBuf;

use joulebus_energy::Limit;
use joulebus_predictor::{FEATURE_NAMES, Network};
use joulebus_program::exit::Outcome;
use joulebus_program::model_source;
use joulebus_program::output::Output;
use serde::Serialize;

/// Show the contents of a model file: layers, features, normalisation, training range, hash, scores
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus model info builtin:husky\n  \
    joulebus model info my.safetensors --format json")]
pub(crate) struct Args {
    /// A joulebus model (.safetensors), or builtin:NAME
    #[arg(value_name = "FILE")]
    file: PathBuf,
}

pub(super) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let network = model_source::load(&args.file)?;
    output.report(&ModelReport::new(args.file.display().to_string(), &network))?;
    Ok(Outcome::Done)
}

#[derive(Debug, Serialize)]
struct ModelReport {
    file: String,
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
    /// What the recordings cannot show of plans.
    limits: Vec<Limit>,
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

impl ModelReport {
    fn new(file: String, network: &Network) -> Self {
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
            limits: card.energy.as_ref().map_or_else(Vec::new, |energy| energy.limits.clone()),
        }
    }
}

impl fmt::Display for ModelReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "{}: {}", self.file, self.model)?;
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
        if !self.limits.is_empty() {
            let limits: Vec<String> = self.limits.iter().map(|limit| limit.to_string()).collect();
            writeln!(out, "limits        {}", limits.join(", "))?;
        }
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
