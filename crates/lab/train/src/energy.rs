//! The energy model of a platform, fitted to the rows that the network was trained on.
//!
//! Errors are estimated by cross-validation on two halves: the model of one half is scored on the
//! other. A half has whole recordings, and all of a robot where robots differ: two parts of one
//! recording have the same floor, load and battery, and show nothing of another day. The stored
//! model is fitted to all of them.
//!
//! Few recordings show little of how drives differ, so Student's distribution widens their errors.
//! Of fewer than four, the deviation between them is that of a prior and theirs together.

use std::collections::{BTreeMap, BTreeSet};

use joulebus_dataset::rows::{Dataset, Row};
use joulebus_energy::{
    COMBINED_TERMS, CommandModel, EnergyModel, HORIZONS_S, KNOTS, LEVELS, LEVELS_S, Limit,
    QUANTILES, RECORDED_S, TERMS,
};
use joulebus_predictor::{FeatureSet, LAGS};
use joulebus_statistics::metrics::quantile;
use nalgebra::{SMatrix, SVector};

use crate::drives::{PRIOR_DRIVES, Run, student};
use crate::ridge::{recorded_w, ridge};

/// Runs are cut into blocks of about this time, each with a level of its own, when the power of
/// commands is fitted, s.
const BLOCK_S: f64 = 20.0;
/// Prior of a level, in seconds of readings that weigh as much as the platform's own level. Valid
/// for all levels but the longest.
const PRIOR_S: f64 = 0.05;
/// Candidate priors of the longest level. There are no longer ones: if all recordings are of one
/// robot, the platform's level is that robot's, and another robot must not be held to it for long.
const LONGEST_PRIORS_S: [f64; 4] = [0.05, 1.0, 3.0, 10.0];
/// Shares of a level that may be a constant power.
const ADDED_SHARES: [f64; 3] = [0.0, 0.3, 1.0];
/// Shares of an error's scale that may be the platform's mean.
const MEAN_SHARES: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
/// Maximum number of forecast origins per fit.
const MAX_ORIGINS: usize = 1_500;
/// Fewest origins, and fewest runs, with which the parameters at a horizon are chosen.
const FEWEST: (usize, usize) = (30, 4);
/// Fewest recordings that show the errors at a horizon. Those of fewer are taken from a prior.
pub(crate) const FEWEST_RECORDINGS: usize = 4;
/// Recordings from which on the errors among them are taken as they are.
const MANY_RECORDINGS: usize = 16;

// Of static size: nalgebra multiplies matrices of dynamic size by `matrixmultiply`, which fuses
// multiply-adds where the CPU can. A fit has the same bits on every machine.
type Terms = SVector<f64, TERMS>;
type Levels = SVector<f64, LEVELS>;

/// Fits the energy model, which reads commands if the network does. `None` if the recordings are
/// too short, or their mean power is not above 0.
pub fn energy_model(dataset: &Dataset, feature_set: FeatureSet) -> Option<EnergyModel> {
    let period_s = f64::from(dataset.period_s);
    if !(period_s > 0.0 && period_s.is_finite()) {
        return None;
    }
    let mut runs = runs(&dataset.training, &dataset.validation, period_s);
    if !feature_set.needs_command() {
        let motions = runs.iter_mut().flat_map(|run| &mut run.motion);
        motions.for_each(|motion| *motion = [f32::NAN; 4]);
    }
    let halves = halves(&runs);
    let all: Vec<&Run> = runs.iter().collect();
    let commands = [CommandFit::new(&halves[0], period_s)?, CommandFit::new(&halves[1], period_s)?];
    let (prior_s, crossed) = crossed(&halves, &commands, period_s)?;
    let known: Vec<&Crossed> = crossed.iter().map_while(Option::as_ref).collect();
    let longest = known.len().checked_sub(1)?;
    let command = CommandFit::new(&all, period_s)?;
    let mean_w = command.model.mean_w.into();
    let mean_share = mean_share(&known, mean_w);
    let levels = levels(&all, &command);
    let known: Vec<Known> = known
        .iter()
        .zip(HORIZONS_S)
        .map(|(crossed, horizon_s)| {
            let origins = Origins::new(&all, &command, horizon_s.into(), period_s);
            Known {
                added_share: crossed.with.added as f32,
                weights: origins.weights(&crossed.with).map(|weight| weight as f32).into(),
                errors: crossed.quantiles(mean_share, mean_w, &levels),
            }
        })
        .collect();
    let at = |place: usize| &known[place.min(longest)];
    let ranges = ranges(&all);
    let unit = unit_of(&all);
    let window = (f64::from(RECORDED_S) / period_s).round() as usize;
    let recorded_w = recorded_w(&all, &unit, window);
    let known_motions = all.iter().flat_map(|run| &run.motion).flatten().all(|of| of.is_finite());
    let mut limits = Vec::new();
    if !known_motions {
        limits.push(Limit::NoVelocities);
    } else if ranges[1] == [0.0; 2] {
        limits.push(Limit::NoTurns);
    }
    let model = EnergyModel {
        command: command.model,
        prior_s: prior_s.map(|prior_s| prior_s as f32),
        added_shares: std::array::from_fn(|place| at(place).added_share),
        weights: std::array::from_fn(|place| at(place).weights),
        calibrated: known.len(),
        errors: std::array::from_fn(|place| at(place).errors),
        mean_share: mean_share as f32,
        v_mps: ranges[0],
        omega_radps: ranges[1],
        combined: Some(combined(&all, &unit)),
        ridge: match command.model.reads_commands() {
            true => ridge(&all, &command.model, recorded_w),
            false => None,
        },
        recorded_w: Some(recorded_w),
        limits,
        hotel_w: None,
    };
    model.check().is_ok().then_some(model)
}

