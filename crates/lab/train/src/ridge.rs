//! The ridge regression of the power on commands, and the error of drives that it has not seen.

use std::collections::BTreeMap;

use joulebus_energy::{CommandModel, RIDGE_TERMS, Ridge};
use nalgebra::{SMatrix, SVector};

use crate::drives::{PRIOR_DRIVES, Run, student};

/// Penalty, in the terms' own squares. Of 0.003 to 0.1 it had the least error over left-out drives
/// of two robots that were commanded v and ω.
const PENALTY: f64 = 0.03;
/// Parts of the recordings that are left out by turns, at most.
const MAX_FOLDS: usize = 8;

type Vector = SVector<f64, RIDGE_TERMS>;
type Matrix = SMatrix<f64, RIDGE_TERMS, RIDGE_TERMS>;

/// Fits the regression to all runs. `recorded_w` bounds its power. `None` if it has no solution.
pub(crate) fn ridge(runs: &[&Run], command: &CommandModel, recorded_w: [f32; 2]) -> Option<Ridge> {
    let mut recordings: Vec<u32> = runs.iter().map(|run| run.origin.recording).collect();
    recordings.sort_unstable();
    recordings.dedup();
    let folds = recordings.len().min(MAX_FOLDS);
    let fold_of = |run: &Run| recordings.iter().position(|of| *of == run.origin.recording);
    let mut energies = BTreeMap::new();
    for fold in 0..folds {
        let is_left_out = |run: &Run| fold_of(run).is_some_and(|place| place % folds == fold);
        let kept: Vec<&Run> = runs.iter().filter(|run| !is_left_out(run)).copied().collect();
        let Some(fitted) = fit(&kept, command) else { continue };
        for run in runs.iter().filter(|run| is_left_out(run)) {
            let (read, forecast) = energies.entry(run.origin.recording).or_insert((0.0, 0.0));
            *read += run.power_w.iter().sum::<f64>();
            let power_w = |motion: &[f32; 4]| {
                let power_w = fitted.power_w(&fitted.deviations(command, motion[0], motion[1]));
                f64::from(power_w.max(recorded_w[0]).min(recorded_w[1]))
            };
            *forecast += run.motion.iter().map(power_w).sum::<f64>();
        }
    }
    let errors = energies.into_values().map(|(read, forecast)| read / forecast - 1.0);
    let squares: Vec<f64> = errors.map(|error| error * error).filter(|of| of.is_finite()).collect();
    let (prior, weight) = PRIOR_DRIVES;
    let drives = weight + squares.len() as f64;
    let variance = (weight * prior * prior + squares.iter().sum::<f64>()) / drives;
    let left_out = (student(0.95, drives - 1.0) * variance.sqrt()) as f32;
    Some(Ridge { left_out, ..fit(runs, command)? })
}

fn fit(runs: &[&Run], command: &CommandModel) -> Option<Ridge> {
    let terms = |motion: &[f32; 4]| {
        let terms = command.terms([motion[0], motion[1], 0.0, 0.0]);
        Vector::from_fn(|term, _| f64::from(terms[term + 1]))
    };
    let rows = || {
        let of_run = |run: &'_ &Run| -> Vec<(Vector, f64)> {
            run.motion.iter().map(terms).zip(run.power_w.iter().copied()).collect()
        };
        runs.iter().flat_map(of_run)
    };
    let (mut count, mut means, mut mean_w) = (0.0, Vector::zeros(), 0.0);
    for (terms, power_w) in rows() {
        (count, means, mean_w) = (count + 1.0, means + terms, mean_w + power_w);
    }
    if count == 0.0 {
        return None;
    }
    (means, mean_w) = (means / count, mean_w / count);
    let mut squares = Vector::zeros();
    for (terms, _) in rows() {
        squares += (terms - means).map(|apart| apart * apart);
    }
    /// Scale of a term that is constant: any other value of it is far from the training.
    const UNSEEN: f64 = 0.1;
    /// Share of a term's mean below which its deviation is rounding.
    const ROUNDING: f64 = 1e-6;
    let scales = Vector::from_fn(|term, _| match (squares[term] / count).sqrt() {
        scale if scale > ROUNDING * means[term].max(1e-3) => scale,
        _ => UNSEEN,
    });
    let (mut left, mut right) = (Matrix::identity() * PENALTY, Vector::zeros());
    for (terms, power_w) in rows() {
        let apart = (terms - means).component_div(&scales);
        left.ger(1.0 / count, &apart, &apart, 1.0);
        right += apart * ((power_w - mean_w) / count);
    }
    let inverse = left.cholesky()?.inverse();
    let weights = inverse * right;
    let narrow = |vector: Vector| std::array::from_fn(|term| vector[term] as f32);
    let mut ridge = Ridge {
        constant_w: mean_w as f32,
        means: narrow(means),
        scales: narrow(scales),
        weights: narrow(weights),
        inverse: std::array::from_fn(|row| {
            std::array::from_fn(|column| inverse[(row, column)] as f32)
        }),
        max_leverage: 1.0,
        left_out: 0.0,
    };
    let motions = runs.iter().flat_map(|run| &run.motion);
    let leverages =
        motions.map(|motion| ridge.leverage(&ridge.deviations(command, motion[0], motion[1])));
    ridge.max_leverage = leverages.fold(f32::MIN_POSITIVE, f32::max);
    Some(ridge)
}

/// Lowest and highest mean power over some steps that two recordings reached, or two runs of too
/// few recordings, W. A single wrong reading does not count.
pub(crate) fn recorded_w(
    runs: &[&Run],
    unit: impl Fn(usize, &Run) -> usize,
    steps: usize,
) -> [f32; 2] {
    let mut units = BTreeMap::new();
    for (place, run) in runs.iter().enumerate() {
        let [lowest, highest] = units.entry(unit(place, run)).or_insert([f64::MAX, f64::MIN]);
        let steps = steps.clamp(1, run.power_w.len().max(1));
        for window in run.power_w.windows(steps).step_by(steps.div_ceil(4)) {
            let mean_w = window.iter().sum::<f64>() / steps as f64;
            (*lowest, *highest) = (lowest.min(mean_w), highest.max(mean_w));
        }
    }
    let second = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values.get(1).or(values.first()).copied().unwrap_or(f64::NAN) as f32
    };
    let lowest = second(units.values().map(|[lowest, _]| *lowest).collect());
    let highest = second(units.values().map(|[_, highest]| -*highest).collect());
    [lowest, -highest]
}
