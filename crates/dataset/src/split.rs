//! Assigns rows to training, validation and held-out parts.
//!
//! Neighbouring rows are correlated, so single rows are never assigned: whole trials, robots or
//! groups of trials go to one part, or each trial is cut in time with a pause between the parts
//! that is longer than the lag window and that lasts until the reading at the cut, which the sensor
//! may hold, has left the window.
//!
//! A recording that exists twice, as two files, could be both learned from and scored on: if its
//! rows fall into two parts, the split is refused. Dropping one file silently would change the set
//! of units, and so the whole split.

use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::ops::Range;
use std::str::FromStr;

use joulebus_predictor::LAGS;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::rows::{Dataset, Row, TrialRows, trial_rows};
use crate::trial::Trial;
use joulebus_statistics::noise::Noise;

/// Minimum number of rows left out at each cut in time: the lag window and the target reading,
/// twice.
pub const PAUSE_ROWS: usize = 2 * (LAGS + 1);

/// Unit of the split: what stays in one part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum By {
    /// Each trial.
    Trial,
    /// All trials of a robot.
    Robot,
    /// All trials of a group: the same surface, terrain or load.
    Group,
    /// The first part of every trial is for training, the last is held out.
    Time,
}

impl fmt::Display for By {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Trial => "trial",
            Self::Robot => "robot",
            Self::Group => "group",
            Self::Time => "time",
        })
    }
}

impl FromStr for By {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let all = [Self::Trial, Self::Robot, Self::Group, Self::Time];
        let found = all.into_iter().find(|by| by.to_string() == text);
        found
            .ok_or_else(|| format!("a split by {text:?}: allowed are trial, robot, group and time"))
    }
}

/// Configuration of a split.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Split {
    /// Unit of the split.
    pub by: By,
    /// Share of the units (for a split in time, of each trial's rows) for validation, above 0.
    pub validation: f64,
    /// Share held out, above 0; together with `validation` below 1.
    pub held_out: f64,
    /// Seed of the shuffle of units; unused by a split in time.
    pub seed: u64,
}

impl Default for Split {
    /// By trial, 15 % each.
    fn default() -> Self {
        Self {
            by: By::Trial,
            validation: 0.15,
            held_out: 0.15,
            seed: 0,
        }
    }
}

impl fmt::Display for Split {
    /// `by trial, 15 % for validation, 15 % held out, seed 0`
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            by,
            validation,
            held_out,
            seed,
        } = self;
        let (validation, held_out) = (percent(*validation), percent(*held_out));
        write!(
            out,
            "by {by}, {validation} % for validation, {held_out} % held out"
        )?;
        match by {
            By::Time => write!(out, ", {PAUSE_ROWS} rows or more between"),
            _ => write!(out, ", seed {seed}"),
        }
    }
}

/// To three decimals.
fn percent(share: f64) -> f64 {
    (share * 1e5).round() / 1e3
}

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
    #[must_use]
    pub fn of(trial: &Trial) -> Self {
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

/// A trial in one of several parts that must not share a row.
#[derive(Debug, Clone, Copy)]
pub struct Placed<'a> {
    /// Name of the trial: its file.
    pub trial: &'a str,
    /// The trial's rows.
    pub rows: &'a TrialRows,
    /// Name of the part in messages.
    pub part: &'static str,
}

impl<'a> Placed<'a> {
    /// A source in a part.
    #[must_use]
    pub fn new(source: &'a Source, part: &'static str) -> Self {
        let Source { trial, rows, .. } = source;
        Self { trial, rows, part }
    }
}

/// The rows of each trial in each part.
#[derive(Debug, Clone, PartialEq)]
pub struct Assignment {
    /// For each source in order, its row ranges: training, validation, held out.
    pub ranges: Vec<[Range<usize>; 3]>,
    /// Names of the units in each part.
    pub summary: SplitSummary,
}

/// Names of the units in each part, and numbers of rows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SplitSummary {
    /// Unit of the split.
    pub by: By,
    /// Names of the units for training; for a split in time the trials, once.
    pub training: Vec<String>,
    /// Units for validation.
    pub validation: Vec<String>,
    /// Units held out.
    pub held_out: Vec<String>,
    /// Rows per part: training, validation, held out.
    pub rows: [usize; 3],
    /// Rows in no part, at the cuts in time.
    pub pause_rows: usize,
    /// Description of the split.
    pub name: String,
}

