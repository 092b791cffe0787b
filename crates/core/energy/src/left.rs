//! Energy left in a battery.

/// Energy left in a battery at a time, past or to come, in J or as a share of the capacity.
///
/// Budgets, alarms and verdicts are computed from it, so the error of a power monitor counts the
/// same before and after the energy is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EnergyLeft {
    /// Best estimate.
    pub left: f64,
    /// Standard deviation of the errors that stay as they are, whatever is drawn.
    pub own_sd: f64,
    /// Change of `left` if the monitor's relative error grows by its standard deviation. That error
    /// keeps its sign, so this is linear in what was drawn.
    pub monitor: f64,
    /// The truth is within `below` and `above` of the estimate, except for these two errors.
    pub below: f64,
    /// See `below`.
    pub above: f64,
    /// Standard deviation of the truth within this range, where nothing says in which part it lies:
    /// after a charge that was not metered.
    pub range_sd: f64,
}

impl EnergyLeft {
    /// Distance of the bounds from the estimate in standard deviations: 95 % of a normal
    /// distribution.
    pub const SIGMAS: f64 = 2.0;

    /// Energy left of which a standard deviation is all that is known. Up to `most` of it is the
    /// monitor's, whose error has the sign of the errors to come: that of counting what is missing
    /// from a full battery.
    #[must_use]
    pub fn stated(left: f64, sd: f64, most: f64) -> Self {
        let by_monitor = sd.min(most.max(0.0));
        let own_sd = (sd * sd - by_monitor * by_monitor).max(0.0).sqrt();
        Self { left, own_sd, monitor: -by_monitor, below: 0.0, above: 0.0, range_sd: 0.0 }
    }

    /// The same after an amount is drawn, as counted by a monitor whose relative error has this
    /// standard deviation. A negative amount is regenerated.
    #[inline(always)]
    #[must_use]
    pub const fn after_drawing(self, amount: f64, counting_sd: f64) -> Self {
        Self { left: self.left - amount, monitor: self.monitor - counting_sd * amount, ..self }
    }

    /// The bounds' distance by the error of counting an amount that is yet to be drawn, as a bound
    /// falls by it at most beside the amount.
    #[inline(always)]
    #[must_use]
    pub fn counting_error(amount: f64, counting_sd: f64) -> f64 {
        Self::SIGMAS * counting_sd * amount.abs()
    }

    /// Standard deviation of `left`, by which probabilities are computed.
    #[inline(always)]
    #[must_use]
    pub fn whole_sd(&self) -> f64 {
        (self.own_sd * self.own_sd + self.monitor * self.monitor + self.range_sd * self.range_sd)
            .sqrt()
    }

    /// Standard deviation of the errors beside the range.
    #[inline(always)]
    #[must_use]
    pub fn sd(&self) -> f64 {
        (self.own_sd * self.own_sd + self.monitor * self.monitor).sqrt()
    }

    /// Lower bound, below 0 if the battery may be empty before.
    #[inline(always)]
    #[must_use]
    pub fn lo(&self) -> f64 {
        self.left - self.below - Self::SIGMAS * self.sd()
    }

    /// Upper bound, possibly above the capacity.
    #[inline(always)]
    #[must_use]
    pub fn hi(&self) -> f64 {
        self.left + self.above + Self::SIGMAS * self.sd()
    }

    /// The same with an independent error of this standard deviation more. The range of gaps
    /// contains that error, so the bounds stay where they are, unless the range is narrower.
    #[inline(always)]
    #[must_use]
    pub fn with_error_within_range(self, sd: f64) -> Self {
        let own_sd = (self.own_sd * self.own_sd + sd * sd).sqrt();
        let wider = Self { own_sd, ..self };
        let grown = Self::SIGMAS * (wider.sd() - self.sd());
        Self { below: (self.below - grown).max(0.0), above: (self.above - grown).max(0.0), ..wider }
    }

    /// Factors of the bounds of an amount that is yet to be drawn: the monitor counts that with the
    /// error that it has.
    #[inline(always)]
    #[must_use]
    pub fn counting_factors(counting_sd: f64) -> [f64; 2] {
        let error = Self::SIGMAS * counting_sd;
        [1.0 / (1.0 + error), 1.0 / (1.0 - error).max(f64::MIN_POSITIVE)]
    }
}
