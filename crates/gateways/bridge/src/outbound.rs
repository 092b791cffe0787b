//! The thread that reads the fleet as a planner, and publishes it to all sinks.

use std::cell::RefCell;
use std::time::Duration;

use joulebus_board::{Board, Reading};
use joulebus_bus::{Background, Rounds, clock, yield_to_the_worker};
use joulebus_config::Config;
use joulebus_consumer::ConnectError;

use crate::shared::NICE;

/// A topic may be written late by this part of its interval.
const LATE_PART: u32 = 10;
/// Maximum interval between two readings of the fleet.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// A destination of the fleet's values: the topics of a broker, or those of ROS 2.
pub(crate) trait Sink: Send {
    /// Publishes whatever is due, without blocking. It is called at least every 100 ms.
    fn publish(&mut self, board: &Board, times: Times);

    /// Counts what could not be published by the end.
    fn finish(&mut self);
}

/// The next due time after `due_ns` for an interval of `every_ns`. It stays on a grid, so that a
/// late message does not delay the later ones.
pub(crate) const fn next_due_ns(due_ns: u64, every_ns: u64, now_ns: u64) -> u64 {
    let next_ns = due_ns + every_ns;
    if next_ns <= now_ns {
        return now_ns + every_ns;
    }
    next_ns
}

/// Joins the fleet to write the most frequent topic every `every`. If that is much rarer than
/// ticks, ticks do not wake the bridge, because a wake-up costs the worker time.
fn open(config: &Config, name: &str, every: Duration) -> Result<Reading, ConnectError> {
    let look_every = (every / LATE_PART).min(POLL_INTERVAL);
    if look_every.as_nanos() < u128::from(config.tick_period_ns()) {
        return Reading::open(config, name, false);
    }
    Reading::polling(config, name, look_every)
}

/// State of the thread.
struct Outbound {
    reading: Reading,
    board: RefCell<Board>,
    sides: Vec<Box<dyn Sink>>,
}

/// Starts the thread that reads the fleet and publishes it to all `sides`, which has joined the
/// fleet then. The most frequent topic is due every `every`. `outlooks`: whether these are among
/// the values.
///
/// # Errors
/// The fleet cannot be joined. Later: reading fails permanently.
pub(crate) fn start(
    config: &Config,
    name: &str,
    (every, outlooks): (Duration, bool),
    sides: Vec<Box<dyn Sink>>,
) -> anyhow::Result<Background<anyhow::Result<()>>> {
    let (config, name) = (config.clone(), name.to_owned());
    let open = move || {
        yield_to_the_worker(NICE);
        let mut reading = open(&config, &name, every)?;
        reading.want_outlooks(outlooks)?;
        let board = RefCell::new(Board::new(clock::monotonic_ns()));
        Ok((Outbound { reading, board, sides }, ()))
    };
    Ok(Background::repeat("joulebus-output", open)?.0)
}

impl Rounds<(), anyhow::Error> for Outbound {
    fn round(&mut self) -> anyhow::Result<Duration> {
        let Self { reading, board, sides } = self;
        reading.poll(|| board.borrow_mut())?;
        let (board, times) = (board.borrow(), Times::now());
        for side in sides {
            side.publish(&board, times);
        }
        Ok(Duration::ZERO)
    }

    fn finish(mut self) -> anyhow::Result<()> {
        self.sides.iter_mut().for_each(|side| side.finish());
        Ok(())
    }
}

/// The present on both clocks.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Times {
    pub(crate) now_ns: u64,
    pub(crate) now_unix_ns: u64,
}

impl Times {
    fn now() -> Self {
        Self { now_ns: clock::monotonic_ns(), now_unix_ns: clock::unix_ns() }
    }

    /// Converts a monotonic time, which may lie ahead, to Unix time.
    pub(crate) fn unix_ns(self, at_ns: u64) -> u64 {
        let ago_ns = self.now_ns as i128 - at_ns as i128;
        (self.now_unix_ns as i128 - ago_ns).max(0) as u64
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
            assert!(u64::abs_diff(written, expected) <= 1, "{every_ns} {look_every_ns}: {written}");
        }
    }
}
