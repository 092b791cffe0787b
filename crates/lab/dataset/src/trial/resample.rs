//! Resampling of a trial. It is done only on request, because every method changes recorded values.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::table::Columns;
use super::{Column, MAX_ROWS, Table, Trial, TrialError, note};

/// Value at a time of the grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// The latest row (zero-order hold). Every value is one that was recorded.
    Hold,
    /// The mean over the grid period that ends here, each row held until the next: mean power times
    /// the period is the energy of the rows.
    Mean,
    /// Linear interpolation between the adjacent rows.
    Linear,
}

/// Configuration of resampling.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Resample {
    /// Value at a time of the grid.
    pub method: Method,
    /// Rows per second, above 0 and up to 100,000. The grid starts at the first row.
    pub rate_hz: f64,
}

/// Row counts before and after resampling.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Resampled {
    /// Rows before.
    pub rows_before: usize,
    /// Rows after.
    pub rows: usize,
    /// Rows left out because their time is not later than all times before.
    pub not_advancing: usize,
    /// Times of the grid without a row, because they lie in a gap: gaps are kept.
    pub in_gaps: usize,
}

/// Errors of resampling.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum ResampleError {
    #[error("found a rate of {rate_hz} Hz, allowed: above 0 and up to {MAX_RATE_HZ}")]
    Rate { rate_hz: f64 },
    #[error("{duration_s} s at {rate_hz} Hz are more than {MAX_ROWS} rows. Take a lower rate")]
    TooManyRows { duration_s: f64, rate_hz: f64 },
    #[error("{duration_s} s at {rate_hz} Hz leave fewer than two rows. Take a higher rate")]
    TooFewRows { duration_s: f64, rate_hz: f64 },
    #[error(transparent)]
    Trial(#[from] TrialError),
}

const MAX_RATE_HZ: f64 = 100_000.0;
/// Times in files are rounded: a row less than this after a time of the grid, as a share of its
/// period, is taken as simultaneous.
const AT_THE_SAME_TIME: f64 = 1e-3;
/// Share of a grid period without rows that is attributed to rounding.
const ROUNDING: f64 = 1e-6;

impl Trial {
    /// The trial on another grid. See [`Table::resampled`].
    ///
    /// # Errors
    /// [`ResampleError`].
    pub fn resampled(&self, how: Resample) -> Result<(Self, Resampled), ResampleError> {
        let (table, counts) = self.table.resampled(how)?;
        Ok((Self::from_si(table)?, counts))
    }
}

impl Table {
    /// The table on another grid, which begins at its first row.
    ///
    /// A row is held until the next one. Before a gap of more than one and a half median periods,
    /// and at the end, for one median period. Times of the grid that no row covers get no row: gaps
    /// are kept. Where a value was not recorded, the values computed from it are NaN: with
    /// [`Method::Mean`] wherever its row contributes, with [`Method::Linear`] between it and the
    /// next. `phase` is categorical: the value of the earliest contributing row. `theta_rad` is
    /// interpolated along the shorter arc.
    ///
    /// # Errors
    /// [`ResampleError`].
    pub fn resampled(&self, how: Resample) -> Result<(Self, Resampled), ResampleError> {
        let (grid, counts) = resample(&self.timestamp_s, &self.columns, how)?;
        Ok((grid.of(&self.path, self.robot_name.as_deref()), counts))
    }
}

/// The rows that advance, and how long each is held.
struct Spans {
    row: Vec<usize>,
    from_s: Vec<f64>,
    until_s: Vec<f64>,
}

