//! Gain of online learning over the network alone: the platform option `forecast`, evaluated by the
//! live tick on recorded trials, compared with persistence and the model file's linear baseline.

use joulebus_predictor::{FEATURES, FeatureSet, Linear, Model, Network};
use joulebus_settings::{FleetSettings, Platform};

use crate::evaluate::{EvaluateError, RobotEvaluation, evaluate_trial};
use crate::score::recorded_platform;
use joulebus_dataset::rows::{TrialRows, sample_rows};
use joulebus_dataset::trial::Trial;
use joulebus_statistics::metrics::{CoverageTally, Tally};

/// The two ways to forecast with a network, in the order of [`Judged::variants`], and whether each
/// learns online.
pub const VARIANTS: [(&str, bool); 2] = [("network", false), ("online", true)];

/// Minimum number of readings of a trial for its coverage to be judged: with fewer, one reading
/// changes it by half a percent or more.
pub const FEWEST_READINGS: u64 = 200;
/// Index of the feature that states whether a new measurement is due.
const DUE: usize = FEATURES + 1;
/// Readings of a trial that are judged separately, as its first ones.
pub const FIRST: usize = 100;
/// The very first of them.
pub const START: usize = 30;
/// Allowed deviation of a trial's coverage from the nominal one.
pub const TOLERANCE: f64 = 0.02;

/// Scores on the same readings. Each trial is a separate robot without prior state.
#[derive(Debug, Clone)]
pub struct Judged {
    /// Trials judged.
    pub trials: usize,
    /// Persistence.
    pub persistence: Tally,
    /// The model file's linear baseline, if it has one.
    pub linear: Option<Tally>,
    /// Persistence over the first [`START`] readings of all trials.
    pub start: Tally,
    /// Persistence's squared error plus, for each reading, that of half the monitor's resolution.
    pub allowed: Parts,
    /// In the order of [`VARIANTS`].
    pub variants: [Variant; VARIANTS.len()],
}

/// One variant.
#[derive(Debug, Clone, Default)]
pub struct Variant {
    /// Its forecasts.
    pub forecasts: Tally,
    /// Its forecasts of the first [`START`] readings of all trials.
    pub start: Tally,
    /// Its squared error.
    pub squares: Parts,
    /// Its intervals, of all trials.
    pub intervals: CoverageTally,
    /// The intervals of readings for which a new measurement was due.
    pub due: CoverageTally,
    /// Share of readings inside their interval, per trial of at least [`FEWEST_READINGS`] readings.
    pub coverage: Vec<f64>,
}

/// Sums of squares over parts of the trials, W².
#[derive(Debug, Clone, Default)]
pub struct Parts {
    /// The first [`START`] readings of each trial.
    pub starts: Vec<f64>,
    /// The first [`FIRST`] readings of all trials.
    pub first: f64,
    /// All later readings.
    pub later: f64,
}

impl Parts {
    fn add(&mut self, at: usize, square: f64) {
        if at == 0 {
            self.starts.push(0.0);
        }
        // Without a forecast there is no error.
        if !square.is_finite() {
            return;
        }
        if let (true, Some(start)) = (at < START, self.starts.last_mut()) {
            *start += square;
        }
        *(if at < FIRST { &mut self.first } else { &mut self.later }) += square;
    }

    /// The largest ratio of a trial's start to the same start of `others`.
    pub fn worst_start(&self, others: &Self) -> f64 {
        let ratios = self.starts.iter().zip(&others.starts).map(|(square, other)| square / other);
        ratios.fold(f64::NAN, f64::max)
    }
}

impl Variant {
    /// Share of the trials whose coverage is within [`TOLERANCE`] of `wanted`. NaN without a trial.
    pub fn held(&self, wanted: f64) -> f64 {
        // The quotient of two counts differs from the tolerance by rounding at most.
        let holds = |coverage: &&f64| (**coverage - wanted).abs() <= TOLERANCE + 1e-9;
        self.coverage.iter().filter(holds).count() as f64 / self.coverage.len() as f64
    }
}

impl Judged {
    /// Squared error over the first [`START`] readings of persistence and of a variant, each as a
    /// share of the variant's whole squared error. R² over them says little: a robot that rests has
    /// no variance to explain.
    pub fn start_shares(&self, variant: usize) -> [f64; 2] {
        let square = |tally: &Tally| match tally.count() {
            0 => 0.0,
            count => count as f64 * tally.rmse_w() * tally.rmse_w(),
        };
        let variant = &self.variants[variant];
        [&self.start, &variant.start].map(|start| square(start) / square(&variant.forecasts))
    }