/// Parameters that turn levels into forecasts.
#[derive(Clone, Copy)]
struct With {
    prior_s: [f64; LEVELS],
    added: f64,
}

/// The best at each horizon with enough recordings, and the best priors for all.
fn crossed(
    halves: &[Vec<&Run>; 2],
    commands: &[CommandFit; 2],
    period_s: f64,
) -> Option<([f64; LEVELS], Vec<Option<Crossed>>)> {
    let of_prior = |longest_s: f64| {
        let mut prior_s = [PRIOR_S; LEVELS];
        prior_s[LEVELS - 1] = longest_s;
        let at = |horizon_s: f32| {
            let of = |added| {
                let with = With { prior_s, added };
                Crossed::new(halves, commands, (horizon_s.into(), period_s), &with)
            };
            let all = ADDED_SHARES.map(of).into_iter().filter(Crossed::enough);
            all.min_by(|a, b| a.loss().total_cmp(&b.loss()))
        };
        let found: Vec<Option<Crossed>> = HORIZONS_S.into_iter().map(at).collect();
        let loss: f64 = found.iter().flatten().map(|one| one.loss() / one.measured_j()).sum();
        (loss, prior_s, found)
    };
    let all = LONGEST_PRIORS_S.map(of_prior).into_iter();
    let (_, prior_s, found) = all.min_by(|a, b| a.0.total_cmp(&b.0))?;
    Some((prior_s, found))
}

/// Error estimates at a horizon. Beyond the longest horizon they stay constant.
struct Known {
    added_share: f32,
    weights: [f32; LEVELS],
    errors: [f32; KNOTS],
}

/// Number of recordings in the rows that the energy model is fitted to.
pub(crate) fn recordings(dataset: &Dataset) -> usize {
    let rows = dataset.training.iter().chain(&dataset.validation);
    rows.map(|row| row.origin.recording).collect::<BTreeSet<u32>>().len()
}

/// The level of each recording: what it drew, relative to the command model.
fn levels(runs: &[&Run], command: &CommandFit) -> BTreeMap<u32, f64> {
    let mut sums = BTreeMap::new();
    for run in runs {
        let (read, predicted) = sums.entry(run.origin.recording).or_insert((0.0, 0.0));
        *read += run.power_w.iter().sum::<f64>();
        *predicted += run.motion.iter().map(|motion| command.power_w(motion)).sum::<f64>();
    }
    sums.into_iter().map(|(recording, (read, predicted))| (recording, read / predicted)).collect()
}

/// Deviation of the mean power between drives, relative, as far as few of them show it.
fn between_drives(levels: &[f64]) -> f64 {
    let (prior, weight) = PRIOR_DRIVES;
    let mean = levels.iter().sum::<f64>() / levels.len() as f64;
    let square = |level: &f64| (level / mean - 1.0) * (level / mean - 1.0);
    let squares: f64 = levels.iter().map(square).filter(|square| square.is_finite()).sum();
    libm::sqrt((weight * prior * prior + squares) / (weight + levels.len() as f64 - 1.0))
}

