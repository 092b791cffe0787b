//! What belongs to one platform, made ready for the tick.

use joulebus_predictor::{FeatureSet, Features, INPUTS, Model};
use joulebus_settings::{FleetSettings, Platform};

use crate::estimate::interval::QuantileStep;
use crate::estimate::mixture::Blending;
use crate::estimate::window::RequiredInputs;

/// What belongs to one platform.
#[derive(Debug)]
pub(crate) struct PlatformContext {
    pub platform: Platform,
    pub model: Model,
    /// What the model requires beside the lags.
    pub required: RequiredInputs,
    /// Standard deviation of the residuals in training, not below the monitor's resolution, W.
    pub sigma_w: f32,
    /// Sample periods that the model may run open loop.
    pub longest_steps: u16,
    /// Silence after which the next sample is overdue, and longest time between two samples with
    /// nothing missing, ns.
    pub overdue_after_ns: u64,
    /// Range of the features in training, widened by the margin of the alarm.
    pub trained: Option<Trained>,
    /// How intervals follow.
    pub quantile_step: QuantileStep,
    /// What the robots learn from their own readings, if anything.
    pub blending: Option<Blending>,
}

/// The range that features may lie in.
#[derive(Debug)]
pub(crate) struct Trained {
    feature_set: FeatureSet,
    lo: Features,
    hi: Features,
}

impl PlatformContext {
    pub(crate) fn new(platform: Platform, model: Model, settings: &FleetSettings) -> Self {
        let margin = settings.alarms.training_margin;
        let trained = model.training_range().map(|range| {
            let slack: Features =
                std::array::from_fn(|index| margin * (range.max[index] - range.min[index]));
            Trained {
                feature_set: range.feature_set,
                lo: std::array::from_fn(|index| range.min[index] - slack[index]),
                hi: std::array::from_fn(|index| range.max[index] + slack[index]),
            }
        });
        let sigma_w = model.residual().std_w.max(platform.power_resolution_w);
        Self {
            blending: Blending::new(platform.online, &model, sigma_w),
            quantile_step: QuantileStep::new(&settings.interval),
            sigma_w,
            // `FleetSettings::check` has bounded the quotient by 1000.
            longest_steps: (platform.stale_after_ns / platform.period_ns) as u16,
            overdue_after_ns: platform.period_ns + platform.period_ns / 2,
            trained,
            required: RequiredInputs::of(model.feature_set()),
            platform,
            model,
        }
    }
}

impl Trained {
    /// Marks the rows, given as columns, that have a feature outside the range, or NaN.
    pub(crate) fn mark_outside(&self, columns: &[Vec<f32>; INPUTS], outside: &mut [bool]) {
        outside.fill(false);
        for feature in self.feature_set.range() {
            let (column, lo, hi) = (&columns[feature], &self.lo[feature], &self.hi[feature]);
            for (outside, value) in outside.iter_mut().zip(column) {
                *outside |= !((*lo <= *value) & (*value <= *hi));
            }
        }
    }
}
