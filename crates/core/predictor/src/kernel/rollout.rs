//! Rollouts in tiles: a tile executes all its steps before the next one starts, so that its lag
//! window stays in L1.

#![allow(
    clippy::needless_range_loop,
    reason = "indices of tiles are plainer than iterators, and every loop has to unroll"
)]

use super::batch::whole;
use super::forward::{BatchMajor, OutputMajor};
use super::lanes::{Job, Lanes};
use super::packed::Packed;
use crate::card::TrainingRange;
use crate::features::{FEATURES, FeatureSet, Features, INPUTS, LAGS, features};
use crate::nan::canonical;
use crate::rollout::{RolloutStart, Rollouts};

/// Lanes of the widest tile of any CPU.
const WIDEST: usize = 32;
/// Position of the newest reading in [`Features`].
const NEWEST: usize = FeatureSet::PowerOnly.first();

/// Lanes `first..first + energy_j.len()` of checked rollouts, with the `R` and `C` of
/// [`BatchMajor`].
pub(crate) struct Roll<'a, const R: usize, const C: usize> {
    pub(crate) packed: &'a Packed,
    pub(crate) range: &'a TrainingRange,
    pub(crate) rollouts: &'a Rollouts<'a>,
    pub(crate) first: usize,
    pub(crate) energy_j: &'a mut [f32],
    /// Step by step, `energy_j.len()` forecasts each.
    pub(crate) power_w: Option<&'a mut [f32]>,
}

impl<L: Lanes, const R: usize, const C: usize> Job<L> for Roll<'_, R, C> {
    #[inline(always)]
    fn run(self, lanes: L) {
        let mut tiles = Tiles {
            packed: self.packed,
            range: self.range,
            rollouts: self.rollouts,
            first: self.first,
            count: self.energy_j.len(),
            done: 0,
            power_w: self.power_w,
        };
        let energy_j = self.energy_j;
        let (wide, rest) = energy_j.split_at_mut(whole(energy_j.len(), R * L::WIDTH));
        for tile in wide.chunks_exact_mut(R * L::WIDTH) {
            tiles.batch_major::<L, R, C>(lanes, tile);
        }
        let (narrow, rest) = rest.split_at_mut(whole(rest.len(), L::WIDTH));
        if R > 1 {
            for tile in narrow.chunks_exact_mut(L::WIDTH) {
                tiles.batch_major::<L, 1, 8>(lanes, tile);
            }
        }
        let (fours, rest) = rest.as_chunks_mut::<4>();
        for tile in fours {
            tiles.output_major(lanes, tile);
        }
        let (ones, _) = rest.as_chunks_mut::<1>();
        for tile in ones {
            tiles.output_major(lanes, tile);
        }
    }
}

struct Tiles<'a> {
    packed: &'a Packed,
    range: &'a TrainingRange,
    rollouts: &'a Rollouts<'a>,
    first: usize,
    /// Lanes of the call, and how many of them are done.
    count: usize,
    done: usize,
    power_w: Option<&'a mut [f32]>,
}

