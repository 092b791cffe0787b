//! The energy of a plan with its interval.

use joulebus_energy::{CommandSum, Commands, EnergyForecast, EnergyModel, EnergyState};

use crate::answer::{Caveats, Limits, Range};

/// A plan as far as it has been followed, or a part of one: its energy follows without reading its
/// commands again.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Progress {
    pub(crate) sum: CommandSum,
    /// Energy that loads and docking add, J.
    pub(crate) added_j: f64,
}

impl Progress {
    pub(crate) const fn new(sum: CommandSum) -> Self {
        Self { sum, added_j: 0.0 }
    }

    /// Follows the next commands, with a load, W.
    pub(crate) fn add(&mut self, model: &EnergyModel, next: Commands<'_>, load_w: f32) {
        self.sum.add(model, next);
        self.added_j += f64::from(load_w) * f64::from(next.duration_s());
    }

    /// Follows a part that is summed already.
    pub(crate) fn join(&mut self, part: &Self) {
        self.sum.join(&part.sum);
        self.added_j += part.added_j;
    }

    /// The energy so far. Steps outside the training data widen it to what such steps may draw. All of
    /// a model without known errors widen it to the platform's minimum and maximum power (W).
    pub(crate) fn estimate(
        &self,
        model: &EnergyModel,
        state: &EnergyState,
        [power_min_w, power_max_w]: [f32; 2],
        coverage: f32,
    ) -> Estimate {
        let whole = model.forecast_of(state, &self.sum);
        // A model without errors knows nothing about any step.
        let is_known = model.longest_s() > 0.0;
        let widened = if is_known { self.sum.steps_outside() } else { self.sum.steps() };
        let widened_s = widened as f32 * self.sum.period_s();
        let mean_w = whole.energy_j / whole.duration_s;
        let [lowest_w, expected_w, highest_w] = match whole.outside_w.filter(|_| is_known) {
            Some([lowest, expected, highest]) => {
                [lowest.max(power_min_w), expected, highest.min(power_max_w)]
            }
            None => [power_min_w, mean_w, power_max_w],
        };
        let tail = 0.5 * (1.0 - coverage);
        let offset_j = |p| whole.quantile_j(p).map_or(0.0, |edge_j| edge_j - whole.energy_j);
        let down_w = (expected_w - lowest_w).max(0.0);
        let up_w = (highest_w - expected_w).max(0.0);
        let lo_j = whole.energy_j + offset_j(tail) - widened_s * down_w;
        let least_j = (power_min_w * whole.duration_s).min(whole.energy_j);
        let hi_j = whole.energy_j + offset_j(1.0 - tail) + widened_s * up_w;
        let added_j = self.added_j as f32;
        Estimate {
            distribution: (widened == 0).then_some(whole),
            added_j,
            mean_j: whole.energy_j + added_j,
            // Both widen it downwards, together beyond the possible. Not `max`, which would hide a
            // NaN.
            lo_j: if lo_j < least_j { least_j } else { lo_j } + added_j,
            hi_j: hi_j + added_j,
            caveats: Caveats {
                steps_outside_training: widened,
                outside: whole.outside.filter(|_| is_known),
                limits: Limits::met(&model.limits, self.sum.moves(), model.hotel_w.is_some()),
                beyond_horizon: is_known && !model.covers(whole.duration_s),
                ..Caveats::default()
            },
        }
    }
}

/// Energy of commands, and what weakens it, of a robot of which nothing has been read: its first
/// drive as `joulebus eval --trips` asks about it. `None` if commands or coverage are not sound. The
/// power is bounded by what the model's recordings have.
#[must_use]
pub fn first_energy(
    model: &EnergyModel,
    commands: Commands<'_>,
    coverage: f32,
) -> Option<(Range, Caveats)> {
    let state = EnergyState::new(0);
    let mut progress = Progress::new(CommandSum::new(&state, commands.period_s));
    progress.add(model, commands, 0.0);
    let estimate = progress.estimate(model, &state, [f32::MIN, f32::MAX], coverage);
    Some((estimate.energy()?, estimate.caveats))
}

/// The energy of a plan.
pub(crate) struct Estimate {
    /// Forecast with its errors. `None` if any step was widened: the platform's limits of power
    /// bound the energy there, and say nothing about probabilities.
    distribution: Option<EnergyForecast>,
    /// Known energy beside the forecast, J.
    added_j: f32,
    mean_j: f32,
    lo_j: f32,
    hi_j: f32,
    pub(crate) caveats: Caveats,
}

impl Estimate {
    /// `None` if a value is not finite, or they contradict each other.
    pub(crate) fn energy(&self) -> Option<Range> {
        let Self { mean_j, lo_j, hi_j, .. } = *self;
        // Quantiles of a skewed error may both lie on one side of the mean.
        let (lo_j, hi_j) = (lo_j.min(mean_j), hi_j.max(mean_j));
        let finite = lo_j.is_finite() && mean_j.is_finite() && hi_j.is_finite();
        finite.then_some(Range { mean_j, lo_j, hi_j })
    }

    /// The probability that the plan draws less than an amount with a standard deviation, J.
    /// `None` where it is not known.
    pub(crate) fn probability_below(&self, usable_j: f32, sd_j: f32) -> Option<f32> {
        self.distribution?.probability_below(usable_j - self.added_j, sd_j)
    }
}
