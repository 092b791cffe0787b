//! `joulebus train`: makes models.

use std::fmt;
use std::io::{IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context as _;
use clap::{Subcommand, ValueEnum};
use joulebus_lab::train::{Epoch, train_sim};
use joulebus_predictor::{FeatureSet, Network};
use serde::Serialize;

use crate::exit::Outcome;
use crate::output::{Output, say};

/// The trainer stops here at the latest: the paper's recipe, see `joulebus_lab::train::Settings`.
const MAX_EPOCHS: u32 = 100;

/// Train a model
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  joulebus train sim --seed 7 --out gternal-sim.safetensors")]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// On simulated GTernal robots: the same bytes from the same seed on every machine
    #[command(after_help = "Examples:\n  \
        joulebus train sim --seed 7 --out configs/models/gternal-sim.safetensors\n  \
        joulebus train sim --seed 7 --features power --out configs/models/gternal-sim-power.safetensors\n\n\
        The models that ship were made by these two commands. A model from simulation supports no \
        claim about real robots; it says so in its file.")]
    Sim(Sim),
}

#[derive(Debug, clap::Args)]
struct Sim {
    /// Seed of the simulated robots, the initial weights and the order of the rows
    #[arg(long, value_name = "N")]
    seed: u64,
    /// The model file to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// What the network reads
    #[arg(long, value_enum, default_value_t = Choice::Full)]
    features: Choice,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Choice {
    /// Velocities and five past readings
    Full,
    /// Five past readings: for robots that report no velocities
    Power,
}

impl From<Choice> for FeatureSet {
    fn from(choice: Choice) -> Self {
        match choice {
            Choice::Full => Self::Full,
            Choice::Power => Self::PowerOnly,
        }
    }
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let What::Sim(sim) = &args.what;
    // Minutes of work should not be lost to a directory that is not there.
    let folder = sim
        .out
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder {
        anyhow::ensure!(
            folder.is_dir(),
            "there is no directory {}",
            folder.display()
        );
    }
    let start = Instant::now();
    let trained = train_sim(sim.seed, sim.features.into(), |epoch| {
        progress(epoch, start);
    })?;
    write(&sim.out, &trained.network.to_safetensors()?)?;
    let epochs = trained.epochs.len();
    output.report(&TrainReport::new(&sim.out, &trained.network, epochs, start))?;
    Ok(Outcome::Done)
}

/// A line an epoch; in a terminal, the same line again.
fn progress(epoch: Epoch, start: Instant) {
    let Epoch {
        number,
        training_loss,
        validation_loss,
        best,
    } = epoch;
    let left = MAX_EPOCHS.saturating_sub(number);
    let left_s = start.elapsed().as_secs_f64() / f64::from(number) * f64::from(left);
    let star = if best { " (best)" } else { "       " };
    let line = format!(
        "epoch {number:3} of at most {MAX_EPOCHS}: loss {training_loss:.5}, on validation \
         {validation_loss:.5}{star}, at most {left_s:.0} s left"
    );
    let mut stderr = std::io::stderr();
    if stderr.is_terminal() {
        let end = if left == 0 { "\n" } else { "" };
        let _ = write!(stderr, "\r\x1b[K{line}{end}");
    } else {
        say(&line);
    }
}

/// The file appears whole or not at all.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let failed = || format!("cannot write the model {}", path.display());
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let mut draft = tempfile::Builder::new()
        .permissions(std::os::unix::fs::PermissionsExt::from_mode(0o644))
        .tempfile_in(folder.unwrap_or(Path::new(".")))
        .with_context(failed)?;
    draft.write_all(bytes).with_context(failed)?;
    draft.persist(path).with_context(failed)?;
    Ok(())
}

/// What was trained.
#[derive(Debug, Serialize)]
struct TrainReport {
    file: String,
    model: String,
    /// Identifies the contents.
    model_hash: String,
    source: String,
    training_data: String,
    seed: u64,
    epochs: usize,
    duration_s: f64,
    scores: HeldOut,
}

/// On simulated robots that the training has not seen.
#[derive(Debug, Serialize)]
struct HeldOut {
    rows: u64,
    mae_w: f32,
    r2: f32,
    persistence_mae_w: f32,
    persistence_r2: f32,
}

impl TrainReport {
    fn new(path: &Path, network: &Network, epochs: usize, start: Instant) -> Self {
        let card = network.card();
        Self {
            file: path.display().to_string(),
            model: card.name.clone(),
            model_hash: format!("{:016x}", network.hash()),
            source: card.source.clone(),
            training_data: card.training_data.clone(),
            seed: card.seed,
            epochs,
            duration_s: start.elapsed().as_secs_f64(),
            scores: HeldOut {
                rows: card.scores.rows,
                mae_w: card.scores.network_mae_w,
                r2: card.scores.network_r2,
                persistence_mae_w: card.scores.persistence_mae_w,
                persistence_r2: card.scores.persistence_r2,
            },
        }
    }
}

impl fmt::Display for TrainReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            file,
            model,
            model_hash,
            source,
            epochs,
            duration_s,
            scores,
            ..
        } = self;
        writeln!(out, "{file}: {model}, from {source}, hash {model_hash}")?;
        writeln!(out, "{epochs} epochs in {duration_s:.0} s")?;
        writeln!(
            out,
            "held out, {} rows: MAE {:.4} W, R² {:.4}; persistence: MAE {:.4} W, R² {:.4}",
            scores.rows, scores.mae_w, scores.r2, scores.persistence_mae_w, scores.persistence_r2
        )
    }
}
