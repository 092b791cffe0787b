//! The energy of a plan with its interval.

use joulebus_energy::{CommandSum, Commands, EnergyForecast, EnergyModel, EnergyState};

use crate::answer::{Caveats, Range};
use crate::candidates::part;

/// A plan as far as it has been followed: its energy so far follows without reading its commands
/// again.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Progress {
    sum: CommandSum,
    /// Sum of its first steps, up to the longest horizon with known errors.
    covered: CommandSum,
    /// Steps up to that horizon.
    most_covered: usize,
}

impl Progress {
    /// The progress before the first command. Each command is in force for `period_s`.
    pub(crate) fn new(model: &EnergyModel, state: &EnergyState, period_s: f32) -> Self {
        let sum = CommandSum::new(state, period_s);
        Self { sum, covered: sum, most_covered: (model.longest_s() / period_s) as usize }
    }

    /// Time that each command is in force, s.
    pub(crate) const fn period_s(&self) -> f32 {
        self.sum.period_s()
    }

    /// Follows the next commands.
    pub(crate) fn add(&mut self, model: &EnergyModel, next: Commands<'_>) {
        let missing = self.most_covered.saturating_sub(self.sum.steps());
        if missing > 0 {
            self.sum.add(model, part(next, 0, missing));
            self.covered = self.sum;
        }
        self.sum.add(model, part(next, missing, next.steps()));
    }

    /// Follows a way that is known already but for its first command, which has been followed.
    pub(crate) fn join(&mut self, rest: &Rest) {
        if self.sum.steps() < self.most_covered {
            self.covered = self.sum;
            self.covered.join(&rest.covered);
        }
        self.sum.join(&rest.whole);
    }

    /// The energy so far. It is widened to the platform's minimum and maximum power (W) where the
    /// model's errors do not cover it.
    pub(crate) fn estimate(
        &self,
        model: &EnergyModel,
        state: &EnergyState,
        [power_min_w, power_max_w]: [f32; 2],
        coverage: f32,
    ) -> Estimate {
        let whole = model.forecast_of(state, &self.sum);
        let (steps, outside) = (self.sum.steps(), self.sum.steps_outside());
        let beyond = !model.covers(whole.duration_s);
        let covered = if beyond { self.covered } else { self.sum };
        let known = (covered.steps() > 0)
            .then(|| if beyond { model.forecast_of(state, &covered) } else { whole });
        let widened = (steps - covered.steps() + outside).min(steps);
        let widened_s = widened as f32 * self.sum.period_s();
        let mean_w = whole.energy_j / whole.duration_s;
        let tail = 0.5 * (1.0 - coverage);
        let offset_j = |p| {
            let edge_j = known.and_then(|known| Some(known.quantile_j(p)? - known.energy_j));
            edge_j.unwrap_or(0.0)
        };
        let down_w = (mean_w - power_min_w).max(0.0);
        let up_w = (power_max_w - mean_w).max(0.0);
        let lo_j = whole.energy_j + offset_j(tail) - widened_s * down_w;
        let least_j = (power_min_w * whole.duration_s).min(whole.energy_j);
        Estimate {
            distribution: known.filter(|_| widened == 0),
            mean_j: whole.energy_j,
            // Both widen it downwards, together beyond the possible. Not `max`, which would hide a
            // NaN.
            lo_j: if lo_j < least_j { least_j } else { lo_j },
            hi_j: whole.energy_j + offset_j(1.0 - tail) + widened_s * up_w,
            caveats: Caveats {
                steps_outside_training: outside,
                beyond_horizon: beyond,
                ..Caveats::default()
            },
        }
    }
}

/// Sums of the command model over the commands of a path after its first one. They are the same for
/// every robot of a platform.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rest {
    whole: CommandSum,
    /// Sum up to the longest horizon with known errors.
    covered: CommandSum,
}

impl Rest {
    /// Sums over a path that follows the first `begins` steps of a plan.
    pub(crate) fn new(model: &EnergyModel, way: Commands<'_>, begins: usize) -> Self {
        let first = (way.v_mps[0], way.omega_radps[0]);
        let mut sum = CommandSum::after(first, way.period_s);
        let most_covered = (model.longest_s() / way.period_s) as usize;
        let covered_to = most_covered.saturating_sub(begins).max(1);
        sum.add(model, part(way, 1, covered_to));
        let covered = sum;
        sum.add(model, part(way, covered_to, way.steps()));
        Self { whole: sum, covered }
    }
}

/// The energy of a plan.
pub(crate) struct Estimate {
    /// Forecast with its errors. `None` if any step was widened: the platform's limits of power
    /// bound the energy there, and say nothing about probabilities.
    distribution: Option<EnergyForecast>,
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
        self.distribution?.probability_below(usable_j, sd_j)
    }
}