impl Tiles<'_> {
    /// Commands of one step, from the first lane that is not done.
    #[inline(always)]
    fn commands(&self, step: usize) -> (&[f32], &[f32]) {
        let place = step * self.rollouts.lanes() + self.first + self.done;
        (&self.rollouts.v_mps[place..], &self.rollouts.omega_radps[place..])
    }

    /// Initial state of the robot of a lane. `lane` counts from the first one that is not done.
    #[inline(always)]
    fn start(&self, lane: usize) -> &RolloutStart {
        &self.rollouts.starts[(self.first + self.done + lane) / self.rollouts.candidates]
    }

    #[inline(always)]
    fn row_of_first_step(&self, lane: usize) -> Features {
        let (v_mps, omega_radps) = self.commands(0);
        let start = self.start(lane);
        let before = start.command.map(|(v, omega)| (v, omega, self.rollouts.step_s));
        let mut row = features(v_mps[lane], omega_radps[lane], before, &start.lag_w);
        self.fill_reading_age(0, lane, &mut row);
        row
    }

    /// Sets the reading-age features, if they are read: the robot's schedule continues.
    #[inline(always)]
    fn fill_reading_age(&self, step: usize, lane: usize, row: &mut Features) {
        if self.packed.read.has_reading_age() {
            self.start(lane).reading_age.after(step as u64).fill(row);
        }
    }

    /// Adds the forecasts of a step to the sums, and to the trace. What the next step is fed with
    /// remains.
    #[inline(always)]
    fn note(&mut self, step: usize, forecasts_w: &mut [f32], sums_w: &mut [f64]) {
        for (sum_w, forecast_w) in sums_w.iter_mut().zip(&*forecasts_w) {
            *sum_w += f64::from(*forecast_w);
        }
        if let Some(power_w) = self.power_w.as_deref_mut() {
            let place = step * self.count + self.done;
            power_w[place..][..forecasts_w.len()].copy_from_slice(forecasts_w);
        }
        for forecast_w in forecasts_w {
            *forecast_w = self.range.fed_back_w(*forecast_w);
        }
    }

    #[inline(always)]
    fn finish(&mut self, sums_w: &[f64], energy_j: &mut [f32]) {
        for (energy_j, sum_w) in energy_j.iter_mut().zip(sums_w) {
            *energy_j = canonical((sum_w * f64::from(self.rollouts.step_s)) as f32);
        }
        self.done += energy_j.len();
    }

    #[inline(always)]
    fn batch_major<L: Lanes, const R: usize, const C: usize>(
        &mut self,
        lanes: L,
        energy_j: &mut [f32],
    ) {
        const { assert!(R * L::WIDTH <= WIDEST) };
        let count = R * L::WIDTH;
        let mut sums_w = [0.0; WIDEST];
        let mut forecasts_w = [0.0; WIDEST];
        let mut inputs = [[lanes.splat(0.0); R]; INPUTS];
        for step in 0..self.rollouts.steps {
            if step == 0 {
                self.first_columns(lanes, &mut inputs);
            } else {
                self.next_columns(lanes, step, &forecasts_w, &mut inputs);
            }
            lanes.run(BatchMajor::<L, R, C> {
                packed: self.packed,
                inputs: &inputs,
                out_w: &mut forecasts_w[..count],
            });
            self.note(step, &mut forecasts_w[..count], &mut sums_w[..count]);
        }
        self.finish(&sums_w[..count], energy_j);
    }

    #[inline(always)]
    fn first_columns<L: Lanes, const R: usize>(
        &self,
        lanes: L,
        columns: &mut [[L::Vector; R]; INPUTS],
    ) {
        let mut transposed = [[0.0; WIDEST]; INPUTS];
        for lane in 0..R * L::WIDTH {
            let row = self.row_of_first_step(lane);
            for feature in 0..INPUTS {
                transposed[feature][lane] = row[feature];
            }
        }
        for feature in 0..INPUTS {
            for r in 0..R {
                columns[feature][r] = lanes.load(&transposed[feature][r * L::WIDTH..]);
            }
        }
    }

    /// [`features`](crate::features()) of every lane: the columns still hold the previous step.
    #[inline(always)]
    fn next_columns<L: Lanes, const R: usize>(
        &self,
        lanes: L,
        step: usize,
        newest_w: &[f32; WIDEST],
        columns: &mut [[L::Vector; R]; INPUTS],
    ) {
        let (v_mps, omega_radps) = self.commands(step);
        let step_s = lanes.splat(self.rollouts.step_s);
        for r in 0..R {
            let v = lanes.load(&v_mps[r * L::WIDTH..]);
            let omega = lanes.load(&omega_radps[r * L::WIDTH..]);
            columns[2][r] = lanes.div(lanes.sub(v, columns[0][r]), step_s);
            columns[3][r] = lanes.div(lanes.sub(omega, columns[1][r]), step_s);
            columns[0][r] = v;
            columns[1][r] = omega;
            columns[4][r] = lanes.abs(v);
            columns[5][r] = lanes.abs(omega);
            for lag in (1..LAGS).rev() {
                columns[NEWEST + lag][r] = columns[NEWEST + lag - 1][r];
            }
            columns[NEWEST][r] = lanes.load(&newest_w[r * L::WIDTH..]);
        }
        if self.packed.read.has_reading_age() {
            self.reading_age_columns(lanes, step, columns);
        }
    }

    #[inline(always)]
    fn reading_age_columns<L: Lanes, const R: usize>(
        &self,
        lanes: L,
        step: usize,
        columns: &mut [[L::Vector; R]; INPUTS],
    ) {
        let mut transposed = [[0.0; WIDEST]; INPUTS - FEATURES];
        for lane in 0..R * L::WIDTH {
            let mut row = [0.0; INPUTS];
            self.fill_reading_age(step, lane, &mut row);
            for feature in FEATURES..INPUTS {
                transposed[feature - FEATURES][lane] = row[feature];
            }
        }
        for feature in FEATURES..INPUTS {
            for r in 0..R {
                columns[feature][r] = lanes.load(&transposed[feature - FEATURES][r * L::WIDTH..]);
            }
        }
    }

    #[inline(always)]
    fn output_major<L: Lanes, const N: usize>(&mut self, lanes: L, energy_j: &mut [f32; N]) {
        let mut sums_w = [0.0; N];
        let mut forecasts_w = [0.0; N];
        let mut rows = [[0.0; INPUTS]; N];
        for step in 0..self.rollouts.steps {
            for (lane, row) in rows.iter_mut().enumerate() {
                *row = match step {
                    0 => self.row_of_first_step(lane),
                    _ => self.next_row(step, lane, forecasts_w[lane], row),
                };
            }
            lanes.run(OutputMajor { packed: self.packed, rows: &rows, out_w: &mut forecasts_w });
            self.note(step, &mut forecasts_w, &mut sums_w);
        }
        self.finish(&sums_w, energy_j);
    }

    #[inline(always)]
    fn next_row(&self, step: usize, lane: usize, newest_w: f32, before: &Features) -> Features {
        let (v_mps, omega_radps) = self.commands(step);
        let mut lag_w = [newest_w; LAGS];
        lag_w[1..].copy_from_slice(&before[NEWEST..FEATURES - 1]);
        let previous = (before[0], before[1], self.rollouts.step_s);
        let mut row = features(v_mps[lane], omega_radps[lane], Some(previous), &lag_w);
        self.fill_reading_age(step, lane, &mut row);
        row
    }
}
