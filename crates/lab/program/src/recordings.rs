//! Recordings on the command line, and how they are resampled.

use std::path::PathBuf;

use clap::ValueEnum;
use joulebus_config::{Assignment, Config};
use joulebus_dataset::inspect::find;
use joulebus_dataset::trial::{ColumnMap, MapError, MappedColumn, Method, TrialError};
use joulebus_eval::score::{ROWS_IN_MEMORY, Recording, open_recordings};
use joulebus_program::exit::UsageError;
use joulebus_program::output::log_line;
use joulebus_program::shell::quoted;

/// Recordings on the command line.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Recordings {
    /// Recordings (.npy, .csv, .csv.gz), captures (.mcap), directories (searched recursively), or
    /// patterns in quotes: 'runs/**/*.npy'
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    #[command(flatten)]
    columns: ColumnArguments,
}

/// Names of a CSV's columns.
#[derive(Debug, Clone, Default, clap::Args)]
pub(crate) struct ColumnArguments {
    /// Columns of CSV files whose names joulebus does not know: time=timestamp_s,power=load_W
    /// (`data check --help` lists the names that it knows). A minus changes the sign: current_A=-i.
    /// := gives a value for every row: voltage_V:=3.0
    #[arg(long, value_name = "QUANTITY=COLUMN,…", value_delimiter = ',')]
    map: Vec<MappedColumn>,
    /// Sign of the current, and of a power that has its sign [default: discharge-positive, of bags
    /// discharge-negative, as in ROS]
    #[arg(long, value_name = "SIGN")]
    pub(crate) current: Option<Sign>,
}

/// Whether lines that are no rows are left out, for verbs that write what they read.
#[derive(Debug, Clone, Copy, clap::Args)]
pub(crate) struct LineArguments {
    /// Leave out lines of CSV files that are no whole rows (cut, NUL bytes, comments, a second
    /// header, units), and say how many
    #[arg(long)]
    pub(crate) whole_rows: bool,
}

/// Note of an option that a config keeps.
pub(crate) const GIVEN: &str = "As given.";

/// Sign of the current.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Sign {
    /// Negative while discharging
    DischargeNegative,
    /// Positive while discharging
    DischargePositive,
}

impl ColumnArguments {
    /// The options again, for a command that reads the same recordings: empty, or with a space in
    /// front.
    pub(crate) fn options(&self) -> String {
        let mut options = String::new();
        if !self.map.is_empty() {
            options += &format!(" --map {}", quoted(&self.mapped()));
        }
        if let Some(sign) = self.current.and_then(|sign| sign.to_possible_value()) {
            options += &format!(" --current {}", sign.get_name());
        }
        options
    }

    /// Rules for reading a platform's recordings. Options that are not given are as in the config.
    pub(crate) fn or_configured(
        &self,
        config: &Config,
        platform: usize,
    ) -> anyhow::Result<ColumnMap> {
        let stated = config.recordings(platform);
        let refused = |key, error| {
            let name = &config.settings().platforms[platform].name;
            anyhow::Error::from(UsageError(format!("platform {name}: `recordings.{key}`: {error}")))
        };
        let mut own = self.map();
        if let Some(map) = stated.map.filter(|_| self.map.is_empty()) {
            let columns = map.split(',').map(str::parse);
            let columns = columns.collect::<Result<_, _>>();
            let columns = columns.map_err(|error: MapError| refused("map", error.to_string()))?;
            own = own.configured(columns);
        }
        if let Some(sign) = stated.current.filter(|_| self.current.is_none()) {
            let sign = Sign::from_str(&sign, false).map_err(|error| refused("current", error))?;
            own = own.configured_discharge_negative(sign == Sign::DischargeNegative);
        }
        Ok(own)
    }

    /// The same options as settings of a platform's config.
    pub(crate) fn assignments(&self) -> Vec<Assignment> {
        let mut stated = Vec::new();
        if !self.map.is_empty() {
            let map = Assignment::text("recordings.map", &self.mapped(), GIVEN);
            stated.push(map);
        }
        if let Some(sign) = self.current.and_then(|sign| sign.to_possible_value()) {
            stated.push(Assignment::text("recordings.current", sign.get_name(), GIVEN));
        }
        stated
    }

