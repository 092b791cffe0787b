//! Delays to find faults, beside those of simpler alarms.

use joulebus_settings::SettingsError;
use joulebus_statistics::metrics::{quantile, sorted};
use joulebus_wire::{Sample, sample_flag};
use rayon::prelude::*;
use serde::Serialize;

use super::fault::Fault;
use super::play::Robot;

/// Rows between the settling of the residuals and a fault.
const SPARE_ROWS: usize = 10;
/// Minimum time that remains for finding a fault, s.
const MIN_S: f64 = 5.0;

/// Delays to find a fault.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Delays {
    /// The fault.
    #[serde(flatten)]
    pub fault: Fault,
    /// Delay with the calibrated limits, and the alarms that samples raise themselves.
    pub calibrated: Delay,
    /// Delay with a limit of power.
    pub power: Delay,
    /// Delay with a limit of voltage.
    pub voltage: Delay,
}

/// Time from a fault to its alarm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Delay {
    /// Share of the recordings in which it was found before their end.
    pub found: f64,
    /// Median, s. NaN (null in JSON) if too few recordings found the fault.
    pub median_s: f64,
    /// 90 % quantile, s. NaN likewise.
    pub q90_s: f64,
}

impl Delay {
    /// Summarises the time until the fault was found, in each recording.
    pub(super) fn new(times_s: &[Option<f64>]) -> Self {
        let found = times_s.iter().flatten().count() as f64 / times_s.len() as f64;
        // A fault that was not found counts as later than all others.
        let times_s = times_s.iter().map(|time_s| time_s.unwrap_or(f64::MAX));
        let ascending = sorted(times_s);
        let known = |share: f64| {
            let place = (share * ascending.len() as f64).ceil() as usize;
            let time_s = ascending.get(place.saturating_sub(1));
            time_s.copied().filter(|time_s| *time_s < f64::MAX)
        };
        Self {
            found,
            median_s: known(0.5).unwrap_or(f64::NAN),
            q90_s: known(0.9).unwrap_or(f64::NAN),
        }
    }
}

/// Alarms above a power and below a voltage.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Thresholds {
    /// Alarm above, W.
    pub power_w: f64,
    /// Alarm below, V. `None` without voltages.
    pub voltage_v: Option<f64>,
    /// Share of the recordings that state the rate in which power raises a false alarm.
    pub power_false: f64,
    /// The same of voltage.
    pub voltage_false: f64,
}

impl Thresholds {
    /// The thresholds beyond which as many recordings of the first half go as the calibrated limits
    /// raised alarms on them.
    pub(super) fn new(first: &[Vec<Sample>], second: &[Vec<Sample>], alarms: u64) -> Self {
        // The alarms' extremes, ascending.
        let beyond = |extremes: Vec<f64>| {
            let last = extremes.len().saturating_sub(1);
            let place = usize::try_from(alarms).unwrap_or(last).min(last);
            extremes.get(place).copied()
        };
        let greatest_w = first.iter().filter_map(|samples| greatest(samples, power_w));
        let least_v = first.iter().filter_map(|samples| greatest(samples, below_v));
        let power_w_limit = beyond(sorted(greatest_w.map(|greatest_w| -greatest_w)));
        let voltage_v = beyond(sorted(least_v.map(|greatest_v| -greatest_v)));
        let mut thresholds = Self {
            power_w: power_w_limit.map_or(f64::INFINITY, |negative_w| -negative_w),
            voltage_v,
            power_false: 0.0,
            voltage_false: 0.0,
        };
        let share = |found: &dyn Fn(&[Sample]) -> bool| {
            let count = second.iter().filter(|samples| found(samples)).count();
            count as f64 / second.len().max(1) as f64
        };
        thresholds.power_false = share(&|samples| thresholds.by_power(samples, 0).is_some());
        thresholds.voltage_false = share(&|samples| thresholds.by_voltage(samples, 0).is_some());
        thresholds
    }