/// Why a split is not possible.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SplitError {
    /// A share is out of range.
    #[error(
        "validation = {validation}, held_out = {held_out}: allowed are shares above 0 that come to \
         less than 1 together"
    )]
    Shares {
        /// Share for validation.
        validation: f64,
        /// Share held out.
        held_out: f64,
    },
    /// A unit to be held out does not exist.
    #[error("found no {by} {wanted:?}; there are {found}")]
    Unknown {
        /// Unit of the split.
        by: By,
        /// The requested name.
        wanted: String,
        /// The available names.
        found: String,
    },
    /// There are too few units.
    #[error(
        "found {found} {by}s, at least 3 are needed, one a part; name more recordings, or split by \
         time"
    )]
    TooFew {
        /// Unit of the split.
        by: By,
        /// Units found.
        found: usize,
    },
    /// The same rows would be used for training and for scoring.
    #[error(
        "{}, {} and {}: {rows} rows. A model must not be scored on its training rows: leave one of them out",
        in_two_parts(trials), parts[0], parts[1]
    )]
    Copy {
        /// The trials; the same name twice if it was given twice.
        trials: [String; 2],
        /// The part of each.
        parts: [&'static str; 2],
        /// Number of shared rows.
        rows: usize,
    },
}

fn in_two_parts([first, second]: &[String; 2]) -> String {
    if first == second {
        format!("{first} is in two parts")
    } else {
        format!("{first} and {second} are the same recording and in two parts")
    }
}

/// The group of a file: its name without trailing numbers. `ICE_03.csv.gz` and `ICE_04.csv.gz`
/// belong to the group `ICE`.
#[must_use]
pub fn group_of(file_name: &str) -> String {
    let stem = file_name.split('.').next().unwrap_or(file_name);
    let name = stem.trim_end_matches(|c: char| c.is_ascii_digit());
    let name = name.trim_end_matches(['_', '-', ' ']);
    if name.is_empty() { stem } else { name }.to_owned()
}

