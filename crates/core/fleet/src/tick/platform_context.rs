//! Settings of one platform, prepared for the tick.

use joulebus_energy::{EnergyModel, Lasting, OutlookModel};
use joulebus_predictor::{FeatureSet, Features, INPUTS, Model};
use joulebus_settings::{AlarmSettings, FleetSettings, Platform};
use joulebus_wire::{OUTLOOK_HORIZONS, OUTLOOK_S};

use crate::alarms::level::LevelRules;
use crate::estimate::calibration::SharedErrors;
use crate::estimate::interval::QuantileStep;
use crate::estimate::online::Members;
use crate::estimate::window::RequiredInputs;

/// Settings of one platform, prepared for the tick.
#[derive(Debug)]
pub(crate) struct PlatformContext {
    pub platform: Platform,
    pub model: Model,
    /// When its residuals raise an alarm.
    pub alarms: AlarmSettings,
    /// Inputs that the model requires in addition to the lags.
    pub required: RequiredInputs,
    /// 1 over the residual standard deviation in training, at least the monitor's resolution, 1/W.
    pub per_sigma: f32,
    /// Maximum number of open-loop sample periods.
    pub longest_steps: u16,
    /// Silence after which the next sample is overdue, and maximum time between two consecutive
    /// samples without a gap, ns.
    pub overdue_after_ns: u64,
    /// Training range of the features, widened by the margin of the alarm.
    pub trained: Option<Trained>,
    /// Step of the intervals' adaptation.
    pub quantile_step: QuantileStep,
    /// The members of the robots' forecasts, if they learn online.
    pub members: Option<Members>,
    /// The energy of longer plans.
    pub energy: EnergyModel,
    /// By what levels are judged.
    pub levels: LevelRules,
    /// The power until a battery is empty. `None` if the model does not state it.
    pub lasting: Option<Lasting>,
    /// Errors of that energy, of all robots.
    pub errors: SharedErrors,
    /// The energy of robots that go on as they do.
    pub outlook: OutlookModel<OUTLOOK_HORIZONS>,
}

/// The allowed range of features.
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
        let members =
            (platform.online).then(|| Members::new(&model, sigma_w, platform.power_resolution_w));
        let alarms = settings.alarms.of(&platform);
        let energy = model.energy_or_untrained(platform.power_max_w);
        Self {
            levels: LevelRules::new(&energy, &alarms, &platform),
            alarms,
            errors: SharedErrors::new(&energy),
            lasting: energy.lasting(),
            outlook: energy.outlook(OUTLOOK_S),
            energy,
            members: members.flatten(),
            quantile_step: QuantileStep::new(&settings.interval),
            per_sigma: 1.0 / sigma_w,
            // `FleetSettings::check` limits the quotient to 1000.
            longest_steps: (platform.stale_after_ns / platform.period_ns) as u16,
            overdue_after_ns: platform.period_ns + platform.period_ns / 2,
            trained,
            required: RequiredInputs::new(model.feature_set()),
            platform,
            model,
        }
    }

    /// The errors to which the robots' shadow forecasts add. `None` if none are made.
    #[inline(always)]
    pub(crate) fn learned_errors(&self) -> Option<&SharedErrors> {
        self.platform.energy_online.then_some(&self.errors)
    }

    /// The range of power that a platform can draw, W.
    pub(crate) const fn possible(&self) -> PossiblePower {
        PossiblePower { min_w: self.platform.power_min_w, max_w: self.platform.power_max_w }
    }
}

/// The range of power that a platform can draw. Readings outside are refused, so a forecast outside
/// is farther from the next reading than the limit is. In open loop, where a network's error may
/// amplify, forecasts stay bounded.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PossiblePower {
    pub min_w: f32,
    pub max_w: f32,
}

impl PossiblePower {
    /// True if it can be a forecast at all: no further outside the limits than they are apart. NaN
    /// is not.
    #[inline(always)]
    pub(crate) fn is_near(self, forecast_w: f32) -> bool {
        let apart_w = self.max_w - self.min_w;
        (self.min_w - apart_w <= forecast_w) & (forecast_w <= self.max_w + apart_w)
    }

    /// The nearest possible forecast, W. NaN stays NaN, and −0 stays −0 on every CPU.
    #[inline(always)]
    pub(crate) fn nearest(self, forecast_w: f32) -> f32 {
        let below = if forecast_w < self.min_w { self.min_w } else { forecast_w };
        if below > self.max_w { self.max_w } else { below }
    }
}

#[cfg(test)]
#[test]
fn what_is_farther_outside_the_limits_than_they_are_apart_is_no_forecast() {
    let possible = PossiblePower { min_w: -1.0, max_w: 5.0 };
    for (forecast_w, is_near) in [
        (-1.0, true),
        (5.0, true),
        (-7.0, true),
        (11.0, true),
        (-7.01, false),
        (11.01, false),
        (1e38, false),
        (f32::INFINITY, false),
        (f32::NEG_INFINITY, false),
        (f32::NAN, false),
    ] {
        assert_eq!(possible.is_near(forecast_w), is_near, "{forecast_w} W");
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
