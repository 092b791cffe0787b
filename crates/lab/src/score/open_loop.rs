//! Forecasters fed with their own forecasts: how far ahead they can be trusted.

use std::ops::Range;

use joulebus_predictor::{FeatureSet, Features, Freshness, LAGS, Model};

use super::blocks::HorizonSums;
use super::corrected::Lines;
use super::{Options, Recording};
use crate::linear::Linear;
use crate::metrics::Tally;
use crate::train::Row;

/// Position of the newest reading in [`Features`].
const NEWEST: usize = FeatureSet::PowerOnly.first();

/// Where a rollout begins, and where the rows end that it can be held against.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Origin {
    row: usize,
    end: usize,
    fold: usize,
}

/// Rows at which rollouts begin: every `every`-th of each stretch of `rows` without a gap, with the
/// row that ends the stretch.
pub fn origins(
    recording: &Recording,
    rows: Range<usize>,
    every: usize,
) -> impl Iterator<Item = (usize, usize)> {
    let seqs = &recording.rows.sample_seq;
    let mut stretches = Vec::new();
    let mut start = rows.start;
    for at in rows.clone() {
        let is_last = at + 1 == rows.end || seqs[at + 1] != seqs[at] + 1;
        if is_last {
            stretches.push((start, at + 1));
            start = at + 1;
        }
    }
    let each = stretches.into_iter();
    each.flat_map(move |(start, end)| (start..end).step_by(every).map(move |row| (row, end)))
}

/// Forecasts of one forecaster at every horizon of every origin: power, W, and energy up to there,
/// J. NaN past the end of the rows.
struct Trace {
    /// `horizon * origins + origin`.
    power_w: Vec<f64>,
    energy_j: Vec<f64>,
}

/// The sums at each horizon, over the evaluated parts of a recording.
pub(super) fn sums(
    models: &[Model],
    recording: &Recording,
    parts: &[(usize, Range<usize>)],
    lines: &Lines,
    options: &Options,
) -> Vec<HorizonSums> {
    let Some(&longest) = options.horizons.last() else {
        return Vec::new();
    };
    let mut starts = Vec::new();
    for (fold, rows) in parts {
        let found = origins(recording, rows.clone(), options.origins_every);
        starts.extend(found.map(|(row, end)| Origin {
            row,
            end: end.min(row + longest),
            fold: *fold,
        }));
    }
    let rollout = Rollout {
        rows: &recording.rows.rows,
        step_s: &recording.step_s,
        freshness: &recording.rows.freshness,
        starts: &starts,
        horizons: &options.horizons,
    };
    let measured = rollout.trace(&mut |step, lanes, _, out_w| {
        for (lane, out_w) in lanes.iter().zip(out_w) {
            *out_w = recording.rows.rows[starts[*lane].row + step].target_w;
        }
    });
    let traces = rollout.traces(models, lines);
    let places = 0..options.horizons.len();
    places
        .map(|place| rollout.sum(place, &measured, &traces, models.len()))
        .collect()
}

struct Rollout<'a> {
    rows: &'a [Row],
    step_s: &'a [f64],
    freshness: &'a [Freshness],
    starts: &'a [Origin],
    horizons: &'a [usize],
}

/// Given a step, the lanes that are still running and their rows: a forecast for each, W.
type Forecast<'a> = dyn FnMut(usize, &[usize], &[Features], &mut [f32]) + 'a;

impl Rollout<'_> {
    /// The models, persistence, the lines.
    fn traces(&self, models: &[Model], lines: &Lines) -> Vec<Trace> {
        let mut traces = Vec::new();
        for model in models {
            traces.push(self.trace(&mut |_, _, inputs, out_w| model.predict(inputs, out_w)));
        }
        let persistence = Linear::persistence();
        traces.push(self.line(|_| Some(&persistence)));
        let baselines = 0..lines.first().map_or(0, Vec::len);
        traces.extend(baselines.map(|place| {
            let of = |origin: &Origin| lines[origin.fold][place].as_ref();
            self.line(of)
        }));
        traces
    }

    fn line<'a>(&self, of: impl Fn(&Origin) -> Option<&'a Linear>) -> Trace {
        self.trace(&mut |_, lanes, inputs, out_w| {
            for ((lane, row), out_w) in lanes.iter().zip(inputs).zip(out_w) {
                let line = of(&self.starts[*lane]);
                *out_w = line.map_or(f32::NAN, |line| line.predict(row) as f32);
            }
        })
    }

    /// Runs every origin to the end of its rows, each step of all of them as one batch.
    fn trace(&self, forecast: &mut Forecast<'_>) -> Trace {
        let count = self.starts.len();
        let mut trace = Trace {
            power_w: vec![f64::NAN; self.horizons.len() * count],
            energy_j: vec![f64::NAN; self.horizons.len() * count],
        };
        let mut lanes: Vec<usize> = (0..count).collect();
        let mut lag_w: Vec<[f32; LAGS]> = self
            .starts
            .iter()
            .map(|start| lags(&self.rows[start.row]))
            .collect();
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
                let mut features = self.rows[self.starts[*lane].row + step].features;
                features[NEWEST..NEWEST + LAGS].copy_from_slice(&lag_w[*lane]);
                // What happens to the sensor after the origin is not known: the schedule goes on.
                let freshness = self.freshness[self.starts[*lane].row];
                freshness.after(step as u64).fill(&mut features);
                features
            }));
            let out_w = &mut out_w[..lanes.len()];
            forecast(step, &lanes, &inputs, out_w);
            let at_horizon = self.horizons.get(place) == Some(&(step + 1));
            for (&lane, &power_w) in lanes.iter().zip(out_w.iter()) {
                lag_w[lane].rotate_right(1);
                lag_w[lane][0] = power_w;
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

    /// One horizon, origin by origin. Where a model has no forecast, no forecaster is scored.
    fn sum(&self, place: usize, measured: &Trace, traces: &[Trace], models: usize) -> HorizonSums {
        let mut sums = HorizonSums {
            power: vec![Tally::default(); traces.len()],
            energy: vec![Tally::default(); traces.len()],
        };
        for (origin, start) in self.starts.iter().enumerate() {
            if start.row + self.horizons[place] > start.end {
                continue;
            }
            let at = place * self.starts.len() + origin;
            let known = traces[..models]
                .iter()
                .all(|trace| trace.power_w[at].is_finite());
            let of = |value: f64| if known { value } else { f64::NAN };
            for (forecaster, trace) in traces.iter().enumerate() {
                let (power, energy) = (&mut sums.power[forecaster], &mut sums.energy[forecaster]);
                power.add(of(measured.power_w[at]), trace.power_w[at], f64::NAN);
                energy.add(of(measured.energy_j[at]), trace.energy_j[at], 1.0);
            }
        }
        sums
    }
}

fn lags(row: &Row) -> [f32; LAGS] {
    std::array::from_fn(|lag| row.features[NEWEST + lag])
}
