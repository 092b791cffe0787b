//! `--forecasts`: other programs' forecasts, scored beside a model's.

use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;

use joulebus_eval::score::{Foreign, Reference, ScoreError};

/// Forecasts to compare with.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct ReferenceArguments {
    /// Forecasts of another program, one tick ahead, for every evaluated row, as CSV. Its columns
    /// are recording (its file), row (from 1, the row whose power is forecast), power_w, and lo_w
    /// and hi_w if it has intervals
    #[arg(long, value_name = "NAME=FILE")]
    forecasts: Vec<Named>,
}

/// A file with the name of who forecast.
#[derive(Debug, Clone)]
struct Named {
    name: String,
    file: PathBuf,
}

impl FromStr for Named {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once('=') {
            Some((name, file)) if !name.is_empty() && !file.is_empty() => {
                Ok(Self { name: name.to_owned(), file: PathBuf::from(file) })
            }
            _ => Err("allowed is NAME=FILE, such as lightgbm=forecasts.csv".to_owned()),
        }
    }
}

impl ReferenceArguments {
    /// The references that need no other program, and the named ones.
    ///
    /// # Errors
    /// A file cannot be read or is no forecasts.
    pub(crate) fn read(&self) -> Result<Vec<Reference>, ScoreError> {
        let foreign = self.forecasts.iter().map(|Named { name, file }| {
            Foreign::read(name, file).map(|foreign| Reference::Foreign(Arc::new(foreign)))
        });
        Reference::OWN.into_iter().map(Ok).chain(foreign).collect()
    }
}
