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

mod source;

use std::collections::{BTreeMap, HashMap};
use std::ffi::OsStr;
use std::fmt;
use std::ops::Range;
use std::path::Path;
use std::str::FromStr;

use joulebus_predictor::LAGS;
use serde::{Deserialize, Serialize};

use crate::rows::TrialRows;
use joulebus_statistics::noise::Noise;

pub use source::{Placed, SourceInfo, describe, digest, group_of, median_period_s};

/// Minimum number of rows left out at each cut in time: the lag window and the target reading,
/// twice.
pub const PAUSE_ROWS: usize = 2 * (LAGS + 1);

/// Maximum number of consecutive rows taken from a part that is thinned: 18 minutes at 30 Hz.
pub const MAX_STRETCH_ROWS: usize = 32_768;
/// Minimum number of stretches of such rows.
const MIN_STRETCHES: usize = 64;

/// Unit of the split, which stays in one part.
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
    /// Share held out, above 0. Together with `validation` below 1.
    pub held_out: f64,
    /// Seed of the shuffle of units. Unused by a split in time.
    pub seed: u64,
}

impl Default for Split {
    /// A split by trial with 15 % for validation and 15 % held out.
    fn default() -> Self {
        Self { by: By::Trial, validation: 0.15, held_out: 0.15, seed: 0 }
    }
}

impl fmt::Display for Split {
    /// `by trial, 15 % for validation, 15 % held out, seed 0`
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { by, validation, held_out, seed } = self;
        let (validation, held_out) = (percent(*validation), percent(*held_out));
        write!(out, "by {by}, {validation} % for validation, {held_out} % held out")?;
        match by {
            By::Time => write!(out, ", {PAUSE_ROWS} rows or more between"),
            _ => write!(out, ", seed {seed}"),
        }
    }
}

impl Split {
    /// The spelling in a model's file: `split by trial, seed 0`.
    pub fn origin(&self) -> String {
        match self.by {
            By::Time => format!("split by {}", self.by),
            by => format!("split by {by}, seed {}", self.seed),
        }
    }
}

/// To three decimals.
fn percent(share: f64) -> f64 {
    (share * 1e5).round() / 1e3
}

/// The rows of each trial in each part.
#[derive(Debug, Clone, PartialEq)]
pub struct Assignment {
    /// For each source in order, its row ranges: training, validation, held out.
    pub ranges: Vec<[Range<usize>; 3]>,
    /// Names of the units in each part.
    pub summary: SplitSummary,
}

/// The rows of each trial that are taken of each part.
#[derive(Debug, Clone, PartialEq)]
pub struct Thinned {
    /// For each source in order, its row ranges, ascending: training, validation, held out.
    pub ranges: Vec<[Vec<Range<usize>>; 3]>,
    /// Rows per part.
    pub rows: [usize; 3],
}

/// Names of the units in each part, and numbers of rows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SplitSummary {
    /// Unit of the split.
    pub by: By,
    /// Names of the units for training. For a split in time the trials, once.
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