impl Spans {
    fn new(timestamp_s: &[f64]) -> Self {
        let offset_ns = note::offsets_ns(timestamp_s);
        let period_ns = note::median_step_ns(&offset_ns).unwrap_or(1);
        let longest_ns = (period_ns + period_ns / 2).cast_signed();
        let mut row = Vec::with_capacity(timestamp_s.len());
        for at in 0..timestamp_s.len() {
            if row.last().is_none_or(|last: &usize| offset_ns[at] > offset_ns[*last]) {
                row.push(at);
            }
        }
        let first_s = timestamp_s.first().copied().unwrap_or_default();
        let from_s: Vec<f64> = row.iter().map(|at| timestamp_s[*at] - first_s).collect();
        let until_s = (0..row.len())
            .map(|at| match row.get(at + 1) {
                Some(next) if offset_ns[*next] - offset_ns[row[at]] <= longest_ns => from_s[at + 1],
                _ => from_s[at] + period_ns as f64 * 1e-9,
            })
            .collect();
        Self { row, from_s, until_s }
    }

    fn end_s(&self) -> f64 {
        self.from_s.last().copied().unwrap_or_default()
    }

    /// True if the next row follows without a gap.
    fn is_followed(&self, at: usize) -> bool {
        self.from_s.get(at + 1) == Some(&self.until_s[at])
    }
}

struct Grid {
    timestamp_s: Vec<f64>,
    columns: Columns,
}

impl Grid {
    fn of(self, path: &Path, robot_name: Option<&str>) -> Table {
        let Self { timestamp_s, columns } = self;
        Table {
            path: path.to_owned(),
            robot_name: robot_name.map(str::to_owned),
            // Fewer than MAX_ROWS, which fits u32.
            file_row: (1..=timestamp_s.len() as u32).collect(),
            timestamp_s,
            columns,
            ..Table::default()
        }
    }
}

fn resample(
    timestamp_s: &[f64],
    columns: &Columns,
    how: Resample,
) -> Result<(Grid, Resampled), ResampleError> {
    let Resample { method, rate_hz } = how;
    if !(rate_hz > 0.0 && rate_hz <= MAX_RATE_HZ) {
        return Err(ResampleError::Rate { rate_hz });
    }
    let spans = Spans::new(timestamp_s);
    let duration_s = spans.end_s();
    let wanted = duration_s * rate_hz;
    if wanted + 2.0 > MAX_ROWS as f64 {
        return Err(ResampleError::TooManyRows { duration_s, rate_hz });
    }
    let parts = match method {
        Method::Hold => held(&spans, rate_hz),
        Method::Linear => between(&spans, rate_hz),
        Method::Mean => averaged(&spans, rate_hz),
    };
    let emitted: Vec<&Part> = parts.iter().filter(|part| !part.shares.is_empty()).collect();
    if emitted.len() < 2 {
        return Err(ResampleError::TooFewRows { duration_s, rate_hz });
    }
    let first_s = timestamp_s.first().copied().unwrap_or_default();
    let grid_s = emitted.iter().map(|part| first_s + part.number as f64 / rate_hz);
    let mut made: Columns = Default::default();
    for (column, (made, values)) in Column::ALL.into_iter().zip(made.iter_mut().zip(columns)) {
        *made = values.as_ref().map(|values| {
            let value = |part: &&Part| part.value(column, values, &spans);
            emitted.iter().map(value).collect()
        });
    }
    let counts = Resampled {
        rows_before: timestamp_s.len(),
        rows: emitted.len(),
        not_advancing: timestamp_s.len() - spans.row.len(),
        in_gaps: parts.len() - emitted.len(),
    };
    let grid = Grid { timestamp_s: grid_s.collect(), columns: made };
    Ok((grid, counts))
}

/// Contributions to a time of the grid: rows with weights that sum to 1. None in a gap.
struct Part {
    number: usize,
    shares: Vec<(usize, f64)>,
}

impl Part {
    fn value(&self, column: Column, values: &[f64], spans: &Spans) -> f64 {
        let value = |at: usize| values[spans.row[at]];
        match (column, self.shares.as_slice()) {
            (_, [(at, _)]) => value(*at),
            (Column::Phase, [(at, _), ..]) => value(*at),
            (Column::Theta, shares) => angle(shares.iter().map(|(at, share)| (value(*at), *share))),
            (_, shares) => weighted(shares.iter().map(|(at, share)| (value(*at), *share))),
        }
    }
}

