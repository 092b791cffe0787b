//! What the network is shown.

/// Number of power readings in the lag window.
pub const LAGS: usize = 5;

/// Number of features of one row.
pub const FEATURES: usize = 11;

/// One row of raw features in SI units, in the order of [`FEATURE_NAMES`].
pub type Features = [f32; FEATURES];

/// Name of each feature with its unit; the power readings come newest first.
pub const FEATURE_NAMES: [&str; FEATURES] = [
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
];

/// Builds the row for the forecast of the next reading.
///
/// `v_mps` and `omega_radps` are the command in force, `previous` is the command before it with
/// the true time between the two in seconds, `lag_w` the last readings in watt, newest first.
/// Without a previous command both derivatives are 0. A time step that is not positive makes both
/// derivatives NaN, so that the forecast is visibly invalid instead of plausible and wrong.
pub fn features(
    v_mps: f32,
    omega_radps: f32,
    previous: Option<(f32, f32, f32)>,
    lag_w: &[f32; LAGS],
) -> Features {
    let (dv_mps2, domega_radps2) = match previous {
        None => (0.0, 0.0),
        Some((v_before_mps, omega_before_radps, dt_s)) if dt_s > 0.0 => (
            (v_mps - v_before_mps) / dt_s,
            (omega_radps - omega_before_radps) / dt_s,
        ),
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
    ]
}

/// Which of the features a network reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeatureSet {
    /// All eleven.
    Full,
    /// The power readings alone: for robots whose velocities nobody knows.
    PowerOnly,
}

impl FeatureSet {
    /// Number of inputs of the network: 11 or 5.
    pub const fn inputs(self) -> usize {
        match self {
            FeatureSet::Full => FEATURES,
            FeatureSet::PowerOnly => LAGS,
        }
    }

    /// Position in [`Features`] of the first feature that is read; all that follow are read too.
    pub const fn first(self) -> usize {
        FEATURES - self.inputs()
    }

    /// The name used in model files.
    pub const fn name(self) -> &'static str {
        match self {
            FeatureSet::Full => "full",
            FeatureSet::PowerOnly => "power_only",
        }
    }

    /// The set with this name, if there is one.
    pub fn from_name(name: &str) -> Option<FeatureSet> {
        [FeatureSet::Full, FeatureSet::PowerOnly]
            .into_iter()
            .find(|set| set.name() == name)
    }
}
