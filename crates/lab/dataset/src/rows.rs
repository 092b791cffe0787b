//! Recorded samples as training rows: the features at one time and the next reading.

use std::collections::BTreeMap;

use hmac_sha256::Hash as Sha256;
use joulebus_predictor::{FEATURES, FeatureSet, Features, INPUTS, LAGS, ReadingAge, features};
use joulebus_wire::{Sample, sample_flag};

use crate::trial::Trial;

/// One training row: features and the reading that followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Raw features in SI units. Those outside the feature set may be NaN.
    pub features: Features,
    /// The next reading, W.
    pub target_w: f32,
    /// Its recording and its robot, as numbers in the dataset. Errors in one recording are not
    /// independent.
    pub origin: RowOrigin,
}

/// Where a row was recorded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct RowOrigin {
    /// Number of the recording.
    pub recording: u32,
    /// Number of the robot. The recording's, if the robot is not known.
    pub robot: u32,
}

impl RowOrigin {
    /// A recording of a robot that is not known.
    #[must_use]
    pub const fn recording(number: usize) -> Self {
        Self { recording: number as u32, robot: number as u32 }
    }

    /// Those of sources with these names of trial and robot. The parts of a trial of a robot are one
    /// recording.
    #[must_use]
    pub fn of_sources<'a>(names: impl Iterator<Item = (&'a str, &'a str)>) -> Vec<Self> {
        let (mut recordings, mut robots) = (BTreeMap::new(), BTreeMap::new());
        let origin = |(trial, robot)| {
            let (recording, of_robot) = (recordings.len() as u32, robots.len() as u32);
            Self {
                recording: *recordings.entry((trial, robot)).or_insert(recording),
                robot: *robots.entry(robot).or_insert(of_robot),
            }
        };
        names.map(origin).collect()
    }
}

impl Row {
    /// A row of the dataset's first recording.
    #[must_use]
    pub fn new(features: Features, target_w: f32) -> Self {
        Self { features, target_w, origin: RowOrigin::default() }
    }

    /// The same of another recording.
    #[must_use]
    pub const fn of(self, origin: RowOrigin) -> Self {
        Self { origin, ..self }
    }
}

/// Rows split by robot or trial, never by row, because neighbouring rows are correlated.
#[derive(Clone, Debug, PartialEq)]
pub struct Dataset {
    /// Rows for fitting weights and normalisation.
    pub training: Vec<Row>,
    /// Rows for early stopping.
    pub validation: Vec<Row>,
    /// Rows for scores and residuals only.
    pub held_out: Vec<Row>,
    /// Origin of the rows, for the model file.
    pub description: String,
    /// Time from a row to the next, s. 0 if unknown.
    pub period_s: f32,
}

