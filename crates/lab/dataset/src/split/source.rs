//! Trials with the names of their units.

use hmac_sha256::Hash as Sha256;

use crate::rows::TrialRows;

/// The properties of a trial that a split needs.
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
    digest.finalize()
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
    let mut periods_s: Vec<f32> = sources.iter().map(|source| source.period_s).collect();
    periods_s.sort_by(f32::total_cmp);
    periods_s.get(periods_s.len() / 2).copied().unwrap_or(0.0)
}
