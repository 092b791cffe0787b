//! Tick schedule. Pure: the caller queries it, waits, and reports back.

use joulebus_settings::Policy;

/// Under `OnFrame` a tick with frames may come this part of a period before its place: frames that
/// arrive unevenly wait less.
const EARLY: u64 = 5;
/// Its place is a period after the place of the last one, less this part of it: a source whose clock
/// is slightly fast is followed instead of being delayed by up to a period.
const FASTER: u64 = 128;

/// The next action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Next {
    /// Tick. It was due at `due_ns`.
    Tick {
        /// When it was due, monotonic ns.
        due_ns: u64,
    },
    /// Wait for a frame, at most until `until_ns`.
    Wait {
        /// When to query again, monotonic ns.
        until_ns: u64,
    },
}

/// Decides when ticks are executed, and counts skipped ones.
///
/// At most one tick per period. A skipped one is counted and never made up for.
#[derive(Debug, Clone)]
pub struct Schedule {
    policy: Policy,
    period_ns: u64,
    /// Start of the last tick, or of the schedule.
    started_ns: u64,
    /// Place of the next tick with frames under `OnFrame`: ticks without frames do not delay frames.
    place_ns: u64,
    grid_ns: u64,
    /// Ticks skipped because the one before took too long.
    pub skipped: u64,
    /// Ticks that started more than a tenth of a period after they were due.
    pub late: u64,
}

impl Schedule {
    /// A schedule that begins at `now_ns`. `period_ns` > 0.
    pub fn new(policy: Policy, period_ns: u64, now_ns: u64) -> Self {
        let period_ns = period_ns.max(1);
        Self {
            policy,
            period_ns,
            started_ns: now_ns,
            place_ns: now_ns,
            grid_ns: now_ns + period_ns,
            skipped: 0,
            late: 0,
        }
    }

    /// The action at `now_ns`. `first_taken_ns`: when the first frame since the last tick was
    /// taken. `complete`: whether every robot whose sample is due has reported since then.
    pub fn next(&self, now_ns: u64, first_taken_ns: Option<u64>, complete: bool) -> Next {
        let due_ns = match (self.policy, first_taken_ns) {
            (Policy::Timer, _) => self.grid_ns,
            (Policy::OnFrame { deadline_ns }, Some(taken_ns)) => {
                let ready_ns = if complete { taken_ns } else { taken_ns + deadline_ns };
                ready_ns.max(self.place_ns.saturating_sub(self.period_ns / EARLY))
            }
            // Without samples the tick continues: planners must see robots become stale, and that
            // the worker is alive.
            (Policy::OnFrame { .. }, None) => self.started_ns + self.period_ns + self.period_ns / 2,
        };
        if now_ns >= due_ns { Next::Tick { due_ns } } else { Next::Wait { until_ns: due_ns } }
    }

