//! What a tick leaves out while it takes longer than its period: the diagnostics. Forecasts and
//! budgets are what planners act on, and the ledger's checkpoint is made of budgets; a tick that
//! cannot be done in time even so is skipped whole.

/// Ticks in a row that take longer than a period before anything is left out: one alone may have
/// waited for a processor, and leaving work out does not help against that.
const LONG_TICKS: u32 = 3;
/// Ticks in a row within half a period before diagnostics are made again: they must not bring the
/// overload back at once.
const CALM_TICKS: u32 = 30;

/// Whether diagnostics are left out, and how often they were.
#[derive(Debug, Clone, Default)]
pub(crate) struct Shedding {
    /// Whether the next tick leaves the diagnostics out.
    pub(crate) sheds: bool,
    /// Ticks so far without diagnostics.
    pub(crate) ticks: u64,
    long_ticks: u32,
    calm_ticks: u32,
}

impl Shedding {
    /// A tick has taken `took_ns` of its `period_ns`.
    pub(crate) fn ticked(&mut self, took_ns: u64, period_ns: u64) {
        self.ticks += u64::from(self.sheds);
        self.calm_ticks = if took_ns <= period_ns / 2 {
            self.calm_ticks.saturating_add(1)
        } else {
            0
        };
        self.long_ticks = if took_ns > period_ns {
            self.long_ticks.saturating_add(1)
        } else {
            0
        };
        self.sheds = self.long_ticks >= LONG_TICKS || self.sheds && self.calm_ticks < CALM_TICKS;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: u64 = 100;

    #[test]
    fn diagnostics_go_when_ticks_stay_too_long_and_come_back_by_themselves() {
        let mut shedding = Shedding::default();
        for (took_ns, sheds) in [
            (PERIOD + 1, false),
            (PERIOD + 1, false),
            // Just in time: what was before does not count.
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
    fn ticks_that_leave_no_room_for_diagnostics_do_not_bring_them_back() {
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