    /// The best R² of persistence, the linear baseline and the network alone.
    pub fn best_member_r2(&self) -> f64 {
        let linear = self.linear.as_ref().map_or(f64::NEG_INFINITY, Tally::r2);
        let [network, ..] = &self.variants;
        self.persistence.r2().max(linear).max(network.forecasts.r2())
    }
}

/// Evaluates a network on trials, each sample through the live tick as in [`evaluate_trial`].
///
/// Scored are the readings that follow five others without a gap, so that every forecaster has the
/// same inputs. The tick's forecasts over gaps are not scored.
///
/// # Errors
/// [`EvaluateError`]: settings that are refused.
pub fn judge(
    network: &Network,
    platform: &Platform,
    settings: &FleetSettings,
    trials: &[&Trial],
) -> Result<Judged, EvaluateError> {
    let from_start: Vec<_> = trials.iter().map(|trial| (*trial, 0)).collect();
    judge_from(network, platform, settings, &from_start)
}

/// Same as [`judge`], of forecasts from one row of each trial on. The rows before it only teach.
///
/// # Errors
/// As [`judge`].
pub fn judge_from(
    network: &Network,
    platform: &Platform,
    settings: &FleetSettings,
    trials: &[(&Trial, usize)],
) -> Result<Judged, EvaluateError> {
    let model = Model::Network(network.clone());
    let mut judged = Judged {
        trials: trials.len(),
        persistence: Tally::default(),
        linear: model.linear().map(|_| Tally::default()),
        start: Tally::default(),
        allowed: Parts::default(),
        variants: std::array::from_fn(|_| Variant::default()),
    };
    for (trial, from) in trials {
        let mut rows = sample_rows(&trial.to_samples(0, 1_000_000_000), trial.period_ns());
        let before = rows.sample_seq.partition_point(|seq| (*seq as usize) < *from);
        rows.rows.drain(..before);
        rows.sample_seq.drain(..before);
        judged.baselines(&rows, model.linear(), platform.power_resolution_w);
        for ((_, online), variant) in VARIANTS.iter().zip(&mut judged.variants) {
            let settings = FleetSettings {
                platforms: vec![of_trial(platform, trial, *online)],
                ..settings.clone()
            };
            let live = evaluate_trial(&settings, std::slice::from_ref(&model), 0, trial)?;
            variant.take(&live, &rows);
        }
    }
    Ok(judged)
}

/// The platform with the trial's recorded period.
fn of_trial(platform: &Platform, trial: &Trial, online: bool) -> Platform {
    Platform {
        power_resolution_w: platform.power_resolution_w,
        power_min_w: platform.power_min_w,
        power_max_w: platform.power_max_w,
        online,
        ..recorded_platform(0, trial)
    }
}

impl Judged {
    fn baselines(&mut self, rows: &TrialRows, linear: Option<&Linear>, resolution_w: f32) {
        for (at, row) in rows.rows.iter().enumerate() {
            let reading_w = f64::from(row.target_w);
            let last_w = row.features[FeatureSet::PowerOnly.first()];
            self.persistence.add(reading_w, last_w.into(), 0.0);
            if at < START {
                self.start.add(reading_w, last_w.into(), 0.0);
            }
            let error_w = reading_w - f64::from(last_w);
            self.allowed.add(at, error_w.powi(2) + (f64::from(resolution_w) / 2.0).powi(2));
            if let (Some(tally), Some(linear)) = (&mut self.linear, linear) {
                tally.add(reading_w, linear.predict(&row.features).into(), 0.0);
            }
        }
    }
}

impl Variant {
    fn take(&mut self, live: &RobotEvaluation, rows: &TrialRows) {
        let mut intervals = CoverageTally::default();
        for (at, (row, seq)) in rows.rows.iter().zip(&rows.sample_seq).enumerate() {
            // One step per sample, in order.
            let Some(step) = live.steps.get(*seq as usize) else {
                continue;
            };
            let reading_w = f64::from(row.target_w);
            let known = |watts: Option<f32>| watts.map_or(f64::NAN, f64::from);
            self.forecasts.add(reading_w, known(step.power_w), 0.0);
            if at < START {
                self.start.add(reading_w, known(step.power_w), 0.0);
            }
            self.squares.add(at, (reading_w - known(step.power_w)).powi(2));
            intervals.add(reading_w, known(step.lo_w), known(step.hi_w));
            // NaN means unknown, and then a reading is due.
            if row.features[DUE] != 0.0 {
                self.due.add(reading_w, known(step.lo_w), known(step.hi_w));
            }
        }
        if intervals.count() >= FEWEST_READINGS {
            self.coverage.push(intervals.coverage());
        }
        self.intervals.merge(&intervals);
    }
}