/// Two halves by turns, with whole robots each if there are several, or else whole recordings. Too
/// few recordings are halved run by run: a prior stands for their errors.
fn halves(runs: &[Run]) -> [Vec<&Run>; 2] {
    let recordings: BTreeSet<u32> = runs.iter().map(|run| run.origin.recording).collect();
    let robots: BTreeSet<u32> = runs.iter().map(|run| run.origin.robot).collect();
    let unit = |place: usize| match (recordings.len() >= FEWEST_RECORDINGS, robots.len() > 1) {
        (false, _) => place as u32,
        (true, true) => runs[place].origin.robot,
        (true, false) => runs[place].origin.recording,
    };
    // In the order of their first runs.
    let mut units: Vec<(u32, Vec<&Run>)> = Vec::new();
    for (place, run) in runs.iter().enumerate() {
        match units.iter_mut().find(|(known, _)| *known == unit(place)) {
            Some((_, of_unit)) => of_unit.push(run),
            None => units.push((unit(place), vec![run])),
        }
    }
    let mut halves = [Vec::new(), Vec::new()];
    for (place, (_, of_unit)) in units.into_iter().enumerate() {
        halves[place % 2].extend(of_unit);
    }
    halves
}

/// Lowest and highest velocities.
fn ranges(runs: &[&Run]) -> [[f32; 2]; 2] {
    std::array::from_fn(|column| {
        let values = runs.iter().flat_map(|run| &run.motion).map(|motion| motion[column]);
        let known = values.filter(|value| value.is_finite());
        let range = known.fold([f32::INFINITY, f32::NEG_INFINITY], |[lo, hi], value| {
            [lo.min(value), hi.max(value)]
        });
        if range[0] <= range[1] { range } else { [f32::MIN, f32::MAX] }
    })
}

/// The unit of a run, in which what counts must have been reached twice: its recording, or itself
/// if there are too few.
fn unit_of(runs: &[&Run]) -> impl Fn(usize, &Run) -> usize + use<> {
    let recordings: BTreeSet<u32> = runs.iter().map(|run| run.origin.recording).collect();
    let are_enough = recordings.len() >= FEWEST_RECORDINGS;
    move |place, run| if are_enough { run.origin.recording as usize } else { place }
}

/// The products and changes of velocities reached in at least two recordings, or in two runs of too
/// few recordings. A single wrong stamp, which divides a change, therefore does not count. A quantile of all rows would not do: jumps between
/// commands are rare, and the plans of every follower begin and end with one.
fn combined(runs: &[&Run], unit: impl Fn(usize, &Run) -> usize) -> [f32; COMBINED_TERMS] {
    let mut units = BTreeMap::new();
    for (place, run) in runs.iter().enumerate() {
        let of_unit = units.entry(unit(place, run)).or_insert([0.0f32; COMBINED_TERMS]);
        for motion in &run.motion {
            let terms = CommandModel::combined_terms(*motion);
            for (highest, term) in of_unit.iter_mut().zip(terms) {
                *highest = highest.max(if term.is_finite() { term } else { 0.0 });
            }
        }
    }
    let mut highest = [[0.0f32; 2]; COMBINED_TERMS];
    for of_unit in units.into_values() {
        for (highest, of_run) in highest.iter_mut().zip(of_unit) {
            let [first, second] = *highest;
            *highest = [first.max(of_run), second.max(first.min(of_run))];
        }
    }
    highest.map(|[_, second]| second)
}

