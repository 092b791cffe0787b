//! Sums of each recording, which are merged into every table.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::Recording;
use joulebus_dataset::split::digest;
use joulebus_statistics::bootstrap::Bootstrap;
use joulebus_statistics::metrics::{Additive, CoverageTally, Tally};

/// Sums of one recording.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Sums {
    /// Blocks of consecutive rows, in order.
    pub(crate) blocks: Vec<Block>,
    /// Residuals of each forecaster, W, ascending; of scored rows only.
    pub(crate) residuals_w: Vec<Vec<f32>>,
    /// One entry per horizon.
    pub(crate) horizons: Vec<HorizonSums>,
}

/// A block of consecutive rows.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Block {
    /// One entry per forecaster: the models, persistence, the linear baselines, the models' members.
    pub(crate) forecasters: Vec<Tally>,
    /// One entry per model.
    pub(crate) intervals: Vec<CoverageTally>,
}

/// All origins at one horizon; one entry per forecaster.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct HorizonSums {
    /// The reading at the horizon.
    pub(crate) power: Vec<Tally>,
    /// The energy up to the horizon, in J instead of W.
    pub(crate) energy: Vec<Tally>,
}

impl Block {
    fn merge(&mut self, other: &Block) {
        if self.forecasters.is_empty() {
            self.clone_from(other);
            return;
        }
        for (own, other) in self.forecasters.iter_mut().zip(&other.forecasters) {
            own.merge(other);
        }
        for (own, other) in self.intervals.iter_mut().zip(&other.intervals) {
            own.merge(other);
        }
    }

    /// The sum of some blocks, in order.
    pub(crate) fn merged<'a>(blocks: impl IntoIterator<Item = &'a Block>) -> Block {
        let mut merged = Block::default();
        for block in blocks {
            merged.merge(block);
        }
        merged
    }
}

/// Blocks for resampling, contiguous in memory.
pub(crate) struct Draws {
    centre_w: f64,
    forecasters: usize,
    /// Tallies of each block: forecasters, then intervals.
    each: usize,
    sums: Vec<Additive>,
}

impl Draws {
    pub(crate) fn new(blocks: &[Block]) -> Self {
        let (forecasters, intervals) = match blocks.first() {
            Some(first) => (first.forecasters.len(), first.intervals.len()),
            None => (0, 0),
        };
        let first = Block::merged(blocks).forecasters.into_iter().next();
        let centre_w = first.map_or(0.0, |tally| tally.reading_mean_w());
        let centre_w = if centre_w.is_finite() { centre_w } else { 0.0 };
        let mut sums = Vec::with_capacity(blocks.len() * (forecasters + intervals));
        for block in blocks {
            sums.extend(
                block
                    .forecasters
                    .iter()
                    .map(|tally| tally.additive(centre_w)),
            );
            sums.extend(block.intervals.iter().map(CoverageTally::additive));
        }
        Self {
            centre_w,
            forecasters,
            each: forecasters + intervals,
            sums,
        }
    }

    /// The sum of some blocks, possibly repeated.
    pub(crate) fn merged(&self, drawn: &[usize]) -> Block {
        let mut total = vec![[0.0; 8]; self.each];
        for block in drawn {
            let sums = &self.sums[block * self.each..][..self.each];
            for (total, sums) in total.iter_mut().zip(sums) {
                for (total, sum) in total.iter_mut().zip(sums) {
                    *total += sum;
                }
            }
        }
        let (tallies, intervals) = total.split_at(self.forecasters);
        let tally = |sums| Tally::of_additive(sums, self.centre_w);
        Block {
            forecasters: tallies.iter().map(tally).collect(),
            intervals: intervals.iter().map(CoverageTally::of_additive).collect(),
        }
    }
}

impl HorizonSums {
    /// Powers and then energies as the forecasters of a block.
    pub(crate) fn block(&self) -> Block {
        Block {
            forecasters: self.power.iter().chain(&self.energy).copied().collect(),
            intervals: Vec::new(),
        }
    }

    fn merge(&mut self, other: &HorizonSums) {
        if self.power.is_empty() {
            self.clone_from(other);
            return;
        }
        for (own, other) in self.power.iter_mut().zip(&other.power) {
            own.merge(other);
        }
        for (own, other) in self.energy.iter_mut().zip(&other.energy) {
            own.merge(other);
        }
    }

