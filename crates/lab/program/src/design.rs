//! The rows that are evaluated, and those that baselines are fitted on.

use std::path::PathBuf;

use joulebus_dataset::split::Split;
use joulebus_eval::score::{Design, Recording, ScoreError, check_apart};
use joulebus_program::exit::UsageError;

use crate::split_unit::SplitUnit;

/// What is held out of recordings.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct DesignArguments {
    /// Evaluate the held-out part of a split, with baselines fitted on the rest: unit of the split
    /// [default: evaluate all, baselines cross-fitted on other trials]
    #[arg(long, value_enum, value_name = "BY", conflicts_with = "fit")]
    split: Option<SplitUnit>,
    /// Share that the split holds out, as in training
    #[arg(long, value_name = "SHARE", default_value_t = Split::default().held_out, requires = "split")]
    held_out: f64,
    /// A shift: groups, folders, robots or trials to evaluate, with baselines fitted on all others.
    /// With --split: units of it to hold out, instead of a share
    #[arg(long, value_name = "NAME,…", value_delimiter = ',', conflicts_with = "fit")]
    leave_out: Vec<String>,
    /// Recordings that the baselines are fitted on, instead of cross-fitting
    #[arg(long, value_name = "PATH", num_args = 1..)]
    fit: Vec<PathBuf>,
}

impl DesignArguments {
    /// The design for recordings, whose split has a seed. `open` reads those to fit on.
    pub(crate) fn design(
        &self,
        recordings: &[Recording],
        seed: u64,
        open: impl FnOnce(&[PathBuf]) -> anyhow::Result<Vec<Recording>>,
    ) -> anyhow::Result<Design> {
        let names = self.leave_out.as_slice();
        if let Some(together) = self.split {
            let (by, held_out) = (together.into(), self.held_out);
            let wanted = Split { by, held_out, seed, ..Split::default() };
            let design = match names {
                [] => Design::held_out(recordings, wanted),
                names => Design::leaving_out(recordings, wanted, names),
            };
            return design.map_err(usage);
        }
        if !names.is_empty() {
            return Design::shifted(recordings, names).map_err(usage);
        }
        if self.fit.is_empty() {
            return Ok(Design::folds(recordings));
        }
        let others = open(&self.fit)?;
        check_apart(recordings, (&others, "after --fit"))
            .map_err(|error| UsageError(error.to_string()))?;
        Ok(Design::fitted_on(recordings, others))
    }
}

/// Errors caused by the arguments become usage errors.
pub(crate) fn usage(error: ScoreError) -> anyhow::Error {
    match error {
        ScoreError::Split(_) | ScoreError::Option { .. } => UsageError(error.to_string()).into(),
        error => error.into(),
    }
}