/// A row follows another of the same recording if its readings are the other's, one later. Few long
/// runs are cut, so that there are enough for two halves.
fn runs(training: &[Row], validation: &[Row], period_s: f64) -> Vec<Run> {
    const LAG1: usize = 6;
    let follows = |before: &Row, row: &Row| {
        row.origin == before.origin
            && row.features[LAG1].to_bits() == before.target_w.to_bits()
            && row.features[LAG1 + 1..LAG1 + 5] == before.features[LAG1..LAG1 + 4]
    };
    let parts = [training, validation].into_iter();
    let found: Vec<&[Row]> = parts.flat_map(|part| part.chunk_by(follows)).collect();
    let rows: usize = found.iter().map(|rows| rows.len()).sum();
    // Otherwise three drives of one length are three runs, of which no half knows enough.
    let few = found.len() < 8;
    // Eight pieces at least, but none shorter than the second horizon.
    let shortest = (f64::from(HORIZONS_S[1]) / period_s).ceil() as usize + 1;
    let longest = (rows / 8).max(shortest).max(1);
    let cut = found.into_iter().flat_map(|rows| {
        let pieces = if few || rows.len() > 4 * longest { rows.len() / longest } else { 1 };
        rows.chunks(rows.len().div_ceil(pieces.max(1)).max(1))
    });
    let usable = |row: &&Row| row.target_w.is_finite();
    cut.filter(|rows| rows.iter().any(|row| usable(&row)))
        .map(|rows| Run {
            origin: rows[0].origin,
            motion: rows
                .iter()
                .filter(usable)
                .map(|row| std::array::from_fn(|column| row.features[column]))
                .collect(),
            power_w: rows.iter().filter(usable).map(|row| row.target_w.into()).collect(),
            before_w: std::array::from_fn(|at| rows[0].features[LAG1 + LAGS - 1 - at].into()),
        })
        .collect()
}

/// A command model, and the terms that it reads.
struct CommandFit {
    model: CommandModel,
}

impl CommandFit {
    /// Least squares with non-negative weights. Each block of a run has its own level, because a
    /// robot's level is measured live: differences between robots and floors must not be attributed
    /// to commands. `None` without a mean power above 0.
    fn new(runs: &[&Run], period_s: f64) -> Option<Self> {
        let rows: usize = runs.iter().map(|run| run.power_w.len()).sum();
        let sum_w: f64 = runs.iter().flat_map(|run| &run.power_w).sum();
        let mean_w = sum_w / rows as f64;
        if !(mean_w >= f64::from(f32::MIN_POSITIVE) && mean_w.is_finite()) {
            return None;
        }
        let mut model = CommandModel::constant(mean_w as f32);
        let mut motions = runs.iter().flat_map(|run| &run.motion);
        if !motions.all(|motion| motion.iter().all(|value| value.is_finite())) {
            return Some(Self { model });
        }
        model.half_v_mps = half(runs, 0);
        model.half_omega_radps = half(runs, 1);
        let blocks = blocks(runs, &model, period_s);
        let scales = scales(&blocks, rows);
        let mut weights = Terms::zeros();
        weights[0] = mean_w;
        for _ in 0..8 {
            weights = Normal::new(&blocks, &weights, &scales, mean_w).solve(weights);
            let fitted: f64 = blocks.iter().map(|block| block.sum_w(&weights, &scales)).sum();
            let scale = mean_w * rows as f64 / fitted;
            if !scale.is_finite() {
                return Some(Self { model });
            }
            weights *= scale;
        }
        model.weights = weights.component_div(&scales).map(|weight| weight as f32).into();
        // A robot draws power at rest. A model without that would divide by zero.
        model.weights[0] = model.weights[0].max(0.02 * mean_w as f32);
        Some(Self { model })
    }

    fn power_w(&self, motion: &[f32; 4]) -> f64 {
        if !self.model.reads_commands() {
            return self.model.weights[0].into();
        }
        let terms = Terms::from(self.model.terms(*motion).map(f64::from));
        dot(&Terms::from(self.model.weights.map(f64::from)), &terms)
    }
}

/// A quarter of the 95 % quantile of a velocity.
fn half(runs: &[&Run], column: usize) -> f32 {
    let values = runs.iter().flat_map(|run| &run.motion).map(|motion| motion[column].abs());
    let mut values: Vec<f32> = values.collect();
    values.sort_by(f32::total_cmp);
    let high = values.get(values.len() * 95 / 100).copied().unwrap_or(0.0);
    (0.25 * high).max(1e-3)
}

/// Rows with a common level: terms and power.
struct Block {
    rows: Vec<(Terms, f64)>,
}

impl Block {
    /// Sum of the fitted powers, W.
    fn sum_w(&self, weights: &Terms, scales: &Terms) -> f64 {
        let of = |terms: &Terms| weights.component_mul(terms).component_div(scales).sum();
        self.rows.iter().map(|(terms, _)| of(terms)).sum()
    }
}