    /// When power is first above, from a time on, ns.
    fn by_power(&self, samples: &[Sample], from_ns: u64) -> Option<u64> {
        first(samples, from_ns, power_w, self.power_w)
    }

    fn by_voltage(&self, samples: &[Sample], from_ns: u64) -> Option<u64> {
        first(samples, from_ns, below_v, -self.voltage_v?)
    }
}

fn power_w(sample: &Sample) -> Option<f64> {
    sample.has(sample_flag::POWER).then_some(sample.power_w.into())
}

/// The voltage, negative.
fn below_v(sample: &Sample) -> Option<f64> {
    let known = sample.has(sample_flag::VOLTAGE);
    known.then_some(-f64::from(sample.voltage_v))
}

fn greatest(samples: &[Sample], value: fn(&Sample) -> Option<f64>) -> Option<f64> {
    samples.iter().filter_map(value).reduce(f64::max)
}

fn first(
    samples: &[Sample],
    from_ns: u64,
    value: fn(&Sample) -> Option<f64>,
    limit: f64,
) -> Option<u64> {
    let mut late = samples.iter().filter(|sample| sample.stamp_ns >= from_ns);
    let found = late.find(|sample| value(sample).is_some_and(|value| value > limit));
    found.map(|sample| sample.stamp_ns)
}

/// Recordings with the time at which a fault begins.
pub(super) struct Faulty<'a>(Vec<(&'a [Sample], u64)>);

impl<'a> Faulty<'a> {
    /// Keeps recordings whose residuals have settled before two fifths of the rows, where faults
    /// begin.
    pub(super) fn new(recordings: &'a [Vec<Sample>], settle_samples: usize) -> Self {
        let begins = |samples: &'a Vec<Sample>| {
            let row = samples.len() / 5 * 2;
            let (from_ns, last_ns) = (samples.get(row)?.stamp_ns, samples.last()?.stamp_ns);
            let fits = row >= settle_samples + SPARE_ROWS && since_s(from_ns, last_ns) >= MIN_S;
            fits.then_some((samples.as_slice(), from_ns))
        };
        Self(recordings.iter().filter_map(begins).collect())
    }

    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// Median of the time between a fault and the recording's end, s.
    pub(super) fn after_s(&self) -> f64 {
        let after_s = self.0.iter().map(|(samples, from_ns)| {
            let last_ns = samples.last().map_or(*from_ns, |last| last.stamp_ns);
            since_s(*from_ns, last_ns)
        });
        quantile(&sorted(after_s), 0.5)
    }

    /// Delays to find each fault.
    pub(super) fn delays(
        &self,
        calibrated: &Robot,
        thresholds: &Thresholds,
    ) -> Result<Vec<Delays>, SettingsError> {
        if self.0.is_empty() {
            return Ok(Vec::new());
        }
        let row = |fault: Fault| {
            Ok(Delays {
                fault,
                calibrated: self.found(fault, |samples, from_ns| {
                    Ok(calibrated.play(samples, Some(from_ns))?.found_ns)
                })?,
                power: self
                    .found(fault, |samples, from_ns| Ok(thresholds.by_power(samples, from_ns)))?,
                voltage: self
                    .found(fault, |samples, from_ns| Ok(thresholds.by_voltage(samples, from_ns)))?,
            })
        };
        Fault::ALL.into_iter().map(row).collect()
    }

    fn found(
        &self,
        fault: Fault,
        when: impl Fn(&[Sample], u64) -> Result<Option<u64>, SettingsError> + Sync,
    ) -> Result<Delay, SettingsError> {
        let times_s = self.0.par_iter().map(|(samples, from_ns)| {
            let found_ns = when(&fault.put_into(samples, *from_ns), *from_ns)?;
            Ok(found_ns.map(|found_ns| since_s(*from_ns, found_ns)))
        });
        let times_s: Vec<Option<f64>> = times_s.collect::<Result<_, SettingsError>>()?;
        Ok(Delay::new(&times_s))
    }
}

fn since_s(from_ns: u64, to_ns: u64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-9
}