/// Summed relative to the first value, so that equal values give that value to the bit.
fn weighted(mut shares: impl Iterator<Item = (f64, f64)>) -> f64 {
    let first = shares.next().map_or(f64::NAN, |(value, _)| value);
    first + shares.map(|(value, share)| (value - first) * share).sum::<f64>()
}

/// The same for angles: each difference along the shorter arc.
fn angle(mut shares: impl Iterator<Item = (f64, f64)>) -> f64 {
    use std::f64::consts::{PI, TAU};
    let first = shares.next().map_or(f64::NAN, |(value, _)| value);
    let turn = |value: f64| {
        let away = value - first;
        if away.abs() > PI { away - TAU * (away / TAU).round() } else { away }
    };
    first + shares.map(|(value, share)| turn(value) * share).sum::<f64>()
}

/// Times of the grid up to `end_s`, plus `more` of a period.
fn grid(end_s: f64, rate_hz: f64, more: f64) -> impl Iterator<Item = (usize, f64)> {
    let last = (end_s * rate_hz + more).floor() as usize;
    (0..=last).map(move |number| (number, number as f64 / rate_hz))
}

fn held(spans: &Spans, rate_hz: f64) -> Vec<Part> {
    let near_s = AT_THE_SAME_TIME / rate_hz;
    let mut at = 0;
    let part = |(number, time_s): (usize, f64)| {
        while spans.from_s.get(at + 1).is_some_and(|next| *next <= time_s + near_s) {
            at += 1;
        }
        let counts = spans.is_followed(at) || time_s < spans.until_s[at];
        let shares = if counts { vec![(at, 1.0)] } else { Vec::new() };
        Part { number, shares }
    };
    grid(spans.end_s(), rate_hz, AT_THE_SAME_TIME).map(part).collect()
}

fn between(spans: &Spans, rate_hz: f64) -> Vec<Part> {
    let near_s = AT_THE_SAME_TIME / rate_hz;
    let mut at = 0;
    let part = |(number, time_s): (usize, f64)| {
        while spans.from_s.get(at + 1).is_some_and(|next| *next <= time_s) {
            at += 1;
        }
        let after_s = time_s - spans.from_s[at];
        let shares = if after_s == 0.0 || (!spans.is_followed(at) && after_s <= near_s) {
            vec![(at, 1.0)]
        } else if spans.is_followed(at) {
            let share = after_s / (spans.until_s[at] - spans.from_s[at]);
            vec![(at, 1.0 - share), (at + 1, share)]
        } else {
            Vec::new()
        };
        Part { number, shares }
    };
    grid(spans.end_s(), rate_hz, AT_THE_SAME_TIME).map(part).collect()
}

fn averaged(spans: &Spans, rate_hz: f64) -> Vec<Part> {
    let period_s = 1.0 / rate_hz;
    let end_s = spans.until_s.last().copied().unwrap_or_default();
    let mut first = 0;
    let part = |(number, until_s): (usize, f64)| {
        let from_s = (number - 1) as f64 / rate_hz;
        while first < spans.row.len() && spans.until_s[first] <= from_s {
            first += 1;
        }
        let mut shares = Vec::new();
        let mut covered_s = 0.0;
        for at in first..spans.row.len() {
            if spans.from_s[at] >= until_s {
                break;
            }
            let counts_s = spans.until_s[at].min(until_s) - spans.from_s[at].max(from_s);
            if counts_s > ROUNDING * period_s * 1e-3 {
                shares.push((at, counts_s));
                covered_s += counts_s;
            }
        }
        if covered_s < period_s * (1.0 - ROUNDING) {
            shares.clear();
        }
        for (_, share) in &mut shares {
            *share /= covered_s;
        }
        Part { number, shares }
    };
    // The first row is at time 0, so the first full period ends one period later.
    grid(end_s, rate_hz, ROUNDING / 2.0).skip(1).map(part).collect()
}