fn blocks(runs: &[&Run], model: &CommandModel, period_s: f64) -> Vec<Block> {
    let of_run = |run: &&Run| {
        let terms = run.motion.iter().map(|motion| model.terms(*motion).map(f64::from).into());
        let rows: Vec<(Terms, f64)> = terms.zip(run.power_w.iter().copied()).collect();
        let count = (rows.len() as f64 * period_s / BLOCK_S).round().max(1.0) as usize;
        let length = rows.len().div_ceil(count).max(1);
        rows.chunks(length).map(|rows| Block { rows: rows.to_vec() }).collect::<Vec<_>>()
    };
    runs.iter().flat_map(of_run).collect()
}

/// The sum in the order of the terms. nalgebra's own depends on their number, and models that ship
/// have the bits of this one.
fn dot<const N: usize>(one: &SVector<f64, N>, other: &SVector<f64, N>) -> f64 {
    one.component_mul(other).sum()
}

/// Root mean square of each term, 1 for one that is always 0: fits do not depend on units.
fn scales(blocks: &[Block], rows: usize) -> Terms {
    let all = blocks.iter().flat_map(|block| &block.rows);
    let squares: Terms = all.map(|(terms, _)| terms.component_mul(terms)).sum();
    (squares / rows as f64).map(|mean| if mean > 1e-18 { libm::sqrt(mean) } else { 1.0 })
}

/// Normal equations of the weights.
struct Normal {
    left: SMatrix<f64, TERMS, TERMS>,
    right: Terms,
}

impl Normal {
    /// Scales each block by its level under the weights so far.
    fn new(blocks: &[Block], weights: &Terms, scales: &Terms, mean_w: f64) -> Self {
        /// Against terms that vary together, in shares of the mean square.
        const RIDGE: f64 = 1e-3;
        let (mut left, mut right) = (SMatrix::<f64, TERMS, TERMS>::zeros(), Terms::zeros());
        let (mut rows, mut squares) = (0.0, 0.0);
        for block in blocks {
            let count = block.rows.len() as f64;
            let read_w = block.rows.iter().map(|(_, power_w)| power_w).sum::<f64>() / count;
            let predicted_w = block.sum_w(weights, scales) / count;
            let level = ((read_w + 0.02 * mean_w) / (predicted_w + 0.02 * mean_w)).max(0.0);
            for (terms, power_w) in &block.rows {
                let scaled = (terms * level).component_div(scales);
                left.ger(1.0, &scaled, &scaled, 1.0);
                right.axpy(*power_w, &scaled, 1.0);
            }
            (rows, squares) = (rows + count, squares + level * level * count);
        }
        for term in 1..TERMS {
            left[(term, term)] += RIDGE * squares;
        }
        let share = 1.0 / f64::max(rows, 1.0);
        Self { left: left * share, right: right * share }
    }

    /// The best weights that are not negative, by coordinate descent.
    fn solve(&self, mut weights: Terms) -> Terms {
        for _ in 0..300 {
            for term in 0..TERMS {
                let own = self.left[(term, term)];
                if own > 1e-12 {
                    let excess =
                        self.left.column(term).component_mul(&weights).sum() - self.right[term];
                    weights[term] = (weights[term] - excess / own).max(0.0);
                }
            }
        }
        weights
    }
}

/// A forecast's inputs, and the measured energy.
struct Origin {
    /// Energy, the command model's energy, and time, of each level.
    levels: [[f64; 3]; LEVELS],
    command_j: f64,
    energy_j: f64,
}

fn advance(levels: &mut [[f64; 3]; LEVELS], power_w: f64, command_w: f64, period_s: f64) {
    let next = [power_w * period_s, command_w * period_s, period_s];
    for (level, level_s) in levels.iter_mut().zip(LEVELS_S) {
        let keeps = f64::from(level_s) / (f64::from(level_s) + period_s);
        for (sum, next) in level.iter_mut().zip(next) {
            *sum = keeps * (*sum + next);
        }
    }
}

/// The origins of all runs at one horizon.
struct Origins {
    origins: Vec<Origin>,
    /// Runs that have an origin, and their recordings.
    runs: usize,
    recordings: BTreeSet<u32>,
    duration_s: f64,
}

