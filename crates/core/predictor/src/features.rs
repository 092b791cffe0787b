//! Input features of the network.

use std::ops::Range;

/// Number of power readings in the lag window.
pub const LAGS: usize = 5;

/// Number of features that the paper's network reads: the first ones of a row.
pub const FEATURES: usize = 11;

/// Number of features in a row: the paper's, followed by the two of [`crate::ReadingAge`].
pub const INPUTS: usize = FEATURES + 2;

/// One row of raw features in SI units, in the order of [`FEATURE_NAMES`]. Unknown values are NaN.
///
/// [`features`](features()) has an example.
pub type Features = [f32; INPUTS];

/// Name of each feature with its unit. The power readings come newest first.
pub const FEATURE_NAMES: [&str; INPUTS] = [
    "v_mps",
    "omega_radps",
    "dv_mps2",
    "domega_radps2",
    "abs_v_mps",
    "abs_omega_radps",
    "power_lag1_w",
    "power_lag2_w",
    "power_lag3_w",
    "power_lag4_w",
    "power_lag5_w",
    "reading_age_steps",
    "reading_due",
];

/// Builds the row for the forecast of the next reading.
///
/// `v_mps` and `omega_radps` are the current command, `previous` is the command before it with the
/// true time between the two in seconds, `lag_w` the last readings in watt, newest first. Without a
/// previous command both derivatives are 0. A time step that is not positive makes both derivatives
/// NaN, so that the forecast is visibly invalid instead of plausible and wrong.
///
/// The reading-age features are NaN: [`crate::ReadingAge::fill`] sets them.
///
/// ```
/// use joulebus_predictor::{FEATURE_NAMES, features};
///
/// // 0.2 m/s, half a second after 0.1 m/s. The newest reading is 4.2 W.
/// let row = features(0.2, 0.0, Some((0.1, 0.0, 0.5)), &[4.2, 4.0, 4.0, 4.0, 4.0]);
/// let value = |name| FEATURE_NAMES.iter().position(|known| *known == name).map(|at| row[at]);
/// assert_eq!(value("dv_mps2"), Some(0.2));
/// assert_eq!(value("power_lag1_w"), Some(4.2));
/// ```
#[inline(always)]
pub fn features(
    v_mps: f32,
    omega_radps: f32,
    previous: Option<(f32, f32, f32)>,
    lag_w: &[f32; LAGS],
) -> Features {
    let (dv_mps2, domega_radps2) = match previous {
        None => (0.0, 0.0),
        Some((v_before_mps, omega_before_radps, dt_s)) if dt_s > 0.0 => {
            ((v_mps - v_before_mps) / dt_s, (omega_radps - omega_before_radps) / dt_s)
        }
        Some(_) => (f32::NAN, f32::NAN),
    };
    let [lag1, lag2, lag3, lag4, lag5] = *lag_w;
    [
        v_mps,
        omega_radps,
        dv_mps2,
        domega_radps2,
        v_mps.abs(),
        omega_radps.abs(),
        lag1,
        lag2,
        lag3,
        lag4,
        lag5,
        f32::NAN,
        f32::NAN,
    ]
}

/// The subset of features that a network reads.
///
/// ```
/// use joulebus_predictor::FeatureSet;
///
/// assert_eq!(FeatureSet::Full.inputs(), 11);
/// assert!(!FeatureSet::PowerOnly.needs_command());
/// assert_eq!(FeatureSet::from_name(FeatureSet::Freshness.name()), Some(FeatureSet::Freshness));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeatureSet {
    /// The paper's eleven.
    Full,
    /// The power readings alone: for robots whose velocities are not recorded.
    PowerOnly,
    /// The paper's eleven, and the age of the newest reading.
    Freshness,
    /// The power readings, and the age of the newest one.
    PowerFreshness,
}

impl FeatureSet {
    /// All sets.
    pub const ALL: [FeatureSet; 4] = [
        FeatureSet::Full,
        FeatureSet::PowerOnly,
        FeatureSet::Freshness,
        FeatureSet::PowerFreshness,
    ];

    /// The names in model files, for messages.
    pub(crate) const NAMES: &str = "full, power_only, freshness, power_freshness";

    /// Number of inputs of the network: 5 to 13.
    pub const fn inputs(self) -> usize {
        self.end() - self.first()
    }

    /// Index in [`Features`] of the first feature read. All those from there to
    /// [`FeatureSet::end`] are read.
    pub const fn first(self) -> usize {
        if self.needs_command() { 0 } else { FEATURES - LAGS }
    }

    /// Index in [`Features`] after the last feature read.
    pub const fn end(self) -> usize {
        if self.needs_freshness() { INPUTS } else { FEATURES }
    }

    /// Indices in [`Features`] of the features read.
    pub const fn range(self) -> Range<usize> {
        self.first()..self.end()
    }

    /// True if velocities are read.
    pub const fn needs_command(self) -> bool {
        matches!(self, FeatureSet::Full | FeatureSet::Freshness)
    }

    /// True if the age of the newest reading is read.
    pub const fn needs_freshness(self) -> bool {
        matches!(self, FeatureSet::Freshness | FeatureSet::PowerFreshness)
    }

    /// The name in model files.
    pub const fn name(self) -> &'static str {
        match self {
            FeatureSet::Full => "full",
            FeatureSet::PowerOnly => "power_only",
            FeatureSet::Freshness => "freshness",
            FeatureSet::PowerFreshness => "power_freshness",
        }
    }

    /// The set of this name, if there is one.
    pub fn from_name(name: &str) -> Option<FeatureSet> {
        FeatureSet::ALL.into_iter().find(|set| set.name() == name)
    }
}
