//! Trials with the names of their units.

use rayon::prelude::*;
use sha2::{Digest as _, Sha256};

use crate::rows::{TrialRows, trial_rows};
use crate::trial::Trial;

/// A trial's rows with the names of its units.
#[derive(Debug, Clone)]
pub struct Source {
    /// Name of the trial: its file.
    pub trial: String,
    /// Name of the robot.
    pub robot: String,
    /// Name of the group: [`group_of`] its file.
    pub group: String,
    /// The trial's rows.
    pub rows: TrialRows,
}

impl Source {
    /// A trial, with names derived from its file. Robots that share a file belong to one group.
    pub fn new(trial: &Trial) -> Self {
        let file = trial.path().file_name().and_then(|name| name.to_str());
        let file = file.unwrap_or_default();
        Self {
            trial: trial.path().display().to_string(),
            robot: trial.robot_name().unwrap_or(file).to_owned(),
            group: group_of(file),
            rows: trial_rows(trial),
        }
    }
}

/// The properties of a trial that a split needs: a [`Source`] without its rows.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceInfo {
    /// Name of the trial: its file.
    pub trial: String,
    /// Name of the robot.
    pub robot: String,
    /// Name of the group.
    pub group: String,
    /// Number of the trial's rows.
    pub rows: usize,
    /// Their [`digest`].
    pub digest: [u8; 32],
    /// Period of the samples, s.
    pub period_s: f32,
}

impl From<&Source> for SourceInfo {
    fn from(source: &Source) -> Self {
        Self {
            trial: source.trial.clone(),
            robot: source.robot.clone(),
            group: source.group.clone(),
            rows: source.rows.rows.len(),
            digest: digest(&source.rows),
            period_s: source.rows.period_s,
        }
    }
}

impl SourceInfo {
    /// The information of each source, in their order.
    pub fn of(sources: &[Source]) -> Vec<Self> {
        sources.par_iter().map(Self::from).collect()
    }
}

/// A trial in one of several parts that must not share a row.
#[derive(Debug, Clone, Copy)]
pub struct Placed<'a> {
    /// Name of the trial: its file.
    pub trial: &'a str,
    /// Number of the trial's rows.
    pub rows: usize,
    /// Their [`digest`].
    pub digest: [u8; 32],
    /// Name of the part in messages.
    pub part: &'static str,
}

impl<'a> Placed<'a> {
    /// A source in a part.
    pub fn new(source: &'a SourceInfo, part: &'static str) -> Self {
        Self { trial: &source.trial, rows: source.rows, digest: source.digest, part }
    }
}

/// The group of a file: its name without trailing numbers. `ICE_03.csv.gz` and `ICE_04.csv.gz`
/// belong to the group `ICE`.
pub fn group_of(file_name: &str) -> String {
    let stem = file_name.split('.').next().unwrap_or(file_name);
    let name = stem.trim_end_matches(|c: char| c.is_ascii_digit());
    let name = name.trim_end_matches(['_', '-', ' ']);
    if name.is_empty() { stem } else { name }.to_owned()
}

/// Hash of everything that is learned from the rows.
pub fn digest(rows: &TrialRows) -> [u8; 32] {
    let mut digest = Sha256::new();
    let mut bytes = Vec::new();
    for row in &rows.rows {
        let values = row.features.iter().chain([&row.target_w]);
        bytes.extend(values.flat_map(|value| value.to_le_bytes()));
        digest.update(&bytes);
        bytes.clear();
    }
    digest.finalize().into()
}

/// Number and groups of recordings, as a model's file states them.
pub fn describe(sources: &[SourceInfo]) -> String {
    let mut groups: Vec<&str> = sources.iter().map(|source| source.group.as_str()).collect();
    groups.sort_unstable();
    groups.dedup();
    let named = match groups.len() {
        ..=8 => groups.join(", "),
        more => format!("{}, … ({more} groups)", groups[..8].join(", ")),
    };
    format!("{} recorded trials of {named}", sources.len())
}

/// The median period of some recordings, s. 0 without any.
pub fn median_period_s(sources: &[SourceInfo]) -> f32 {
    median_s(sources.iter().map(|source| source.period_s))
}

pub(super) fn median_s(periods_s: impl Iterator<Item = f32>) -> f32 {
    let mut periods_s: Vec<f32> = periods_s.collect();
    periods_s.sort_by(f32::total_cmp);
    periods_s.get(periods_s.len() / 2).copied().unwrap_or(0.0)
}
