//! `joulebus eval`: recorded trials through the tick, offline.

use std::path::PathBuf;

use anyhow::Context as _;
use joulebus_lab::evaluate::evaluate;
use joulebus_predictor::{Model, Network};
use joulebus_predictor_worker::load_models;

use crate::config_file::ConfigFile;
use crate::exit::Outcome;
use crate::output::Output;
use crate::trials::TrialFiles;

/// Evaluate recorded trials offline: the same bits as playing them live
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus eval recordings/*.csv.gz\n  \
    joulebus eval --model my.safetensors recordings/\n  \
    joulebus eval --config configs/mixed.toml robotino/@robotino husky/@husky\n\n\
    MAE in W; skill is 1 - squared error over that of persistence: above 0 is better than \
    repeating the last reading.")]
pub(crate) struct Args {
    #[command(flatten)]
    trials: TrialFiles,
    #[command(flatten)]
    config: ConfigFile,
    /// A model file, for all platforms [default: as the config says]
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let config = args.config.load()?;
    let settings = config.settings();
    let models = match &args.model {
        None => load_models(&config)?,
        Some(path) => {
            let bytes = std::fs::read(path)
                .with_context(|| format!("cannot read the model {}", path.display()))?;
            let network = Network::from_safetensors(&bytes)
                .with_context(|| format!("the model {} is refused", path.display()))?;
            vec![Model::Network(network); settings.platforms.len()]
        }
    };
    let trials = args.trials.read(settings)?;
    let evaluation = evaluate(settings, &models, &trials)?;
    output.report(&evaluation.report())?;
    Ok(Outcome::Done)
}
