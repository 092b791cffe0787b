//! `joulebus train`: trains models.

mod run;
mod trials;

use std::path::PathBuf;
use std::time::Instant;

use clap::{Subcommand, ValueEnum};
use joulebus_dataset::split::Split;
use joulebus_predictor::FeatureSet;
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;
use joulebus_sim::training_data::{SimulatedData, dataset_from_plant};
use joulebus_train::{TrainReport, TrainSettings, settings_for_sim};

use crate::recordings::ColumnArguments;
use run::RunArguments;

/// Train a model
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus train sim --seed 7 --out gternal-sim.safetensors\n  \
    joulebus train trials recordings/ --split group --out husky.safetensors\n\n\
    The model file identifies the rows it was trained on, so that `eval` and `report` can score them \
    apart.\n\
    Ctrl-C saves a checkpoint beside the model. --resume continues from it, to the same bytes.")]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Train on simulated GTernal robots: the same seed gives the same bytes on every machine
    #[command(after_help = "Examples:\n  \
        joulebus train sim --seed 7 --out configs/models/gternal-sim.safetensors\n  \
        joulebus train sim --seed 7 --features power --out configs/models/gternal-sim-power.safetensors\n  \
        joulebus train sim --seed 7 --features freshness --out configs/models/gternal-sim-freshness.safetensors\n\n\
        The shipped models were made with these three commands: 12 robots on trials 1 to 4 train, 4 on \
        trial 5 validate, 8 on trial 6 are held out (docs/measured/plant.md). A model from \
        simulation supports no claim about real robots. Its file states this.")]
    Sim(Sim),
    /// Train on recorded trials (.npy, .csv, .csv.gz), one robot per file
    Trials(Box<trials::Args>),
}

#[derive(Debug, clap::Args)]
struct Sim {
    /// Seed of the simulated robots, the initial weights and the order of the rows
    #[arg(long, value_name = "N")]
    seed: u64,
    /// Input features of the network
    #[arg(long, value_enum, default_value_t = FeatureChoice::Full)]
    features: FeatureChoice,
    #[command(flatten)]
    run: RunArguments,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum FeatureChoice {
    /// Velocities and five past readings
    Full,
    /// Five past readings: for robots that report no velocities
    Power,
    /// As full, with the age of the newest reading and whether a new one is due
    Freshness,
    /// As power, with the age of the newest reading and whether a new one is due
    PowerFreshness,
}

impl From<FeatureChoice> for FeatureSet {
    fn from(choice: FeatureChoice) -> Self {
        match choice {
            FeatureChoice::Full => Self::Full,
            FeatureChoice::Power => Self::PowerOnly,
            FeatureChoice::Freshness => Self::Freshness,
            FeatureChoice::PowerFreshness => Self::PowerFreshness,
        }
    }
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    match &args.verb {
        Verb::Sim(sim) => simulated(sim, output),
        Verb::Trials(args) => trials::run(args, output),
    }
}

fn simulated(sim: &Sim, output: Output) -> anyhow::Result<Outcome> {
    sim.run.check()?;
    let settings: TrainSettings = settings_for_sim(sim.seed, sim.features.into());
    let dataset = dataset_from_plant(SimulatedData::shipped(sim.seed));
    let start = Instant::now();
    let Some(trained) = sim.run.train(&dataset, &settings)? else {
        return Ok(Outcome::Failed);
    };
    output.report(&TrainReport::new(Some(&sim.run.out), &trained, start.elapsed(), None))?;
    Ok(Outcome::Done)
}

/// Trains on files of recordings that were judged before, by the default recipe. Returns the split
/// and the bytes of the model that is named after `out`, or none if the run was interrupted. A few
/// trials are split in time, because there is none to hold out.
///
/// # Errors
/// The recordings cannot be read or are too few.
pub(crate) fn train_recordings(
    files: &[PathBuf],
    columns: &ColumnArguments,
    out: &std::path::Path,
    count: usize,
) -> anyhow::Result<Option<(Split, Vec<u8>)>> {
    trials::Args::new(files, columns, out, count).train()
}

/// Path of the checkpoint of an unfinished run: beside the model.
fn checkpoint_path(out: &std::path::Path) -> PathBuf {
    let mut name = out.as_os_str().to_owned();
    name.push(".training");
    PathBuf::from(name)
}
