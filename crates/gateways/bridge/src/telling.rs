//! The thread that reads the fleet as a planner, and has each side tell what it knows.

use std::cell::RefCell;
use std::sync::Arc;
use std::time::Duration;

use joulebus_board::{Board, Reading};
use joulebus_bus::clock;
use joulebus_config::Config;
use joulebus_consumer::ConnectError;

use crate::shared::Shared;

/// A topic may be written this part of its interval late.
const LATE_PART: u32 = 10;
/// Longest time between two looks at the fleet.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// A side that tells: a broker's topics, or those of ROS 2.
pub(crate) trait Tell: Send {
    /// Tells what is due. Never waits; called at least every 100 ms.
    fn tell(&mut self, board: &Board, times: Times);

    /// Counts what it could not tell until the end.
    fn finish(&mut self);
}

/// When what was due at `due_ns` and is written every `every_ns` is due again: on a grid, so that what is late now does
/// not make the next ones late.
pub(crate) const fn next_due_ns(due_ns: u64, every_ns: u64, now_ns: u64) -> u64 {
    let next_ns = due_ns + every_ns;
    if next_ns <= now_ns {
        return now_ns + every_ns;
    }
    next_ns
}

/// Joins the fleet for topics of which the most frequent is written `every` so often. Where that is much rarer than
/// ticks, these do not wake the bridge: that would cost the worker time.
fn open(config: &Config, name: &str, every: Duration) -> Result<Reading, ConnectError> {
    let look_every = (every / LATE_PART).min(LOOK_EVERY);
    if look_every.as_nanos() < u128::from(config.tick_period_ns()) {
        return Reading::open(config, name, false);
    }
    Reading::polling(config, name, look_every)
}

/// Reads and has everything told until the bridge stops; the most frequent topic is due `every` so often. Tells `ready`
/// when the fleet is joined.
///
/// # Errors
/// The fleet cannot be joined, or reading fails permanently.
pub(crate) fn run(
    config: &Config,
    (name, every): (&str, Duration),
    shared: &Arc<Shared>,
    sides: &mut [Box<dyn Tell>],
    ready: impl FnOnce(),
) -> anyhow::Result<()> {
    let mut reading = open(config, name, every)?;
    ready();
    let board = RefCell::new(Board::new(clock::monotonic_ns()));
    while !shared.is_stopped() {
        reading.turn(|| board.borrow_mut())?;
        let (board, times) = (board.borrow(), Times::now());
        for side in &mut *sides {
            side.tell(&board, times);
        }
    }
    for side in sides {
        side.finish();
    }
    Ok(())
}

/// This moment on both clocks.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Times {
    pub(crate) now_ns: u64,
    pub(crate) now_unix_ns: u64,
}

impl Times {
    fn now() -> Self {
        Self {
            now_ns: clock::monotonic_ns(),
            now_unix_ns: clock::unix_ns(),
        }
    }

    /// Unix time of a monotonic one, which may lie ahead.
    pub(crate) const fn unix_ns(self, at_ns: u64) -> u64 {
        let ago_ns = self.now_ns as i128 - at_ns as i128;
        (self.now_unix_ns as i128 - ago_ns) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_looked_for_now_and_then_is_written_as_often_as_configured() {
        for (every_ns, look_every_ns) in [(100, 10), (100, 7), (10, 33), (33, 10)] {
            let (mut due_ns, mut written) = (0, 0);
            let looks = 100_000;
            for look in 0..looks {
                let now_ns = look * look_every_ns;
                if now_ns >= due_ns {
                    written += 1;
                    due_ns = next_due_ns(due_ns, every_ns, now_ns);
                }
            }
            let expected = (looks * look_every_ns / every_ns).min(looks);
            assert!(
                u64::abs_diff(written, expected) <= 1,
                "{every_ns} {look_every_ns}: {written}"
            );
        }
    }
}