impl Origins {
    fn new(runs: &[&Run], command: &CommandFit, horizon_s: f64, period_s: f64) -> Self {
        let steps = (horizon_s / period_s).round().max(1.0) as usize;
        let candidates = |run: &&Run| (run.power_w.len() + 1).saturating_sub(steps);
        let total: usize = runs.iter().map(candidates).sum();
        let stride = total.div_ceil(MAX_ORIGINS).max(1);
        let (mut origins, mut used, mut number) = (Vec::new(), 0, 0);
        let mut recordings = BTreeSet::new();
        for run in runs {
            let before = origins.len();
            let commands: Vec<f64> =
                run.motion.iter().map(|motion| command.power_w(motion)).collect();
            let sums = |values: &[f64]| {
                let mut sum = 0.0;
                let sums = values.iter().map(|value| {
                    sum += value * period_s;
                    sum
                });
                std::iter::once(0.0).chain(sums).collect::<Vec<f64>>()
            };
            let (read_j, predicted_j) = (sums(&run.power_w), sums(&commands));
            let mut levels = [[0.0; 3]; LEVELS];
            let first_w = commands.first().copied().unwrap_or(1.0);
            // The first of a recording's readings has no time before it.
            for power_w in run.before_w.iter().skip(1).filter(|power_w| power_w.is_finite()) {
                advance(&mut levels, *power_w, first_w, period_s);
            }
            for at in 0..run.power_w.len() {
                if at + steps <= run.power_w.len() {
                    if number % stride == stride / 2 {
                        origins.push(Origin {
                            levels,
                            command_j: predicted_j[at + steps] - predicted_j[at],
                            energy_j: read_j[at + steps] - read_j[at],
                        });
                    }
                    number += 1;
                }
                advance(&mut levels, run.power_w[at], commands[at], period_s);
            }
            if origins.len() > before {
                used += 1;
                recordings.insert(run.origin.recording);
            }
        }
        Self { origins, runs: used, recordings, duration_s: steps as f64 * period_s }
    }

    /// The energy by each level, J.
    fn experts(&self, origin: &Origin, with: &With) -> Levels {
        Levels::from_fn(|level, _| {
            let [energy_j, command_j, time_s] = origin.levels[level];
            if time_s <= 0.0 {
                return origin.command_j;
            }
            let shrunk = time_s / (time_s + with.prior_s[level]);
            let scaled = origin.command_j * (1.0 + shrunk * (energy_j / command_j - 1.0));
            let above_w = shrunk * (energy_j - command_j) / time_s;
            let raised = origin.command_j + above_w * self.duration_s;
            (1.0 - with.added) * scaled + with.added * raised
        })
    }

    /// The non-negative weights with sum 1 and least absolute error, by exponentiated gradients
    /// with decreasing steps.
    fn weights(&self, with: &With) -> Levels {
        const ROUNDS: usize = 200;
        let experts: Vec<Levels> =
            self.origins.iter().map(|origin| self.experts(origin, with)).collect();
        let mut weights = Levels::repeat(1.0 / LEVELS as f64);
        let mut best = (f64::INFINITY, weights);
        for round in 0..ROUNDS {
            let (mut loss, mut slope) = (0.0, Levels::zeros());
            for (origin, experts) in self.origins.iter().zip(&experts) {
                let error_j = dot(&weights, experts) - origin.energy_j;
                loss += error_j.abs();
                slope += experts.add_scalar(-origin.energy_j) * error_j.signum();
            }
            if loss < best.0 {
                best = (loss, weights);
            }
            let largest = slope.amax();
            if largest.is_nan() || largest <= 0.0 {
                break;
            }
            let step = 0.5 * (1.0 - round as f64 / ROUNDS as f64) / largest;
            let factors = slope.map(|slope| libm::exp(-step * slope));
            weights = weights.component_mul(&factors).add_scalar(1e-9);
            weights /= weights.sum();
        }
        best.1 / best.1.sum()
    }
}

/// Energies at one origin, J.
struct Pair {
    forecast: f64,
    measured: f64,
}

/// Both halves, each scored by the model of the other, at one horizon.
struct Crossed {
    with: With,
    pairs: Vec<Pair>,
    runs: usize,
    recordings: BTreeSet<u32>,
    duration_s: f64,
}

