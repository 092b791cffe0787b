//! Load shedding: while ticks take longer than their period, diagnostics are left out. Forecasts
//! and budgets are needed by planners and the ledger's checkpoint. If the tick is still too slow,
//! whole ticks are skipped.

/// Consecutive ticks longer than a period before diagnostics are left out: a single one may have
/// waited for a processor, which shedding does not cure.
const LONG_TICKS: u32 = 3;
/// Consecutive ticks within half a period before diagnostics resume, so that they do not cause the
/// overload again at once.
const CALM_TICKS: u32 = 30;

/// Shedding of diagnostics, and the count of those left out.
#[derive(Debug, Clone, Default)]
pub(crate) struct Shedding {
    /// True if the next tick computes no diagnostics.
    pub(crate) sheds: bool,
    /// Ticks so far without diagnostics.
    pub(crate) ticks: u64,
    long_ticks: u32,
    calm_ticks: u32,
}

impl Shedding {
    /// Records that a tick took `took_ns` of its `period_ns`.
    pub(crate) fn ticked(&mut self, took_ns: u64, period_ns: u64) {
        self.ticks += u64::from(self.sheds);
        self.calm_ticks =
            if took_ns <= period_ns / 2 { self.calm_ticks.saturating_add(1) } else { 0 };
        self.long_ticks = if took_ns > period_ns { self.long_ticks.saturating_add(1) } else { 0 };
        self.sheds = self.long_ticks >= LONG_TICKS || self.sheds && self.calm_ticks < CALM_TICKS;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: u64 = 100;

    #[test]
    fn diagnostics_are_shed_while_ticks_are_too_long_and_resume() {
        let mut shedding = Shedding::default();
        for (took_ns, sheds) in [
            (PERIOD + 1, false),
            (PERIOD + 1, false),
            // A tick within its period resets the count.
            (PERIOD, false),
            (PERIOD + 1, false),
            (PERIOD + 1, false),
            (PERIOD + 1, true),
        ] {
            shedding.ticked(took_ns, PERIOD);
            assert_eq!(shedding.sheds, sheds);
        }
        for tick in 1..=CALM_TICKS {
            shedding.ticked(PERIOD / 2, PERIOD);
            assert_eq!(shedding.sheds, tick < CALM_TICKS, "calm tick {tick}");
        }
        assert_eq!(shedding.ticks, u64::from(CALM_TICKS));
    }

    #[test]
    fn diagnostics_do_not_resume_while_ticks_leave_no_time_for_them() {
        let mut shedding = Shedding::default();
        for _ in 0..LONG_TICKS {
            shedding.ticked(2 * PERIOD, PERIOD);
        }
        for _ in 0..100 {
            for _ in 1..CALM_TICKS {
                shedding.ticked(PERIOD / 2, PERIOD);
            }
            shedding.ticked(PERIOD / 2 + 1, PERIOD);
            assert!(shedding.sheds);
        }
    }
}
