//! Which rows decide the weights, which when to stop, and which decide nothing.
//!
//! Neighbouring rows know each other's answers, so rows are never dealt out one by one: whole
//! trials, robots or groups of trials go to one part, or each trial is cut in time with a pause
//! between the parts that is longer than the lag window.

use std::collections::BTreeMap;
use std::fmt;

use joulebus_predictor::LAGS;
use serde::{Deserialize, Serialize};

use crate::noise::Noise;
use crate::rows::TrialRows;
use crate::train::{Dataset, Row};

/// Rows left out at each cut in time: the lag window, the reading that is learned, and as many
/// again.
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

/// What went where.
#[derive(Debug, Clone, PartialEq, Serialize)]
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
}

/// Why a split is not possible.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
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

/// Deals the rows out. `description` says where they come from; what went where is added to it.
///
/// # Errors
/// [`SplitError`].
pub fn split(
    sources: &[Source],
    split: Split,
    description: &str,
) -> Result<(Dataset, Dealt), SplitError> {
    let Split {
        by,
        validation,
        held_out,
        ..
    } = split;
    if !(validation > 0.0 && held_out > 0.0 && validation + held_out < 1.0) {
        return Err(SplitError::Shares {
            validation,
            held_out,
        });
    }
    let (parts, mut dealt) = match by {
        By::Time => in_time(sources, split),
        By::Trial | By::Robot | By::Group => by_unit(sources, split)?,
    };
    let [training, validation, held_out] = parts;
    dealt.rows = [training.len(), validation.len(), held_out.len()];
    let seed = match by {
        By::Time => String::new(),
        _ => format!(", seed {}", split.seed),
    };
    let dataset = Dataset {
        training,
        validation,
        held_out,
        description: format!("{description}; split by {by}{seed}"),
    };
    Ok((dataset, dealt))
}

fn by_unit(sources: &[Source], split: Split) -> Result<([Vec<Row>; 3], Dealt), SplitError> {
    let unit = |source: &Source| match split.by {
        By::Robot => source.robot.clone(),
        By::Group => source.group.clone(),
        By::Trial | By::Time => source.trial.clone(),
    };
    let mut units: BTreeMap<String, Vec<&Source>> = BTreeMap::new();
    for source in sources {
        units.entry(unit(source)).or_default().push(source);
    }
    let found = units.len();
    if found < 3 {
        return Err(SplitError::TooFew {
            by: split.by,
            found,
        });
    }
    let mut names: Vec<String> = units.keys().cloned().collect();
    let mut noise = Noise::new(split.seed, 0);
    for last in (1..found).rev() {
        names.swap(last, noise.below(last + 1));
    }
    let count = |share: f64| ((share * found as f64).round() as usize).clamp(1, found - 2);
    let validation = count(split.validation);
    let held_out = count(split.held_out).min(found - 1 - validation);
    let mut held_out = names.split_off(found - held_out);
    let mut validation = names.split_off(names.len() - validation);
    for part in [&mut names, &mut validation, &mut held_out] {
        part.sort();
    }
    let rows = |part: &[String]| -> Vec<Row> {
        let sources = part.iter().flat_map(|name| &units[name]);
        sources
            .flat_map(|source| source.rows.rows.iter().copied())
            .collect()
    };
    let parts = [rows(&names), rows(&validation), rows(&held_out)];
    let dealt = Dealt {
        by: split.by,
        training: names,
        validation,
        held_out,
        rows: [0; 3],
        pause_rows: 0,
    };
    Ok((parts, dealt))
}

fn in_time(sources: &[Source], split: Split) -> ([Vec<Row>; 3], Dealt) {
    let mut parts = [Vec::new(), Vec::new(), Vec::new()];
    let mut pause_rows = 0;
    for source in sources {
        let rows = &source.rows.rows;
        let usable = rows.len().saturating_sub(2 * PAUSE_ROWS);
        let count = |share: f64| (share * usable as f64).floor() as usize;
        let (validation, held_out) = (count(split.validation), count(split.held_out));
        let training = usable - validation - held_out;
        let mut from = 0;
        for (part, count) in parts.iter_mut().zip([training, validation, held_out]) {
            part.extend_from_slice(&rows[from..from + count]);
            from += count + PAUSE_ROWS;
        }
        pause_rows += rows.len() - usable;
    }
    let dealt = Dealt {
        by: By::Time,
        training: sources.iter().map(|source| source.trial.clone()).collect(),
        validation: Vec::new(),
        held_out: Vec::new(),
        rows: [0; 3],
        pause_rows,
    };
    (parts, dealt)
}
