//! Which rows decide the weights, which when to stop, and which decide nothing.
//!
//! Neighbouring rows know each other's answers, so rows are never dealt out one by one: whole
//! trials, robots or groups of trials go to one part, or each trial is cut in time with a pause
//! between the parts that is longer than the lag window, and lasts until the reading that stood at
//! the cut, if the sensor held it, is in no window any more.
//!
//! A recording that lies there twice, as two files, would be learned from and scored on all the same:
//! where its rows come to lie in two parts the split is refused. Leaving one file out by itself would
//! change which units there are, and so the whole split, unseen.

use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::ops::Range;

use joulebus_predictor::LAGS;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::rows::{Dataset, TrialRows};
use joulebus_statistics::noise::Noise;

/// Rows left out at each cut in time, at least: the lag window, the reading that is learned, and as
/// many again.
pub const PAUSE_ROWS: usize = 2 * (LAGS + 1);

/// What stays together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum By {
    /// Each trial.
    Trial,
    /// All trials of a robot.
    Robot,
    /// All trials of a group: the same surface, terrain or load.
    Group,
    /// The first part of every trial is learned from, the last is held out.
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

/// How to split.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Split {
    /// What stays together.
    pub by: By,
    /// Share of the units (or, in time, of each trial's rows) that decides when to stop, above 0.
    pub validation: f64,
    /// Share that decides nothing, above 0; together with `validation` below 1.
    pub held_out: f64,
    /// Seed of the order in which units are dealt out; a split in time needs none.
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

/// To three digits after the point.
fn percent(share: f64) -> f64 {
    (share * 1e5).round() / 1e3
}

/// A trial's rows and where they belong.
#[derive(Debug, Clone)]
pub struct Source {
    /// The trial's name: its file.
    pub trial: String,
    /// The robot's name.
    pub robot: String,
    /// The group's name: [`group_of`] its file.
    pub group: String,
    /// Its rows.
    pub rows: TrialRows,
}

/// A trial in one of several parts that must not share a row.
#[derive(Debug, Clone, Copy)]
pub struct Placed<'a> {
    /// The trial's name: its file.
    pub trial: &'a str,
    /// Its rows.
    pub rows: &'a TrialRows,
    /// The part, as a message has it.
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

/// Which rows of each trial are of which part.
#[derive(Debug, Clone, PartialEq)]
pub struct Deal {
    /// For each source in order: its rows of training, validation, and held out.
    pub ranges: Vec<[Range<usize>; 3]>,
    /// What went where, with names.
    pub dealt: Dealt,
}

/// What went where.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Dealt {
    /// What stayed together.
    pub by: By,
    /// Names of the units of each part; for a split in time the trials, once.
    pub training: Vec<String>,
    /// Units that decide when to stop.
    pub validation: Vec<String>,
    /// Units that decide nothing.
    pub held_out: Vec<String>,
    /// Rows of each part: training, validation, held out.
    pub rows: [usize; 3],
    /// Rows in no part, at the cuts in time.
    pub pause_rows: usize,
    /// The split in words.
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
    /// A unit that is to be held out is not there.
    #[error("found no {by} {wanted:?}; there are {found}")]
    Unknown {
        /// What stays together.
        by: By,
        /// The name asked for.
        wanted: String,
        /// The names that there are.
        found: String,
    },
    /// There are too few units.
    #[error(
        "found {found} {by}s, at least 3 are needed, one a part; name more recordings, or split by \
         time"
    )]
    TooFew {
        /// What stays together.
        by: By,
        /// Units found.
        found: usize,
    },
    /// The same rows would be learned from and scored on.
    #[error(
        "{}, {} and {}: {rows} rows. A model must not learn what it is scored on: leave one of them out",
        in_two_parts(trials), parts[0], parts[1]
    )]
    Copy {
        /// The trials; the same twice, if it was named twice.
        trials: [String; 2],
        /// The part of each.
        parts: [&'static str; 2],
        /// Their rows.
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

/// The group that a file belongs to: its name without what numbers it. `ICE_03.csv.gz` and
/// `ICE_04.csv.gz` are of the group `ICE`.
#[must_use]
pub fn group_of(file_name: &str) -> String {
    let stem = file_name.split('.').next().unwrap_or(file_name);
    let name = stem.trim_end_matches(|c: char| c.is_ascii_digit());
    let name = name.trim_end_matches(['_', '-', ' ']);
    if name.is_empty() { stem } else { name }.to_owned()
}

/// Refuses rows that stand in two parts: a recording may be there twice, under two names. Trials without
/// rows count for nothing.
///
/// # Errors
/// [`SplitError::Copy`], the first that is found.
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

/// Of all that is learned from rows.
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

/// Deals the rows out. `description` says where they come from; how they were split is added to it.
///
/// # Errors
/// [`SplitError`].
pub fn split(
    sources: &[Source],
    split: Split,
    description: &str,
) -> Result<(Dataset, Dealt), SplitError> {
    let deal = deal(sources, split)?;
    let seed = match split.by {
        By::Time => String::new(),
        _ => format!(", seed {}", split.seed),
    };
    let description = format!("{description}; split by {}{seed}", split.by);
    Ok((deal.dataset(sources, description), deal.dealt))
}

/// Which rows of each source go where.
///
/// # Errors
/// [`SplitError`].
pub fn deal(sources: &[Source], split: Split) -> Result<Deal, SplitError> {
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

/// The same with the units named that are held out, such as one terrain of several; the share for
/// validation is of the others, in the order of the seed.
///
/// # Errors
/// [`SplitError`]: a unit that is not there, or none left to learn from and none to stop by; time
/// has no units.
pub fn deal_leaving_out(
    sources: &[Source],
    split: Split,
    held_out: &[String],
) -> Result<Deal, SplitError> {
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

impl Deal {
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
        }
    }
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

/// The units' names, sorted.
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
) -> Result<Deal, SplitError> {
    let mut part_of = BTreeMap::new();
    for (part, names) in parts.iter().enumerate() {
        part_of.extend(names.iter().map(|name| (name.clone(), part)));
    }
    // Every unit was dealt to a part.
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
    Ok(Deal {
        ranges,
        dealt: Dealt {
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

/// Copies of a recording are cut at the same rows: what is learned from one is held out of none.
fn in_time(sources: &[Source], split: Split) -> Deal {
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
    Deal {
        ranges,
        dealt: Dealt {
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
/// [`PAUSE_ROWS`] has passed, and no window holds the reading that stood at the cut, which a sensor
/// that is read once a second returns for thirty rows.
fn resume(rows: &TrialRows, cut: usize) -> usize {
    let found = rows.rows.len();
    let earliest = (cut + PAUSE_ROWS).min(found);
    let Some(before) = cut.checked_sub(1).and_then(|last| rows.rows.get(last)) else {
        return earliest;
    };
    let after = &rows.rows[cut.min(found)..];
    let stands = after
        .iter()
        .take_while(|row| row.target_w.to_bits() == before.target_w.to_bits())
        .count();
    match stands {
        0 => earliest,
        // A row's window holds the readings of the LAGS rows before it.
        _ => (cut + stands + LAGS).clamp(earliest, found),
    }
}
