//! Faults put into recordings.

use joulebus_wire::{Sample, sample_flag};
use serde::Serialize;

/// A fault from a time on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "fault", content = "share")]
pub enum Fault {
    /// No fault: an alarm is a false alarm.
    None,
    /// The robot draws this share of its mean power more.
    ExtraLoad(f64),
    /// The same, growing by this share a minute.
    Drift(f64),
    /// The monitor shows this share more than there is.
    Gain(f64),
    /// The monitor repeats its last value and marks it as new.
    StuckSensor,
    /// Readings are missing.
    Dropout,
}

impl Fault {
    /// The faults that are put into every recording.
    pub const ALL: [Self; 12] = [
        Self::None,
        Self::ExtraLoad(0.1),
        Self::ExtraLoad(0.3),
        Self::ExtraLoad(1.0),
        Self::Drift(0.3),
        Self::Drift(1.0),
        Self::Drift(3.0),
        Self::Gain(0.1),
        Self::Gain(0.3),
        Self::Gain(1.0),
        Self::StuckSensor,
        Self::Dropout,
    ];

    /// The name in tables.
    pub fn name(self) -> String {
        let percent = |share: f64| 100.0 * share;
        match self {
            Self::None => "none".to_owned(),
            Self::ExtraLoad(share) => format!("extra load +{:.0} %", percent(share)),
            Self::Drift(share) => format!("drift +{:.0} %/min", percent(share)),
            Self::Gain(share) => format!("gain +{:.0} %", percent(share)),
            Self::StuckSensor => "stuck sensor".to_owned(),
            Self::Dropout => "dropout".to_owned(),
        }
    }

    /// Samples with the fault from `from_ns` on. What draws power in truth also lowers the voltage,
    /// by the slope of voltage over power in the recording.
    pub(super) fn put_into(self, samples: &[Sample], from_ns: u64) -> Vec<Sample> {
        let (mean_w, v_per_w) = (mean_w(samples), slope(samples));
        let mut last_w = None;
        let mut put = samples.to_vec();
        for sample in &mut put {
            if !sample.has(sample_flag::POWER) {
                continue;
            }
            if sample.stamp_ns < from_ns {
                last_w = Some(sample.power_w);
                continue;
            }
            let since_min = (sample.stamp_ns - from_ns) as f64 / 60e9;
            match self {
                Self::None => {}
                Self::ExtraLoad(share) => load(sample, share * mean_w, v_per_w),
                Self::Drift(share) => load(sample, share * since_min * mean_w, v_per_w),
                Self::Gain(share) => sample.power_w *= 1.0 + share as f32,
                Self::StuckSensor => {
                    sample.power_w = last_w.unwrap_or(sample.power_w);
                    sample.measured_ns = sample.stamp_ns;
                    sample.flags &= !sample_flag::HELD;
                }
                Self::Dropout => {
                    sample.flags &= !(sample_flag::POWER | sample_flag::HELD);
                    (sample.power_w, sample.measured_ns) = (f32::NAN, 0);
                }
            }
        }
        put
    }
}

fn load(sample: &mut Sample, added_w: f64, v_per_w: f64) {
    sample.power_w += added_w as f32;
    sample.voltage_v += (added_w * v_per_w) as f32;
}

fn readings(samples: &[Sample]) -> impl Iterator<Item = (f64, f64)> {
    let known = samples.iter().filter(|sample| sample.has(sample_flag::POWER));
    known.map(|sample| (f64::from(sample.power_w), f64::from(sample.voltage_v)))
}

fn mean_w(samples: &[Sample]) -> f64 {
    let sum_w: f64 = readings(samples).map(|(power_w, _)| power_w).sum();
    sum_w / f64::max(readings(samples).count() as f64, 1.0)
}

/// Slope of voltage over power by least squares, V/W, at most 0. 0 without voltages.
fn slope(samples: &[Sample]) -> f64 {
    let pairs: Vec<(f64, f64)> = readings(samples).filter(|(_, v)| v.is_finite()).collect();
    let count = pairs.len().max(1) as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / count;
    let (mean_w, mean_v) = (mean(|pair| pair.0), mean(|pair| pair.1));
    let (mut both, mut squares) = (0.0, 0.0);
    for (power_w, voltage_v) in &pairs {
        both += (power_w - mean_w) * (voltage_v - mean_v);
        squares += (power_w - mean_w) * (power_w - mean_w);
    }
    if squares > 0.0 { (both / squares).min(0.0) } else { 0.0 }
}