    /// The sum of some horizons' sums, in order.
    pub(crate) fn merged<'a>(sums: impl IntoIterator<Item = &'a HorizonSums>) -> HorizonSums {
        let mut merged = HorizonSums::default();
        for sums in sums {
            merged.merge(sums);
        }
        merged
    }
}

/// The sums of all recordings that have rows to evaluate.
#[derive(Debug, Clone)]
pub(crate) struct Tallied {
    recordings: Vec<Named>,
}

#[derive(Debug, Clone)]
struct Named {
    listed: Listed,
    sums: Sums,
}

/// What tables need of a recording beside its sums.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
    pub(crate) fn of(recording: &Recording) -> Self {
        Self {
            name: recording.name.clone(),
            robot: recording.robot.clone(),
            group: recording.group.clone(),
            period_s: recording.trial.period_ns() as f64 * 1e-9,
            rows: recording.trial.rows(),
            digest: digest(&recording.rows),
        }
    }
}

/// Recordings scored together, by index.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Set {
    pub(crate) name: String,
    places: Vec<usize>,
}

impl Set {
    pub(crate) fn trials(&self) -> usize {
        self.places.len()
    }
}

impl Tallied {
    /// `sums` correspond to `recordings` by index.
    pub(crate) fn new(recordings: &[Listed], sums: Vec<Sums>) -> Self {
        let pairs = recordings.iter().zip(sums);
        let evaluated = pairs.filter(|(_, sums)| !sums.blocks.is_empty());
        let named = evaluated.map(|(listed, sums)| Named {
            listed: listed.clone(),
            sums,
        });
        Self {
            recordings: named.collect(),
        }
    }

    /// Rows that were scored.
    pub(crate) fn rows(&self) -> u64 {
        let blocks = self.recordings.iter().flat_map(|named| &named.sums.blocks);
        let first = blocks.filter_map(|block| block.forecasters.first());
        first.map(Tally::count).sum()
    }

    /// Median period of the recordings, s.
    pub(crate) fn period_s(&self) -> f64 {
        let periods = self.recordings.iter().map(|named| named.listed.period_s);
        joulebus_statistics::metrics::quantile(&joulebus_statistics::metrics::sorted(periods), 0.5)
    }

    pub(crate) fn all(&self) -> Set {
        Set {
            name: "all".to_owned(),
            places: (0..self.recordings.len()).collect(),
        }
    }

    pub(crate) fn trials(&self) -> Vec<Set> {
        let each = self.recordings.iter().enumerate();
        each.map(|(at, named)| Set {
            name: named.listed.name.clone(),
            places: vec![at],
        })
        .collect()
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
        let sets = sets.into_iter();
        sets.map(|(name, places)| Set {
            name: name.clone(),
            places,
        })
        .collect()
    }

    fn sums<'a>(&'a self, set: &'a Set) -> impl Iterator<Item = &'a Sums> {
        set.places.iter().map(|at| &self.recordings[*at].sums)
    }

    /// The blocks to resample, and whether each is a whole trial.
    pub(crate) fn blocks(&self, set: &Set, bootstrap: &Bootstrap) -> (Vec<Block>, bool) {
        let whole = set.trials() >= bootstrap.trials_from;
        let blocks = if whole {
            let trials = self.sums(set).map(|sums| Block::merged(&sums.blocks));
            trials.collect()
        } else {
            self.sums(set)
                .flat_map(|sums| &sums.blocks)
                .cloned()
                .collect()
        };
        (blocks, whole)
    }

    /// Residuals of a forecaster, W, ascending.
    pub(crate) fn residuals_w(&self, set: &Set, forecaster: usize) -> Vec<f64> {
        let sums = self.sums(set);
        let each = sums.flat_map(|sums| sums.residuals_w.get(forecaster).into_iter().flatten());
        let mut residuals_w: Vec<f64> = each.copied().map(f64::from).collect();
        // A stable sort merges the existing ascending runs.
        residuals_w.sort_by(f64::total_cmp);
        residuals_w
    }

    /// The sums of each trial at one horizon.
    pub(crate) fn horizon<'a>(
        &'a self,
        set: &'a Set,
        place: usize,
    ) -> impl Iterator<Item = &'a HorizonSums> {
        self.sums(set)
            .filter_map(move |sums| sums.horizons.get(place))
    }
}
