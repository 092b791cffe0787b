//! Open-loop rollouts: forecasters fed with their own forecasts.

use std::ops::Range;

use joulebus_predictor::{FeatureSet, Features, LAGS, Model, ReadingAge};

use super::blocks::HorizonSums;
use super::design::Lines;
use super::{Contents, Options};
use joulebus_dataset::rows::Row;

/// Position of the newest reading in [`Features`].
const NEWEST: usize = FeatureSet::PowerOnly.first();

/// Rollouts that are computed together: some 200 bytes each.
const ORIGINS_AT_ONCE: usize = 1 << 16;

/// First row of a rollout, and the end of the rows that it can be scored against.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Origin {
    row: usize,
    end: usize,
    fold: usize,
}

/// Rows from one origin to the next at a horizon: `every`, or the horizon if that is less. One tick
/// ahead every row is therefore scored, as in corrected mode.
fn stride(horizon: usize, every: usize) -> usize {
    horizon.min(every)
}

/// Every `stride`-th of the evaluated rows, counted through all recordings (`before` is the number
/// in earlier recordings). The beginning of a run or a recording is then an origin as often as any
/// other row.
fn origins(
    contents: &Contents,
    parts: &[(usize, Range<usize>)],
    before: usize,
    stride: usize,
) -> Vec<Origin> {
    let seqs = &contents.rows.sample_seq;
    let follows = |row: usize| seqs[row] == seqs[row - 1] + 1;
    let mut number = before;
    let mut origins = Vec::new();
    for (fold, rows) in parts {
        let mut end = rows.start;
        for row in rows.clone() {
            if row == end {
                end = row + 1;
                while end < rows.end && follows(end) {
                    end += 1;
                }
            }
            if number % stride == stride / 2 {
                let fold = *fold;
                origins.push(Origin { row, end, fold });
            }
            number += 1;
        }
    }
    origins
}

/// Forecasts of one forecaster at every horizon of every origin: power, W, and energy up to the
/// horizon, J. NaN beyond the end of the rows.
struct Trace {
    /// `horizon * origins + origin`.
    power_w: Vec<f64>,
    energy_j: Vec<f64>,
}

/// The sums at each horizon, over the evaluated parts of a recording. `before`: evaluated rows of
/// the recordings before it.
pub(super) fn sums(
    models: &[Model],
    contents: &Contents,
    (parts, before): (&[(usize, Range<usize>)], usize),
    lines: &Lines,
    options: &Options,
) -> Vec<HorizonSums> {
    let every = |horizon: &usize| stride(*horizon, options.origins_every);
    let groups = options.horizons.chunk_by(|a, b| every(a) == every(b));
    let of_group = |horizons: &[usize]| {
        let (first, longest) = (horizons[0], horizons[horizons.len() - 1]);
        let mut starts = origins(contents, parts, before, every(&first));
        for start in &mut starts {
            start.end = start.end.min(start.row + longest);
        }
        let forecasters = models.len() + 1 + lines.first().map_or(0, Vec::len);
        let mut sums = vec![HorizonSums::new(forecasters); horizons.len()];
        for starts in starts.chunks(ORIGINS_AT_ONCE) {
            let rollout = Rollout {
                rows: &contents.rows.rows,
                step_s: &contents.step_s,
                reading_ages: &contents.rows.reading_ages,
                starts,
                horizons,
            };
            let measured = rollout.alone(|_, row, _| row.target_w);
            let traces = rollout.traces(models, lines);
            for (place, sums) in sums.iter_mut().enumerate() {
                rollout.add(sums, place, &measured, &traces, models.len());
            }
        }
        sums
    };
    groups.flat_map(of_group).collect()
}

struct Rollout<'a> {
    rows: &'a [Row],
    step_s: &'a [f64],
    reading_ages: &'a [ReadingAge],
    starts: &'a [Origin],
    horizons: &'a [usize],
}

