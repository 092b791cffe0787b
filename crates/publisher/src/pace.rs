//! Publishing on a fixed time grid.

use std::time::Duration;

use joulebus_bus::clock;

/// A time on the grid.
///
/// [`Grid`] has an example without a clock, [`Pace`] one with the monotonic clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct Slot {
    /// Intended send time, monotonic ns: on the grid, however late it is now.
    pub intended_ns: u64,
    /// Grid times skipped between this one and now because the source stalled. They are not caught
    /// up.
    pub skipped: u64,
}

/// A fixed time grid, without a clock. It never drifts: a delay does not shift later times.
///
/// ```
/// use joulebus_publisher::Grid;
///
/// let mut grid = Grid::new(1_000, 100);
/// assert_eq!(grid.take(999), None);
/// let slot = grid.take(1_350).ok_or("it is due")?;
/// assert_eq!((slot.intended_ns, slot.skipped), (1_000, 3));
/// assert_eq!(grid.due_ns(), 1_400);
/// # Ok::<(), &str>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grid {
    due_ns: u64,
    period_ns: u64,
    skipped: u64,
}

impl Grid {
    /// A grid that begins at `first_ns` (monotonic), with a period of `period_ns`, at least 1.
    #[must_use]
    pub const fn new(first_ns: u64, period_ns: u64) -> Self {
        Self { due_ns: first_ns, period_ns: if period_ns == 0 { 1 } else { period_ns }, skipped: 0 }
    }

    /// The next grid time, monotonic ns.
    pub const fn due_ns(&self) -> u64 {
        self.due_ns
    }

    /// Grid times skipped so far.
    pub const fn skipped(&self) -> u64 {
        self.skipped
    }

    /// Takes the next grid time if it is due at `now_ns` (monotonic). After a stall it is the
    /// oldest missed one, and the grid continues with the first time after `now_ns`.
    pub const fn take(&mut self, now_ns: u64) -> Option<Slot> {
        let Some(late_ns) = now_ns.checked_sub(self.due_ns) else {
            return None;
        };
        let skipped = late_ns / self.period_ns;
        let slot = Slot { intended_ns: self.due_ns, skipped };
        self.skipped = self.skipped.saturating_add(skipped);
        self.due_ns =
            self.due_ns.saturating_add(skipped.saturating_add(1).saturating_mul(self.period_ns));
        Some(slot)
    }
}

/// A [`Grid`] on the monotonic clock.
///
/// ```no_run
/// # use joulebus_publisher::{Pace, Publisher, RobotState};
/// # fn example(publisher: &mut Publisher, fleet: &[RobotState]) {
/// let mut pace = Pace::every(std::time::Duration::from_nanos(33_333_333));
/// loop {
///     let slot = pace.wait();
///     if let Err(error) = publisher.publish_intended(slot.intended_ns, fleet.iter().copied()) {
///         eprintln!("{error}");
///     }
/// }
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Pace {
    grid: Grid,
}

impl Pace {
    /// A grid that begins now.
    #[must_use]
    pub fn every(period: Duration) -> Self {
        let period_ns = u64::try_from(period.as_nanos()).unwrap_or(u64::MAX);
        Self { grid: Grid::new(clock::monotonic_ns(), period_ns) }
    }

    /// Sleeps until the next grid time, and takes it. Returns at once when it is past. Signals do
    /// not end the sleep.
    pub fn wait(&mut self) -> Slot {
        loop {
            let now_ns = clock::monotonic_ns();
            if let Some(slot) = self.grid.take(now_ns) {
                return slot;
            }
            std::thread::sleep(Duration::from_nanos(self.grid.due_ns() - now_ns));
        }
    }

    /// The grid.
    pub const fn grid(&self) -> &Grid {
        &self.grid
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_stall_is_counted_and_not_hidden() {
        let mut grid = Grid::new(1_000, 100);
        for (now_ns, intended_ns, skipped, due_ns) in [
            (999, None, 0, 1_000),
            (1_000, Some(1_000), 0, 1_100),
            (1_099, None, 0, 1_100),
            (1_199, Some(1_100), 0, 1_200),
            // Four periods without a call: 1,300 to 1,500 are skipped.
            (1_550, Some(1_200), 3, 1_600),
            (1_600, Some(1_600), 0, 1_700),
            (1_800, Some(1_700), 1, 1_900),
        ] {
            let slot = grid.take(now_ns);
            assert_eq!(slot.map(|slot| slot.intended_ns), intended_ns, "{now_ns}");
            assert_eq!(slot.map_or(0, |slot| slot.skipped), skipped, "{now_ns}");
            assert_eq!(grid.due_ns(), due_ns, "{now_ns}");
        }
        assert_eq!(grid.skipped(), 4);
    }

    #[test]
    fn extreme_times_do_not_panic() {
        assert_eq!(Grid::new(0, 0).take(5).unwrap().skipped, 5);
        let mut grid = Grid::new(u64::MAX, u64::MAX);
        assert!(grid.take(u64::MAX).is_some());
        assert!(Grid::new(0, 1).take(u64::MAX).is_some());
    }

    proptest! {
        #[test]
        fn every_grid_time_is_taken_or_counted(
            first_ns in 0..1_000u64,
            period_ns in 1..50u64,
            steps in prop::collection::vec(0..200u64, 1..60),
        ) {
            let mut grid = Grid::new(first_ns, period_ns);
            let (mut now_ns, mut taken, mut skipped) = (0, 0, 0);
            for step in steps {
                now_ns += step;
                // Walks the grid step by step, instead of dividing.
                let mut past: Vec<u64> = Vec::new();
                let mut place_ns = grid.due_ns();
                while place_ns <= now_ns {
                    past.push(place_ns);
                    place_ns += period_ns;
                }
                let expected = past.first().map(|intended_ns| Slot {
                    intended_ns: *intended_ns,
                    skipped: past.len() as u64 - 1,
                });
                let slot = grid.take(now_ns);
                prop_assert_eq!(slot, expected);
                if let Some(slot) = slot {
                    taken += 1;
                    skipped += slot.skipped;
                }
                prop_assert_eq!(grid.skipped(), skipped);
                prop_assert_eq!(grid.due_ns(), first_ns + (taken + skipped) * period_ns);
            }
        }
    }
}
