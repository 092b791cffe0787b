//! The thread that reads the fleet as a planner, and has each side tell what it knows.

use std::cell::RefCell;
use std::sync::Arc;

use joulebus_board::{Board, Reading};
use joulebus_bus::clock;
use joulebus_config::Config;

use crate::shared::Shared;

/// A side that tells: a broker's topics, or those of ROS 2.
pub(crate) trait Tell: Send {
    /// Tells what is due. Never waits; called after each frame, and every 100 ms without.
    fn tell(&mut self, board: &Board, times: Times);

    /// Counts what it could not tell until the end.
    fn finish(&mut self);
}

/// Reads and has everything told until the bridge stops. Tells `ready` when the fleet is joined.
///
/// # Errors
/// The fleet cannot be joined, or reading fails permanently.
pub(crate) fn run(
    config: &Config,
    name: &str,
    shared: &Arc<Shared>,
    sides: &mut [Box<dyn Tell>],
    ready: impl FnOnce(),
) -> anyhow::Result<()> {
    let mut reading = Reading::open(config, name, false)?;
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