impl Rollout<'_> {
    /// Traces of the models, persistence, and the linear baselines.
    fn traces(&self, models: &[Model], lines: &Lines) -> Vec<Trace> {
        let mut traces: Vec<Trace> = models.iter().map(|model| self.together(model)).collect();
        traces.push(self.alone(|_, _, [newest_w, ..]| *newest_w));
        let baselines = 0..lines.first().map_or(0, Vec::len);
        traces.extend(baselines.map(|place| {
            self.alone(|start, row, lag_w| {
                let Some(line) = &lines[start.fold][place] else {
                    return f32::NAN;
                };
                line.predict(&with_lags(row, lag_w)) as f32
            })
        }));
        traces
    }

    fn unknown(&self) -> Trace {
        let places = self.horizons.len() * self.starts.len();
        Trace { power_w: vec![f64::NAN; places], energy_j: vec![f64::NAN; places] }
    }

    /// Origin by origin: `forecast` computes the next forecast, W, from a row and the last readings
    /// or forecasts.
    fn alone(&self, mut forecast: impl FnMut(&Origin, &Row, &[f32; LAGS]) -> f32) -> Trace {
        let mut trace = self.unknown();
        for (lane, start) in self.starts.iter().enumerate() {
            let mut lag_w = lags(&self.rows[start.row]);
            let (mut place, mut energy_j) = (0, 0.0);
            for at in start.row..start.end {
                let power_w = forecast(start, &self.rows[at], &lag_w);
                push(&mut lag_w, power_w);
                energy_j += f64::from(power_w) * self.step_s[at];
                if self.horizons.get(place) == Some(&(at + 1 - start.row)) {
                    trace.power_w[place * self.starts.len() + lane] = power_w.into();
                    trace.energy_j[place * self.starts.len() + lane] = energy_j;
                    place += 1;
                }
            }
        }
        trace
    }

    /// All origins at once, each step as one batch of the kernel.
    fn together(&self, model: &Model) -> Trace {
        let count = self.starts.len();
        let mut trace = self.unknown();
        let mut lanes: Vec<usize> = (0..count).collect();
        let start = |start: &Origin| lags(&self.rows[start.row]);
        let mut lag_w: Vec<[f32; LAGS]> = self.starts.iter().map(start).collect();
        let mut energy_j = vec![0.0; count];
        let (mut inputs, mut out_w) = (Vec::with_capacity(count), vec![0.0; count]);
        let mut place = 0;
        for step in 0.. {
            lanes.retain(|lane| self.starts[*lane].row + step < self.starts[*lane].end);
            if lanes.is_empty() {
                break;
            }
            inputs.clear();
            inputs.extend(lanes.iter().map(|lane| {
                let start = self.starts[*lane].row;
                let mut inputs = with_lags(&self.rows[start + step], &lag_w[*lane]);
                if model.needs_freshness() {
                    // Sensor behaviour after the origin is unknown: the reading age continues by
                    // the schedule.
                    self.reading_ages[start].after(step as u64).fill(&mut inputs);
                }
                inputs
            }));
            let out_w = &mut out_w[..lanes.len()];
            model.predict(&inputs, out_w);
            let at_horizon = self.horizons.get(place) == Some(&(step + 1));
            let range = model.training_range();
            for (&lane, &power_w) in lanes.iter().zip(out_w.iter()) {
                let fed_back_w = range.map_or(power_w, |range| range.fed_back_w(power_w));
                push(&mut lag_w[lane], fed_back_w);
                energy_j[lane] += f64::from(power_w) * self.step_s[self.starts[lane].row + step];
                if at_horizon {
                    trace.power_w[place * count + lane] = power_w.into();
                    trace.energy_j[place * count + lane] = energy_j[lane];
                }
            }
            place += usize::from(at_horizon);
        }
        trace
    }

    /// Adds one horizon, origin by origin. Where a model has no forecast, no forecaster is scored.
    fn add(
        &self,
        sums: &mut HorizonSums,
        place: usize,
        measured: &Trace,
        traces: &[Trace],
        models: usize,
    ) {
        for (origin, start) in self.starts.iter().enumerate() {
            if start.row + self.horizons[place] > start.end {
                continue;
            }
            let at = place * self.starts.len() + origin;
            let known = traces[..models].iter().all(|trace| trace.power_w[at].is_finite());
            let of = |value: f64| if known { value } else { f64::NAN };
            for (forecaster, trace) in traces.iter().enumerate() {
                let (power, energy) = (&mut sums.power[forecaster], &mut sums.energy[forecaster]);
                power.add(of(measured.power_w[at]), trace.power_w[at], f64::NAN);
                energy.add(of(measured.energy_j[at]), trace.energy_j[at], 1.0);
            }
        }
    }
}

fn lags(row: &Row) -> [f32; LAGS] {
    std::array::from_fn(|lag| row.features[NEWEST + lag])
}

fn push(lag_w: &mut [f32; LAGS], power_w: f32) {
    lag_w.copy_within(..LAGS - 1, 1);
    lag_w[0] = power_w;
}

/// The row's features with other lagged readings.
fn with_lags(row: &Row, lag_w: &[f32; LAGS]) -> Features {
    let mut features = row.features;
    features[NEWEST..NEWEST + LAGS].copy_from_slice(lag_w);
    features
}