/// Refuses rows that are in two parts: a recording may exist twice, under two names. Trials without
/// rows are ignored.
///
/// # Errors
/// [`SplitError::Copy`] with the first duplicate.
pub fn check_copies<'a>(placed: impl IntoIterator<Item = Placed<'a>>) -> Result<(), SplitError> {
    let mut first_with: HashMap<[u8; 32], Placed<'a>> = HashMap::new();
    for one in placed {
        let rows = one.rows.rows.len();
        if rows == 0 {
            continue;
        }
        let first = *first_with.entry(digest(one.rows)).or_insert(one);
        if first.part != one.part {
            return Err(SplitError::Copy {
                trials: [first, one].map(|placed| placed.trial.to_owned()),
                parts: [first.part, one.part],
                rows,
            });
        }
    }
    Ok(())
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

/// Splits the rows. `description` states their origin; the split is appended to it.
///
/// # Errors
/// [`SplitError`].
pub fn split(
    sources: &[Source],
    split: Split,
    description: &str,
) -> Result<(Dataset, SplitSummary), SplitError> {
    let assignment = assign(sources, split)?;
    let seed = match split.by {
        By::Time => String::new(),
        _ => format!(", seed {}", split.seed),
    };
    let description = format!("{description}; split by {}{seed}", split.by);
    Ok((assignment.dataset(sources, description), assignment.summary))
}

/// Rows whose parts are given individually: training, validation, held out. `description` states their origin.
///
/// # Errors
/// [`SplitError::Copy`]: the same rows are in two parts.
pub fn given(
    parts: [&[Source]; 3],
    description: &str,
) -> Result<(Dataset, SplitSummary), SplitError> {
    let placed = parts.into_iter().zip(PARTS).flat_map(|(sources, part)| {
        let place = move |source| Placed::new(source, part);
        sources.iter().map(place)
    });
    check_copies(placed)?;
    let [training, validation, held_out] = parts
        .map(|part| -> Vec<String> { part.iter().map(|source| source.trial.clone()).collect() });
    let rows = parts.map(|part| -> Vec<Row> {
        let rows = part.iter().flat_map(|source| &source.rows.rows);
        rows.copied().collect()
    });
    let summary = SplitSummary {
        by: By::Trial,
        rows: [rows[0].len(), rows[1].len(), rows[2].len()],
        training,
        validation,
        held_out,
        pause_rows: 0,
        name: "given individually".to_owned(),
    };
    let [training, validation, held_out] = rows;
    let dataset = Dataset {
        training,
        validation,
        held_out,
        description: format!("{description}; parts given individually"),
        period_s: median_period_s(parts[0]),
    };
    Ok((dataset, summary))
}

/// Number and groups of recordings, as a model's file states them.
#[must_use]
pub fn describe(sources: &[Source]) -> String {
    let mut groups: Vec<&str> = sources.iter().map(|source| source.group.as_str()).collect();
    groups.sort_unstable();
    groups.dedup();
    let named = match groups.len() {
        ..=8 => groups.join(", "),
        more => format!("{}, … ({more} groups)", groups[..8].join(", ")),
    };
    format!("{} recorded trials of {named}", sources.len())
}

/// Assigns the rows of each source to the parts.
///
/// # Errors
/// [`SplitError`].
pub fn assign(sources: &[Source], split: Split) -> Result<Assignment, SplitError> {
    check(split)?;
    if split.by == By::Time {
        return Ok(in_time(sources, split));
    }
    let mut names = units(sources, split.by);
    let found = names.len();
    if found < 3 {
        return Err(SplitError::TooFew {
            by: split.by,
            found,
        });
    }
    shuffle(&mut names, split.seed);
    let count = |share: f64| ((share * found as f64).round() as usize).clamp(1, found - 2);
    let validation = count(split.validation);
    let held_out = count(split.held_out).min(found - 1 - validation);
    let held_out = names.split_off(found - held_out);
    let validation = names.split_off(names.len() - validation);
    let parts = [names, validation, held_out];
    by_unit(sources, split.by, parts, split.to_string())
}

/// Like [`assign`], with the held-out units given by name, such as one terrain of several; the
/// validation share is taken of the others, shuffled by the seed.
///
/// # Errors
/// [`SplitError`]: a unit that does not exist, none left for training or validation, or a split in
/// time, which has no units.
pub fn assign_leaving_out(
    sources: &[Source],
    split: Split,
    held_out: &[String],
) -> Result<Assignment, SplitError> {
    check(split)?;
    let all = units(sources, split.by);
    if let Some(wanted) = held_out.iter().find(|name| !all.contains(name)) {
        return Err(SplitError::Unknown {
            by: split.by,
            wanted: wanted.clone(),
            found: all.join(", "),
        });
    }
    let (left_out, mut names): (Vec<String>, Vec<String>) =
        all.into_iter().partition(|name| held_out.contains(name));
    let found = names.len();
    if left_out.is_empty() || found < 2 {
        return Err(SplitError::TooFew {
            by: split.by,
            found: found + left_out.len(),
        });
    }
    shuffle(&mut names, split.seed);
    let validation = ((split.validation * found as f64).round() as usize).clamp(1, found - 1);
    let validation = names.split_off(found - validation);
    let name = format!(
        "by {}, {} held out, {} % of the others for validation, seed {}",
        split.by,
        left_out.join(", "),
        percent(split.validation),
        split.seed
    );
    let parts = [names, validation, left_out];
    by_unit(sources, split.by, parts, name)
}

impl Assignment {
    /// The rows themselves.
    #[must_use]
    pub fn dataset(&self, sources: &[Source], description: String) -> Dataset {
        let rows = |part: usize| {
            let sources = sources.iter().zip(&self.ranges);
            sources
                .flat_map(|(source, ranges)| source.rows.rows[ranges[part].clone()].iter().copied())
                .collect()
        };
        Dataset {
            training: rows(0),
            validation: rows(1),
            held_out: rows(2),
            description,
            period_s: median_period_s(sources),
        }
    }
}

/// The median period of some recordings, s; 0 without any.
#[must_use]
pub fn median_period_s(sources: &[Source]) -> f32 {
    let mut periods_s: Vec<f32> = sources.iter().map(|source| source.rows.period_s).collect();
    periods_s.sort_by(f32::total_cmp);
    periods_s.get(periods_s.len() / 2).copied().unwrap_or(0.0)
}

fn check(split: Split) -> Result<(), SplitError> {
    let Split {
        validation,
        held_out,
        ..
    } = split;
    if validation > 0.0 && held_out > 0.0 && validation + held_out < 1.0 {
        return Ok(());
    }
    Err(SplitError::Shares {
        validation,
        held_out,
    })
}

fn unit(source: &Source, by: By) -> &str {
    match by {
        By::Robot => &source.robot,
        By::Group => &source.group,
        By::Trial | By::Time => &source.trial,
    }
}

/// Names of the units, sorted.
fn units(sources: &[Source], by: By) -> Vec<String> {
    let mut names: Vec<String> = sources.iter().map(|s| unit(s, by).to_owned()).collect();
    names.sort();
    names.dedup();
    names
}

fn shuffle(names: &mut [String], seed: u64) {
    let mut noise = Noise::new(seed, 0);
    for last in (1..names.len()).rev() {
        names.swap(last, noise.below(last + 1));
    }
}

/// Names of the parts in messages.
pub const PARTS: [&str; 3] = ["training", "validation", "held out"];

fn by_unit(
    sources: &[Source],
    by: By,
    parts: [Vec<String>; 3],
    name: String,
) -> Result<Assignment, SplitError> {
    let mut part_of = BTreeMap::new();
    for (part, names) in parts.iter().enumerate() {
        part_of.extend(names.iter().map(|name| (name.clone(), part)));
    }
    // Every unit is in a part.
    let part = |source: &Source| part_of.get(unit(source, by)).map(|part| PARTS[*part]);
    let placed = sources.iter();
    check_copies(placed.filter_map(|source| Some(Placed::new(source, part(source)?))))?;
    let mut rows = [0; 3];
    let ranges = sources.iter().map(|source| {
        let mut ranges = [0..0, 0..0, 0..0];
        if let Some(part) = part_of.get(unit(source, by)) {
            ranges[*part] = 0..source.rows.rows.len();
            rows[*part] += source.rows.rows.len();
        }
        ranges
    });
    let ranges = ranges.collect();
    let [training, validation, held_out] = parts.map(|mut names| {
        names.sort();
        names
    });
    Ok(Assignment {
        ranges,
        summary: SplitSummary {
            by,
            training,
            validation,
            held_out,
            rows,
            pause_rows: 0,
            name,
        },
    })
}

/// Duplicates of a recording are cut at the same rows, so no training row of one is held out in
/// another.
fn in_time(sources: &[Source], split: Split) -> Assignment {
    let mut rows = [0; 3];
    let mut ranges = Vec::with_capacity(sources.len());
    for source in sources {
        let found = source.rows.rows.len();
        let usable = found.saturating_sub(2 * PAUSE_ROWS);
        let count = |share: f64| (share * usable as f64).floor() as usize;
        let (validation, held_out) = (count(split.validation), count(split.held_out));
        let training = usable - validation - held_out;
        let cuts = [training, (training + PAUSE_ROWS + validation).min(found)];
        let [first, second] = cuts.map(|cut| resume(&source.rows, cut));
        let parts = [0..cuts[0], first..cuts[1].max(first), second..found];
        for (count, part) in rows.iter_mut().zip(&parts) {
            *count += part.len();
        }
        ranges.push(parts);
    }
    let found: usize = sources.iter().map(|source| source.rows.rows.len()).sum();
    Assignment {
        ranges,
        summary: SplitSummary {
            by: By::Time,
            training: sources.iter().map(|source| source.trial.clone()).collect(),
            validation: Vec::new(),
            held_out: Vec::new(),
            rows,
            pause_rows: found - rows.iter().sum::<usize>(),
            name: split.to_string(),
        },
    }
}

/// The first row after a cut that shares no reading with the rows before it: a pause of
/// [`PAUSE_ROWS`] has passed, and no window holds the reading at the cut, which a sensor that is
/// read once a second repeats for thirty rows.
fn resume(rows: &TrialRows, cut: usize) -> usize {
    let found = rows.rows.len();
    let earliest = (cut + PAUSE_ROWS).min(found);
    let Some(before) = cut.checked_sub(1).and_then(|last| rows.rows.get(last)) else {
        return earliest;
    };
    let after = &rows.rows[cut.min(found)..];
    let held = after
        .iter()
        .take_while(|row| row.target_w.to_bits() == before.target_w.to_bits())
        .count();
    match held {
        0 => earliest,
        // A row's window holds the readings of the LAGS rows before it.
        _ => (cut + held + LAGS).clamp(earliest, found),
    }
}