impl Dataset {
    /// SHA-256 of all rows, hexadecimal: each part preceded by its length, numbers little-endian.
    /// The reading-age features are included only if `feature_set` has them: the hash identifies
    /// what the model was trained on.
    pub fn sha256(&self, feature_set: FeatureSet) -> String {
        let counted = match feature_set.needs_freshness() {
            true => INPUTS,
            false => FEATURES,
        };
        let mut digest = Sha256::new();
        for rows in [&self.training, &self.validation, &self.held_out] {
            digest.update((rows.len() as u64).to_le_bytes());
            for row in rows {
                for value in row.features[..counted].iter().chain([&row.target_w]) {
                    digest.update(value.to_le_bytes());
                }
            }
        }
        digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

/// The rows of a trial, in order, and the number of unused samples.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TrialRows {
    /// One row for each sample that has five gapless readings before it and a reading after it.
    pub rows: Vec<Row>,
    /// For each row, the number (from 0) of the sample on which its forecast is based.
    pub sample_seq: Vec<u64>,
    /// For each row, the age of its newest reading: its reading-age features, and their
    /// continuation if no further reading arrives.
    pub reading_ages: Vec<ReadingAge>,
    /// Samples without a row because their window of five readings is not full: at the start, and
    /// after a gap, a missing reading, or a time that does not advance.
    pub without_window: usize,
    /// Period of the samples, s.
    pub period_s: f32,
}

/// The rows of a trial: to the bit the features that the live tick passes to the model.
///
/// A gap of more than one and a half median periods empties the window, and so does a missing
/// reading: a model learns from readings, never from its own forecasts. Velocities that were not
/// recorded are NaN, and so is the reading age until two measurements have been seen.
pub fn trial_rows(trial: &Trial) -> TrialRows {
    // Only differences of time matter, but 0 means "never measured".
    sample_rows(&trial.to_samples(0, 1_000_000_000), trial.period_ns())
}

/// The rows of one robot's samples with period `period_ns`.
pub fn sample_rows(samples: &[Sample], period_ns: u64) -> TrialRows {
    let longest_ns = period_ns + period_ns / 2;
    let follows = |before: &Sample, after: &Sample| {
        let elapsed_ns = after.stamp_ns.saturating_sub(before.stamp_ns);
        elapsed_ns > 0 && elapsed_ns <= longest_ns && after.has(sample_flag::POWER)
    };
    let mut found =
        TrialRows { period_s: (period_ns as f64 * 1e-9) as f32, ..TrialRows::default() };
    let mut have = 0;
    let mut age = Age::default();
    for (at, sample) in samples.iter().enumerate() {
        age.take(sample, period_ns);
        let before = at.checked_sub(1).map(|before| &samples[before]);
        have = match before {
            _ if !sample.has(sample_flag::POWER) => 0,
            Some(before) if follows(before, sample) => have + 1,
            _ => 1,
        };
        if have < LAGS {
            found.without_window += 1;
            continue;
        }
        let Some(next) = samples.get(at + 1).filter(|next| follows(sample, next)) else {
            continue;
        };
        let lag_w = std::array::from_fn(|lag| samples[at - lag].power_w);
        let (v_mps, omega_radps) = command(sample).unwrap_or((f32::NAN, f32::NAN));
        let previous = before.and_then(|before| {
            let (v_mps, omega_radps) = command(before)?;
            let elapsed_ns = sample.stamp_ns.saturating_sub(before.stamp_ns);
            Some((v_mps, omega_radps, (elapsed_ns as f64 * 1e-9) as f32))
        });
        let mut features = features(v_mps, omega_radps, previous, &lag_w);
        age.reading_age.fill(&mut features);
        found.sample_seq.push(sample.seq);
        found.reading_ages.push(age.reading_age);
        found.rows.push(Row::new(features, next.power_w));
    }
    found
}

/// Age of the newest reading, computed as in the tick: gaps and missing readings advance it by the
/// schedule, and a sample whose time does not advance is ignored.
struct Age {
    reading_age: ReadingAge,
    /// Stamp of the last accepted sample.
    stamp_ns: Option<u64>,
}

impl Default for Age {
    fn default() -> Self {
        Self { reading_age: ReadingAge::UNKNOWN, stamp_ns: None }
    }
}

impl Age {
    fn take(&mut self, sample: &Sample, period_ns: u64) {
        if self.stamp_ns.is_some_and(|before_ns| sample.stamp_ns <= before_ns) {
            return;
        }
        let before_ns = self.stamp_ns.replace(sample.stamp_ns);
        match before_ns {
            _ if sample.has(sample_flag::DISCONTINUITY) => self.reading_age = ReadingAge::UNKNOWN,
            Some(before_ns) => {
                let missing = ReadingAge::missing_steps(sample.stamp_ns - before_ns, period_ns);
                self.reading_age.pass(missing);
            }
            None => {}
        }
        match sample.has(sample_flag::POWER) {
            true => self.reading_age.read(!sample.has(sample_flag::HELD)),
            false => self.reading_age.pass(1),
        }
    }
}

fn command(sample: &Sample) -> Option<(f32, f32)> {
    let known = sample.has(sample_flag::V) && sample.has(sample_flag::OMEGA);
    known.then_some((sample.v_mps, sample.omega_radps))
}