    /// Records that a tick due at `due_ns` ran from `start_ns` to `end_ns`, with or without
    /// `frames`. Returns whether it missed its deadline: started late or took longer than a period.
    pub fn ticked(&mut self, due_ns: u64, start_ns: u64, end_ns: u64, frames: bool) -> bool {
        let late = start_ns.saturating_sub(due_ns) > self.period_ns / 10;
        let skipped = match self.policy {
            Policy::Timer => end_ns.saturating_sub(self.grid_ns) / self.period_ns,
            Policy::OnFrame { .. } => end_ns.saturating_sub(start_ns) / self.period_ns,
        };
        self.grid_ns += (1 + skipped) * self.period_ns;
        self.started_ns = start_ns;
        if frames {
            self.place_ns = self.place_ns.max(start_ns) + self.period_ns - self.period_ns / FASTER;
        }
        self.skipped += skipped;
        self.late += u64::from(late);
        late || skipped > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: u64 = 33;

    #[test]
    fn on_frame_ticks_when_complete_or_at_the_deadline() {
        let schedule = Schedule::new(Policy::OnFrame { deadline_ns: 5 }, PERIOD, 0);
        assert_eq!(schedule.next(30, Some(30), true), Next::Tick { due_ns: 30 });
        assert_eq!(schedule.next(30, Some(30), false), Next::Wait { until_ns: 35 });
        assert_eq!(schedule.next(36, Some(30), false), Next::Tick { due_ns: 35 });
    }

    #[test]
    fn ticks_with_frames_keep_their_distance_and_idle_ones_delay_nothing() {
        let mut schedule = Schedule::new(Policy::OnFrame { deadline_ns: 5 }, PERIOD, 0);
        schedule.ticked(0, 0, 1, true);
        assert_eq!(schedule.next(20, Some(20), true), Next::Wait { until_ns: 27 });
        assert_eq!(schedule.next(49, None, true), Next::Tick { due_ns: 49 });
        schedule.ticked(49, 49, 50, false);
        assert_eq!(schedule.next(51, Some(51), true), Next::Tick { due_ns: 51 });
    }

    /// Frames of sources that are out of phase: at all times there is one to tick for.
    #[test]
    fn on_frame_keeps_to_the_rate_over_time() {
        const PERIOD_NS: u64 = 33_333_333;
        let mut schedule = Schedule::new(Policy::OnFrame { deadline_ns: 5 }, PERIOD_NS, 0);
        let (mut now_ns, mut ticks, mut closest_ns) = (0, 0, u64::MAX);
        while now_ns < 100 * PERIOD_NS {
            match schedule.next(now_ns, Some(now_ns), true) {
                Next::Wait { until_ns } => {
                    closest_ns =
                        if ticks > 0 { closest_ns.min(until_ns - now_ns) } else { until_ns };
                    now_ns = until_ns;
                }
                Next::Tick { .. } => {
                    ticks += 1;
                    schedule.ticked(now_ns, now_ns, now_ns, true);
                }
            }
        }
        assert!((100..=101).contains(&ticks), "{ticks}");
        assert!(closest_ns >= PERIOD_NS * 4 / 5 - PERIOD_NS / FASTER - 2, "{closest_ns}");
    }

    #[test]
    fn on_frame_continues_ticking_without_frames() {
        let mut schedule = Schedule::new(Policy::OnFrame { deadline_ns: 5 }, PERIOD, 0);
        assert_eq!(schedule.next(0, None, true), Next::Wait { until_ns: 49 });
        assert_eq!(schedule.next(49, None, true), Next::Tick { due_ns: 49 });
        assert!(!schedule.ticked(49, 49, 50, false));
        assert_eq!(schedule.next(50, None, true), Next::Wait { until_ns: 98 });
    }

    #[test]
    fn the_timer_keeps_its_grid_and_counts_what_it_skips() {
        let mut schedule = Schedule::new(Policy::Timer, PERIOD, 0);
        assert_eq!(schedule.next(32, Some(1), true), Next::Wait { until_ns: 33 });
        assert_eq!(schedule.next(34, None, false), Next::Tick { due_ns: 33 });
        assert!(!schedule.ticked(33, 34, 40, true));
        assert_eq!(schedule.next(40, None, false), Next::Wait { until_ns: 66 });
        assert!(schedule.ticked(66, 70, 66 + 2 * PERIOD + 1, true));
        assert_eq!((schedule.skipped, schedule.late), (2, 1));
        assert_eq!(schedule.next(140, None, false), Next::Wait { until_ns: 66 + 3 * PERIOD });
    }

    #[test]
    fn skipped_ticks_are_counted_and_never_queued() {
        for policy in [Policy::Timer, Policy::OnFrame { deadline_ns: 5 }] {
            let mut schedule = Schedule::new(policy, PERIOD, 0);
            let mut now = 0;
            for _ in 0..100 {
                now = match schedule.next(now, Some(now), true) {
                    Next::Wait { until_ns } => until_ns,
                    Next::Tick { .. } => now,
                };
                let start = now;
                now += 3 * PERIOD;
                schedule.ticked(start, start, now, true);
            }
            assert!(schedule.skipped >= 199, "{policy:?}: {}", schedule.skipped);
        }
    }
}
