//! The sums of all recordings, which are merged into every table.

use std::collections::{BTreeMap, HashMap};
use std::io;
use std::ops::Range;

use serde::Serialize;

use super::Recording;
use super::blocks::{Block, Sums};
use super::kept::Kept;
use joulebus_statistics::bootstrap::Bootstrap;
use joulebus_statistics::metrics::{CoverageTally, ResidualQuantiles, Tally};
use joulebus_statistics::order::residual_quantiles;

/// A constant interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ConstantInterval {
    /// Its width, W.
    pub width_w: f64,
    /// Its mean interval score, W.
    pub score_w: f64,
}

/// Blocks above which neighbours are joined: some 10 MB of sums, and as many for each table that is
/// resampled.
const MAX_BLOCKS: usize = 16_384;

/// The sums of all recordings that have rows to evaluate.
#[derive(Debug, Default)]
pub(crate) struct Tallied {
    recordings: Vec<Named>,
    /// Blocks of all recordings.
    blocks: usize,
    /// Number of times that neighbouring blocks were joined in pairs.
    joined: u32,
    residuals: Kept,
}

#[derive(Debug)]
struct Named {
    listed: Listed,
    blocks: Vec<Block>,
    /// Positions of the residuals of each forecaster.
    residuals: Vec<Range<u64>>,
}

/// The contents of tables about a recording, beside its sums.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Listed {
    pub(crate) name: String,
    robot: String,
    group: String,
    period_s: f64,
    /// Rows of the trial.
    pub(crate) rows: usize,
    /// Hash of the rows with a forecast.
    digest: [u8; 32],
}

impl Listed {
    pub(crate) fn new(recording: &Recording) -> Self {
        Self {
            name: recording.name.clone(),
            robot: recording.robot.clone(),
            group: recording.group.clone(),
            period_s: recording.period_ns() as f64 * 1e-9,
            rows: recording.trial_rows(),
            digest: recording.digest(),
        }
    }
}

/// Recordings scored together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Set {
    pub(crate) name: String,
    /// Indices of each trial's recordings. The runs of a robot in one capture have one name: they
    /// share its floor and load, so they are one trial.
    trials: Vec<Vec<usize>>,
}

impl Set {
    pub(crate) fn trials(&self) -> usize {
        self.trials.len()
    }
}

impl Tallied {
    /// Adds the sums of the next recording, if it has any.
    ///
    /// # Errors
    /// The recording's residuals cannot be kept in a temporary file.
    pub(crate) fn push(&mut self, listed: &Listed, sums: Sums) -> io::Result<()> {
        let Sums { mut blocks, residuals_w } = sums;
        if blocks.is_empty() {
            return Ok(());
        }
        // As if it had been there before the others were joined: the sums do not depend on the time
        // of joining.
        (0..self.joined).for_each(|_| Block::join_pairs(&mut blocks));
        let residuals = residuals_w.iter().map(|own| self.residuals.push(own));
        let residuals = residuals.collect::<io::Result<_>>()?;
        self.blocks += blocks.len();
        self.recordings.push(Named { listed: listed.clone(), blocks, residuals });
        // A recording keeps one block, however many there are.
        while self.blocks > MAX_BLOCKS.max(2 * self.recordings.len()) {
            self.joined += 1;
            let each = self.recordings.iter_mut();
            each.for_each(|named| Block::join_pairs(&mut named.blocks));
            self.blocks = self.recordings.iter().map(|named| named.blocks.len()).sum();
        }
        Ok(())
    }

    /// Rows that were scored.
    pub(crate) fn rows(&self) -> u64 {
        let blocks = self.recordings.iter().flat_map(|named| &named.blocks);
        let first = blocks.filter_map(|block| block.forecasters.first());
        first.map(Tally::count).sum()
    }

    /// Median period of the recordings, s.
    pub(crate) fn period_s(&self) -> f64 {
        let periods = self.recordings.iter().map(|named| named.listed.period_s);
        joulebus_statistics::metrics::quantile(&joulebus_statistics::metrics::sorted(periods), 0.5)
    }

    pub(crate) fn all(&self) -> Set {
        self.set("all", 0..self.recordings.len())
    }

    pub(crate) fn trials(&self) -> Vec<Set> {
        let name = |trial: &Vec<usize>| self.recordings[trial[0]].listed.name.clone();
        let trials = self.all().trials.into_iter();
        trials.map(|trial| Set { name: name(&trial), trials: vec![trial] }).collect()
    }

    pub(crate) fn groups(&self) -> Vec<Set> {
        self.by(|named| &named.listed.group)
    }

    pub(crate) fn robots(&self) -> Vec<Set> {
        self.by(|named| &named.listed.robot)
    }

    fn by(&self, name: fn(&Named) -> &String) -> Vec<Set> {
        let mut sets: BTreeMap<&String, Vec<usize>> = BTreeMap::new();
        for (at, named) in self.recordings.iter().enumerate() {
            sets.entry(name(named)).or_default().push(at);
        }
        sets.into_iter().map(|(name, places)| self.set(name, places)).collect()
    }

    /// Recordings as trials, in the order of their first ones.
    fn set(&self, name: &str, places: impl IntoIterator<Item = usize>) -> Set {
        let mut named: HashMap<&str, usize> = HashMap::new();
        let mut trials: Vec<Vec<usize>> = Vec::new();
        for at in places {
            let trial = *named.entry(&self.recordings[at].listed.name).or_insert(trials.len());
            if trial == trials.len() {
                trials.push(Vec::new());
            }
            trials[trial].push(at);
        }
        Set { name: name.to_owned(), trials }
    }

    fn of<'a>(&'a self, set: &'a Set) -> impl Iterator<Item = &'a Named> {
        set.trials.iter().flatten().map(|at| &self.recordings[*at])
    }

    /// One block for each trial.
    pub(crate) fn whole_trials(&self, set: &Set) -> Vec<Block> {
        let blocks = |trial: &Vec<usize>| {
            Block::merged(trial.iter().flat_map(|at| &self.recordings[*at].blocks))
        };
        set.trials.iter().map(blocks).collect()
    }

    /// The blocks to resample, and whether each is a whole trial.
    pub(crate) fn blocks(&self, set: &Set, bootstrap: &Bootstrap) -> (Vec<Block>, bool) {
        let whole = set.trials() >= bootstrap.trials_from;
        let blocks = if whole {
            self.whole_trials(set)
        } else {
            let blocks = self.of(set).flat_map(|named| &named.blocks);
            blocks.cloned().collect()
        };
        (blocks, whole)
    }

    /// Quantiles of a forecaster's residuals, and the constant interval from 5 to 95 % of them.
    ///
    /// # Errors
    /// The temporary file cannot be read.
    pub(crate) fn residuals(
        &self,
        set: &Set,
        forecaster: usize,
    ) -> io::Result<(ResidualQuantiles, ConstantInterval)> {
        let each = |take: &mut dyn FnMut(f32)| {
            let mut ranges = self.of(set).filter_map(|named| named.residuals.get(forecaster));
            ranges.try_for_each(|range| self.residuals.each(range, take))
        };
        let quantiles = residual_quantiles(each)?;
        let mut interval = CoverageTally::default();
        each(&mut |residual_w| interval.add(residual_w.into(), quantiles.q05_w, quantiles.q95_w))?;
        let (width_w, score_w) = (interval.width_w(), interval.score_w(0.9));
        Ok((quantiles, ConstantInterval { width_w, score_w }))
    }
}
