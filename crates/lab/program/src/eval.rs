//! `joulebus eval`: offline evaluation of recorded trials against the baselines.

mod subject;

use std::path::{Path, PathBuf};

use joulebus_eval::EvalReport;
use joulebus_eval::score::{Options, Recording, ScoreError, score_reported};
use joulebus_eval::trips::trips;
use joulebus_models::load_models;
use joulebus_predictor::Model;
use joulebus_program::exit::Outcome;
use joulebus_program::model_source;
use joulebus_program::output::{Output, log_line};

use crate::design::usage;
use crate::judgement::report;
use crate::references::ReferenceArguments;
pub(crate) use subject::Selection;

/// Evaluate recorded trials offline: the same bits as playing them live, compared with the
/// baselines
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus eval recordings/*.csv.gz\n  \
    joulebus eval --model my.safetensors recordings/ --split trial\n  \
    joulebus eval --model without-ice.safetensors husky/ --leave-out ICE\n  \
    joulebus eval --model my.safetensors t6.npy --fit t1.npy t2.npy t3.npy t4.npy\n  \
    joulebus eval --config configs/mixed.toml robotino/@robotino husky/@husky\n  \
    joulebus eval --model my.safetensors recordings/ --split trial --energy\n  \
    joulebus eval --trips recordings/\n\n\
    Each forecast is based on real readings, one tick ahead. MAE is in W. Skill is 1 - squared error over \
    that of persistence: above 0 is better than repeating the last reading. [lo, hi] are \
    confidence \
    intervals by block bootstrap. All forecasters are scored on the same rows: those with five \
    gapless readings before them.\n\n\
    With --model and no config, period and limits are those of each recording. Otherwise they are \
    those of the config's platforms. Rows that a model was trained on, as its file states, are \
    recognised by their readings and scored apart. The tables are of the others. --split \
    evaluates what `joulebus train trials` with the same recordings, \
    split and seed holds out.")]
pub(crate) struct Args {
    #[command(flatten)]
    asked: Selection,
    /// Instead: ask about each recorded drive at its beginning from its commands alone, let it drive,
    /// and compare. Each drive and each group (a floor or a day) is left out of the training in turn
    #[arg(long, conflicts_with_all = ["model", "split", "leave_out", "fit", "energy"])]
    trips: bool,
    /// A model file, for all platforms [default: as in the config]
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Also score the energy of the next 1 to 300 s, as far as the recordings reach. The robots run
    /// one after the other, as one fleet that learns from each
    #[arg(long)]
    energy: bool,
    #[command(flatten)]
    references: ReferenceArguments,
}

impl Args {
    fn options(&self) -> anyhow::Result<Options> {
        let (references, energy) = (self.references.read()?, self.energy);
        Ok(Options { references, energy, ..self.asked.options() })
    }
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let config = args.asked.config()?;
    if args.trips {
        let sections = args.asked.sections(&config, true)?;
        let implausible = args.asked.judge(&sections)?;
        let recordings = sections.iter().flat_map(|section| section.recordings());
        let recordings: Vec<Recording> = recordings.cloned().collect();
        report(output, &trips(&recordings)?, implausible)?;
        return Ok(Outcome::Done);
    }
    let named = args.model.as_deref().map(load).transpose()?;
    let models = match &named {
        None => load_models(&config)?,
        Some(model) => vec![model.clone(); config.settings().platforms.len()],
    };
    let sections = args.asked.sections(&config, named.is_some())?;
    let implausible = args.asked.judge(&sections)?;
    let mut evaluations = Vec::new();
    let options = args.options()?;
    let mut refused = None;
    for section in &sections {
        let model = &models[section.place];
        let models = std::slice::from_ref(model);
        let design = args.asked.design(section, models)?;
        let subject = section.subject(models, &design);
        match score_reported(subject, &options).map_err(usage) {
            Ok(reported) => {
                warn(&reported.warnings);
                evaluations.push(reported);
            }
            // A platform without rows must not hide the others.
            Err(error) if sections.len() > 1 && is_without_rows(&error) => {
                log_line(&format!("warning: platform {}: {error:#}", section.name()));
                refused = Some(error);
            }
            Err(error) => return Err(error),
        }
    }
    if let (true, Some(error)) = (evaluations.is_empty(), refused) {
        return Err(error);
    }
    report(output, &EvalReport { evaluations }, implausible)?;
    Ok(Outcome::Done)
}

/// Prints warnings on stderr.
pub(crate) fn warn(warnings: &[String]) {
    for warning in warnings {
        log_line(&format!("warning: {warning}"));
    }
}

fn is_without_rows(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(ScoreError::NoRows { .. }))
}

/// The model of a file, or a built-in one.
pub(crate) fn load(path: &Path) -> anyhow::Result<Model> {
    Ok(Model::Network(model_source::load(path)?))
}
