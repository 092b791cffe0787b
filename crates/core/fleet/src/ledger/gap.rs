//! Power in time that no reading meters.

use crate::ledger::counting::Counting;

/// Periods up to which a gap is short: its power is that between the readings at its ends.
const SHORT_PERIODS: u64 = 5;

/// Power out of a robot's battery in a gap, W: the best estimate and its standard deviation.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GapPower {
    /// Negative if it charges.
    pub mean_w: f64,
    pub sd_w: f64,
    /// The greatest that it may have been: the lower bound falls by it.
    pub most_w: f64,
    /// True if the battery was charged throughout, by readings that meter the charge.
    pub charges: bool,
}

impl GapPower {
    /// Of a long gap: the mean power before it. The robot may have stood still or worked harder.
    /// Where that is unknown, half of the most.
    #[inline(always)]
    pub(crate) fn mean(counting: &Counting, before_w: f32) -> Self {
        let known_w = f64::from(before_w).max(0.0);
        let mean_w = if before_w.is_nan() { 0.5 * counting.most_w } else { known_w };
        let sd_w = 0.5 * mean_w.min((counting.most_w - mean_w).max(0.0));
        Self { mean_w, sd_w, most_w: counting.most_w.max(mean_w), charges: false }
    }

    /// Of a robot that has said that it is switched off: what it draws at rest, at most half more.
    /// Where that is unknown, as any other gap.
    #[inline(always)]
    pub(crate) fn off(counting: &Counting, idle_w: f32) -> Self {
        let unknown = Self::mean(counting, idle_w);
        let mean_w = unknown.mean_w.min(counting.most_w);
        let most_w = (1.5 * mean_w).min(counting.most_w);
        let known = Self { mean_w, sd_w: 0.25 * mean_w, most_w, charges: false };
        if idle_w.is_nan() { unknown } else { known }
    }

    /// Of a gap that has not ended: as a long one. While it may turn out to be short, the last reading
    /// if that is less, so that the energy left seldom has to rise when it ends. `charging`: the
    /// charge goes on as the last reading metered it.
    #[inline(always)]
    pub(crate) fn open(
        counting: &Counting,
        (last_w, before_w): (f32, f32),
        unmetered_ns: u64,
        charging: bool,
    ) -> Self {
        let may_be_short = unmetered_ns <= SHORT_PERIODS * counting.period_ns;
        let least_w = if may_be_short & (last_w < before_w) { last_w } else { before_w };
        let drawn = Self::mean(counting, least_w);
        let stored_w = counting.stored(last_w.into()).unwrap_or(f64::NAN);
        let charges = charging & may_be_short & !stored_w.is_nan();
        let mean_w = if charges { -stored_w } else { drawn.mean_w };
        let most_w = counting.most_w.max(mean_w);
        Self { mean_w, sd_w: if charges { 0.0 } else { drawn.sd_w }, most_w, charges }
    }

    /// Of a short gap between two readings: the trapezoid. At least what was shown as drawn while it
    /// lasted, so that the energy left does not rise. A charge without a reading at its end goes on
    /// as before. `None` if it is long, or a reading is unknown.
    pub(crate) fn between(
        counting: &Counting,
        (from_w, to_w): (f32, f32),
        before_w: f32,
        unmetered_ns: u64,
        charging: bool,
    ) -> Option<Self> {
        let is_short = (1..=SHORT_PERIODS * counting.period_ns).contains(&unmetered_ns);
        let goes_on = charging && to_w.is_nan();
        let to_w = if goes_on { from_w } else { to_w };
        let (from_w, to_w) = (f64::from(from_w), f64::from(to_w));
        if !(is_short && (from_w + to_w).is_finite()) {
            return None;
        }
        if charging {
            let mean_w = -counting.stored(0.5 * (from_w + to_w))?;
            let most_w = counting.most_w.max(mean_w);
            return Some(Self { mean_w, sd_w: 0.0, most_w, charges: true });
        }
        let shown = unmetered_ns.saturating_sub(counting.period_ns) as f64 / unmetered_ns as f64;
        let shown_w = shown * from_w.min(before_w.into()).max(0.0);
        let mean_w = (0.5 * (from_w + to_w)).max(shown_w);
        let apart_w = (from_w - to_w).abs() * std::f64::consts::FRAC_1_SQRT_2;
        let sd_w = apart_w.min(0.5 * (counting.most_w - mean_w).max(0.0));
        Some(Self { mean_w, sd_w, most_w: counting.most_w.max(mean_w), charges: false })
    }
}