    fn mapped(&self) -> String {
        let columns: Vec<String> = self.map.iter().map(ToString::to_string).collect();
        columns.join(",")
    }

    /// Rules for reading recordings: the names and the sign given.
    pub(crate) fn map(&self) -> ColumnMap {
        let turned = self.current == Some(Sign::DischargeNegative);
        ColumnMap::from(self.map.clone()).discharge_negative(turned)
    }
}

impl Recordings {
    /// The files found by [`find_recordings`].
    pub(crate) fn find(&self) -> anyhow::Result<Vec<PathBuf>> {
        find_recordings(&self.paths)
    }

    /// The names of their columns.
    pub(crate) fn map(&self) -> ColumnMap {
        self.columns.map()
    }

    /// The same for recordings of a platform of the config.
    pub(crate) fn map_of(&self, config: &Config, platform: usize) -> anyhow::Result<ColumnMap> {
        self.columns.or_configured(config, platform)
    }
}

/// Finds the files of `paths`. Other files in the directories, and duplicates, are reported on
/// stderr.
///
/// # Errors
/// A path does not exist, or contains no recordings.
pub(crate) fn find_recordings(paths: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let found = find(paths).map_err(|error| match error.is_usage() {
        true => UsageError(error.to_string()).into(),
        false => anyhow::Error::from(error),
    })?;
    found.remarks().for_each(|remark| log_line(&remark));
    Ok(found.files)
}

/// Opens recordings: the first rows stay in memory, the others are read when they are needed. Ids
/// are consecutive.
pub(crate) fn open(files: Vec<PathBuf>, map: &ColumnMap) -> Result<Vec<Recording>, TrialError> {
    let files: Vec<(u32, PathBuf)> = (0..).zip(files).collect();
    open_with_ids(&files, map)
}

/// The same with the ids of their robots.
pub(crate) fn open_with_ids(
    files: &[(u32, PathBuf)],
    map: &ColumnMap,
) -> Result<Vec<Recording>, TrialError> {
    open_recordings(files, map, ROWS_IN_MEMORY)
}

/// Resampling method.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum Resampling {
    /// The latest row
    Hold,
    /// The mean over the period that ends at the row
    Mean,
    /// Linear interpolation between the neighbouring rows
    Linear,
}

impl From<Resampling> for Method {
    fn from(how: Resampling) -> Self {
        match how {
            Resampling::Hold => Self::Hold,
            Resampling::Mean => Self::Mean,
            Resampling::Linear => Self::Linear,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::train_recordings;

    #[test]
    fn a_recording_that_is_gone_when_it_is_read_is_named() {
        let folder = tempfile::tempdir().expect("a temporary directory");
        let files = ["gone.csv", "kept.csv"].map(|name| folder.path().join(name));
        let rows: String = (0..300).map(|row| format!("{}.{},2\n", row / 10, row % 10)).collect();
        for file in &files {
            std::fs::write(file, format!("time,power_W\n{rows}")).expect("writable");
        }
        let found = find_recordings(&[folder.path().to_owned()]).expect("two recordings");
        assert_eq!(found, files);
        std::fs::remove_file(&files[0]).expect("removable");
        let (map, columns) = (ColumnMap::default(), ColumnArguments::default());
        let with_ids: Vec<(u32, PathBuf)> = (3..).zip(found.clone()).collect();
        let out = folder.path().join("model");
        for (verb, error) in [
            ("eval, train trials, analyze", open(found.clone(), &map).err().map(Into::into)),
            ("eval of a config's robots", open_with_ids(&with_ids, &map).err().map(Into::into)),
            ("config init --train", train_recordings(&found, &columns, &out, 2).err()),
        ] {
            let error: anyhow::Error = error.unwrap_or_else(|| panic!("{verb}: it is missed"));
            assert!(format!("{error:#}").contains("gone.csv"), "{verb}: {error:#}");
        }
    }
}