impl Crossed {
    fn new(
        halves: &[Vec<&Run>; 2],
        commands: &[CommandFit; 2],
        (horizon_s, period_s): (f64, f64),
        with: &With,
    ) -> Self {
        let mut found = Self {
            with: *with,
            pairs: Vec::new(),
            runs: 0,
            recordings: BTreeSet::new(),
            duration_s: 0.0,
        };
        for (own, other) in [(0, 1), (1, 0)] {
            let command = &commands[own];
            let weights = Origins::new(&halves[own], command, horizon_s, period_s).weights(with);
            let scored = Origins::new(&halves[other], command, horizon_s, period_s);
            found.runs += scored.runs;
            found.recordings.extend(&scored.recordings);
            found.duration_s = scored.duration_s;
            found.pairs.extend(scored.origins.iter().map(|origin| Pair {
                forecast: dot(&weights, &scored.experts(origin, with)),
                measured: origin.energy_j,
            }));
        }
        found
    }

    fn enough(&self) -> bool {
        self.pairs.len() >= FEWEST.0 && self.runs >= FEWEST.1
    }

    fn loss(&self) -> f64 {
        self.pairs.iter().map(|pair| (pair.forecast - pair.measured).abs()).sum()
    }

    fn measured_j(&self) -> f64 {
        self.pairs.iter().map(|pair| pair.measured.abs()).sum()
    }

    /// Errors relative to the scale of their forecasts, ascending, and the sum of the scales
    /// through the mean energy.
    fn relative(&self, mean_share: f64, mean_w: f64) -> (Vec<f64>, f64) {
        let mean_j = mean_w * self.duration_s;
        let mut scales = 0.0;
        let errors = self.pairs.iter().map(|pair| {
            let forecast_j = pair.forecast;
            let scale_j = forecast_j.abs() + mean_share * (mean_j - forecast_j.abs());
            let scale_j = scale_j.max(1e-6 * mean_j);
            scales += scale_j / mean_j;
            (pair.measured - forecast_j) / scale_j
        });
        let mut errors: Vec<f64> = errors.collect();
        errors.sort_by(f64::total_cmp);
        (errors, scales)
    }

    /// Quantiles of the errors, wider if they are of few recordings, whose levels are `levels`.
    fn quantiles(&self, mean_share: f64, mean_w: f64, levels: &BTreeMap<u32, f64>) -> [f32; KNOTS] {
        let (errors, _) = self.relative(mean_share, mean_w);
        let seen = QUANTILES.map(|p| quantile(&errors, p.into()));
        let count = self.recordings.len();
        let another = libm::sqrt(1.0 + 1.0 / count as f64);
        let median = seen[KNOTS / 2];
        let wider: [f64; KNOTS] = if count >= MANY_RECORDINGS {
            seen
        } else if count >= FEWEST_RECORDINGS {
            let freedom = (count - 1) as f64;
            // As much wider as Student's distribution is than a normal one.
            std::array::from_fn(|knot| {
                let p = f64::from(QUANTILES[knot]);
                let factor = match knot == KNOTS / 2 {
                    true => 1.0,
                    false => another * student(p, freedom) / student(p, 1e4),
                };
                median + factor * (seen[knot] - median)
            })
        } else {
            let of_these: Vec<f64> =
                self.recordings.iter().filter_map(|of| levels.get(of).copied()).collect();
            let deviation = another * between_drives(&of_these);
            let freedom = PRIOR_DRIVES.1 + count as f64 - 1.0;
            std::array::from_fn(|knot| {
                let between = deviation * student(QUANTILES[knot].into(), freedom);
                let within = seen[knot] - median;
                median + libm::hypot(within, between).copysign(between)
            })
        };
        wider.map(|error| error as f32)
    }

    /// Mean width of the 90 % interval, relative to the mean energy.
    fn width(&self, mean_share: f64, mean_w: f64) -> f64 {
        let (errors, scales) = self.relative(mean_share, mean_w);
        let width = quantile(&errors, 0.95) - quantile(&errors, 0.05);
        width * scales / self.pairs.len() as f64
    }
}

/// The share with the narrowest intervals.
fn mean_share(known: &[&Crossed], mean_w: f64) -> f64 {
    let width = |share: f64| -> f64 { known.iter().map(|one| one.width(share, mean_w)).sum() };
    let shares = MEAN_SHARES.into_iter();
    shares.min_by(|a, b| width(*a).total_cmp(&width(*b))).unwrap_or(0.0)
}