/// Reason that a split is not possible.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum SplitError {
    #[error(
        "validation = {validation}, held_out = {held_out}: allowed are shares above 0 that come to \
         less than 1 together"
    )]
    Shares { validation: f64, held_out: f64 },
    #[error("found no {by} {wanted:?}, there are {found}")]
    Unknown { by: By, wanted: String, found: String },
    #[error(
        "found {found} {by}s, at least 3 are needed, one a part. Name more recordings, or split by \
         time"
    )]
    TooFew { by: By, found: usize },
    #[error("{names}: no other recording is left to learn from. Name fewer, or more recordings")]
    NothingLeft { names: String },
    #[error(
        "{}, {} and {}: {rows} rows. A model must not be scored on its training rows: leave one of them out",
        in_two_parts(trials), parts[0], parts[1]
    )]
    Copy {
        /// The trials. The same name twice if it was given twice.
        trials: [String; 2],
        parts: [&'static str; 2],
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

/// Refuses rows that are in two parts: a recording may exist twice, under two names. Trials without
/// rows are ignored.
///
/// # Errors
/// [`SplitError::Copy`] with the first duplicate.
pub fn check_copies<'a>(placed: impl IntoIterator<Item = Placed<'a>>) -> Result<(), SplitError> {
    let mut first_with: HashMap<[u8; 32], Placed<'a>> = HashMap::new();
    for one in placed.into_iter().filter(|one| one.rows > 0) {
        let first = *first_with.entry(one.digest).or_insert(one);
        if first.part != one.part {
            return Err(SplitError::Copy {
                trials: [first, one].map(|placed| placed.trial.to_owned()),
                parts: [first.part, one.part],
                rows: one.rows,
            });
        }
    }
    Ok(())
}

/// Assigns whole trials, whose parts are given: training, validation, held out. The ranges are of
/// the trials in this order.
///
/// # Errors
/// [`SplitError::Copy`]: the same rows are in two parts.
pub fn assign_given(parts: [&[SourceInfo]; 3]) -> Result<Assignment, SplitError> {
    let placed = parts.into_iter().zip(PARTS).flat_map(|(sources, part)| {
        let place = move |source| Placed::new(source, part);
        sources.iter().map(place)
    });
    check_copies(placed)?;
    let [training, validation, held_out] =
        parts.map(|part| part.iter().map(|source| source.trial.clone()).collect());
    let rows = parts.map(|part| part.iter().map(|source| source.rows).sum());
    let ranges = parts.into_iter().enumerate().flat_map(|(part, sources)| {
        sources.iter().map(move |source| {
            let mut ranges = [0..0, 0..0, 0..0];
            ranges[part] = 0..source.rows;
            ranges
        })
    });
    Ok(Assignment {
        ranges: ranges.collect(),
        summary: SplitSummary {
            by: By::Trial,
            training,
            validation,
            held_out,
            rows,
            pause_rows: 0,
            name: "given individually".to_owned(),
        },
    })
}

/// Assigns the rows of each source to the parts. Only a split in time calls `resume_at`, once for
/// each trial that has rows. Given its index and its two cuts, it returns where the rows continue
/// after them ([`resume`]).
///
/// # Errors
/// [`SplitError`], and those of `resume_at`.
pub fn assign<E: From<SplitError>>(
    sources: &[SourceInfo],
    split: Split,
    resume_at: impl FnMut(usize, [usize; 2]) -> Result<[usize; 2], E>,
) -> Result<Assignment, E> {
    check(split)?;
    match split.by {
        By::Time => in_time(sources, split, resume_at),
        _ => Ok(assign_units(sources, split)?),
    }
}

fn assign_units(sources: &[SourceInfo], split: Split) -> Result<Assignment, SplitError> {
    let mut names = units(sources, split.by);
    let found = names.len();
    if found < 3 {
        return Err(SplitError::TooFew { by: split.by, found });
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

/// Same as [`assign`], with the held-out units given by name, such as one terrain of several. The
/// validation share is taken from the others, shuffled by the seed.
///
/// # Errors
/// [`SplitError`]: a unit that does not exist, none left for training or validation, or a split in
/// time, which has no units.
pub fn assign_leaving_out(
    sources: &[SourceInfo],
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
        return Err(SplitError::TooFew { by: split.by, found: found + left_out.len() });
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

/// Finds the sources that a shift leaves out: those of a group, a folder, a robot or a trial of
/// these names.
///
/// # Errors
/// [`SplitError`]: a name that none has, or none is left.
pub fn left_out(sources: &[SourceInfo], names: &[String]) -> Result<Vec<bool>, SplitError> {
    let has = |source: &SourceInfo, name: &String| {
        let path = Path::new(&source.trial);
        let folder = path.parent().and_then(Path::file_name).and_then(OsStr::to_str);
        let file = path.file_name().and_then(OsStr::to_str);
        let own = [Some(source.group.as_str()), folder, Some(&source.robot), Some(&source.trial)];
        own.contains(&Some(name)) || file == Some(name)
    };
    if let Some(wanted) = names.iter().find(|name| !sources.iter().any(|one| has(one, name))) {
        let found = units(sources, By::Group).join(", ");
        return Err(SplitError::Unknown { by: By::Group, wanted: wanted.clone(), found });
    }
    let is_out = |source: &SourceInfo| names.iter().any(|name| has(source, name));
    let is_out: Vec<bool> = sources.iter().map(is_out).collect();
    if is_out.iter().all(|out| *out) {
        return Err(SplitError::NothingLeft { names: names.join(", ") });
    }
    let placed = sources.iter().zip(&is_out);
    check_copies(placed.map(|(source, out)| Placed::new(source, PARTS[2 * usize::from(*out)])))?;
    Ok(is_out)
}

impl Assignment {
    /// All rows, or, if there are more than `max_rows`, about as many of each part as its share of
    /// them. They are stretches of at most [`MAX_STRETCH_ROWS`] consecutive rows, evenly spread
    /// over the part, at least one of each part.
    pub fn thin(&self, max_rows: usize) -> Thinned {
        let found: usize = self.summary.rows.iter().sum();
        let stretch = match found > max_rows {
            true => (max_rows / MIN_STRETCHES).clamp(1, MAX_STRETCH_ROWS),
            false => found.max(1),
        };
        let mut rows = [0; 3];
        let mut ranges = vec![[Vec::new(), Vec::new(), Vec::new()]; self.ranges.len()];
        for (part, count) in rows.iter_mut().enumerate() {
            let of_part = self.ranges.iter().map(|ranges| ranges[part].clone());
            let each = of_part.enumerate().flat_map(|(source, range)| {
                let starts = range.clone().step_by(stretch);
                starts.map(move |start| (source, start..range.end.min(start + stretch)))
            });
            let each: Vec<(usize, Range<usize>)> = each.collect();
            let wanted = match found > max_rows {
                true => (each.len() * max_rows / found).max(1),
                false => each.len(),
            };
            for (at, (source, range)) in each.iter().enumerate() {
                if at * wanted / each.len() < (at + 1) * wanted / each.len() {
                    *count += range.len();
                    ranges[*source][part].push(range.clone());
                }
            }
        }
        Thinned { ranges, rows }
    }
}

fn check(split: Split) -> Result<(), SplitError> {
    let Split { validation, held_out, .. } = split;
    if validation > 0.0 && held_out > 0.0 && validation + held_out < 1.0 {
        return Ok(());
    }
    Err(SplitError::Shares { validation, held_out })
}

fn unit(source: &SourceInfo, by: By) -> &str {
    match by {
        By::Robot => &source.robot,
        By::Group => &source.group,
        By::Trial | By::Time => &source.trial,
    }
}

/// Names of the units, sorted.
fn units(sources: &[SourceInfo], by: By) -> Vec<String> {
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
    sources: &[SourceInfo],
    by: By,
    parts: [Vec<String>; 3],
    name: String,
) -> Result<Assignment, SplitError> {
    let mut part_of = BTreeMap::new();
    for (part, names) in parts.iter().enumerate() {
        part_of.extend(names.iter().map(|name| (name.clone(), part)));
    }
    // Every unit is in a part.
    let part = |source: &SourceInfo| part_of.get(unit(source, by)).map(|part| PARTS[*part]);
    let placed = sources.iter();
    check_copies(placed.filter_map(|source| Some(Placed::new(source, part(source)?))))?;
    let mut rows = [0; 3];
    let ranges = sources.iter().map(|source| {
        let mut ranges = [0..0, 0..0, 0..0];
        if let Some(part) = part_of.get(unit(source, by)) {
            ranges[*part] = 0..source.rows;
            rows[*part] += source.rows;
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
        summary: SplitSummary { by, training, validation, held_out, rows, pause_rows: 0, name },
    })
}

/// Duplicates of a recording are cut at the same rows, so no training row of one is held out in
/// another. Successive sources of a robot in one file, such as the parts of a long recording, are
/// cut as one: else a later part's training rows would follow an earlier one's held-out rows.
fn in_time<E>(
    sources: &[SourceInfo],
    split: Split,
    mut resume_at: impl FnMut(usize, [usize; 2]) -> Result<[usize; 2], E>,
) -> Result<Assignment, E> {
    let mut rows = [0; 3];
    let mut ranges = Vec::with_capacity(sources.len());
    let is_same = |one: &SourceInfo, next: &SourceInfo| {
        (&one.trial, &one.robot) == (&next.trial, &next.robot)
    };
    for parts in sources.chunk_by(is_same) {
        let from = ranges.len();
        let found = parts.iter().map(|part| part.rows).sum::<usize>();
        let usable = found.saturating_sub(2 * PAUSE_ROWS);
        let count = |share: f64| (share * usable as f64).floor() as usize;
        let (validation, held_out) = (count(split.validation), count(split.held_out));
        let training = usable - validation - held_out;
        let cuts = [training, (training + PAUSE_ROWS + validation).min(found)];
        // The part that a cut lies in states where the rows continue after it.
        let (mut resumed, mut begin) = (cuts, 0);
        for (at, part) in (from..).zip(parts) {
            let end = begin + part.rows;
            let is_in = cuts.map(|cut| begin <= cut && (cut < end || end == found));
            if part.rows > 0 && is_in.contains(&true) {
                let own = cuts.map(|cut| cut.clamp(begin, end) - begin);
                let own = resume_at(at, own)?;
                for cut in (0..2).filter(|cut| is_in[*cut]) {
                    resumed[cut] = begin + own[cut];
                }
            }
            begin = end;
        }
        let [first, second] = resumed;
        let whole = [0..cuts[0], first..cuts[1].max(first), second..found];
        let mut begin = 0;
        for part in parts {
            let own = whole.clone().map(|range| {
                let within = |row: usize| row.clamp(begin, begin + part.rows) - begin;
                within(range.start)..within(range.end)
            });
            for (count, own) in rows.iter_mut().zip(&own) {
                *count += own.len();
            }
            ranges.push(own);
            begin += part.rows;
        }
    }
    let found: usize = sources.iter().map(|source| source.rows).sum();
    Ok(Assignment {
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
    })
}

/// The first rows after two cuts that share no reading with the rows before them: a pause of
/// [`PAUSE_ROWS`] has passed, and no window holds the reading at the cut, which a sensor that is
/// read once a second repeats for thirty rows.
pub fn resume(rows: &TrialRows, cuts: [usize; 2]) -> [usize; 2] {
    cuts.map(|cut| resume_after(rows, cut))
}

fn resume_after(rows: &TrialRows, cut: usize) -> usize {
    let found = rows.rows.len();
    let earliest = (cut + PAUSE_ROWS).min(found);
    let Some(before) = cut.checked_sub(1).and_then(|last| rows.rows.get(last)) else {
        return earliest;
    };
    let after = &rows.rows[cut.min(found)..];
    let held =
        after.iter().take_while(|row| row.target_w.to_bits() == before.target_w.to_bits()).count();
    match held {
        0 => earliest,
        // A row's window holds the readings of the LAGS rows before it.
        _ => (cut + held + LAGS).clamp(earliest, found),
    }
}
