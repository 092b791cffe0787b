//! This host's realtime clock, for hosts whose realtime clocks an operator keeps together.

use std::sync::atomic::{AtomicBool, Ordering};

use joulebus_bus::clock;

use crate::protocol::wall::{Reading, RealtimeClock, Wall};

/// Interval between queries of the kernel.
const POLL_INTERVAL_NS: u64 = 100_000_000;
/// Maximum error, as the kernel states it, of a clock that counts as synchronised. linuxptp states
/// 0 every second, and the kernel adds 500 µs a second.
const MAX_ERROR_NS: u64 = 1_000_000;

/// The realtime clock, as one stream reads it.
#[derive(Debug)]
pub(crate) struct WallClock {
    /// Upper bound of the difference between the clocks of two hosts. Without it realtime clocks
    /// are not used.
    within_ns: Option<u64>,
    wall: Wall,
    look_ns: u64,
    is_synchronised: bool,
}

/// True once the reason for not using the clock was logged. All streams have the same reason.
static IS_LOGGED: AtomicBool = AtomicBool::new(false);

impl WallClock {
    pub(crate) fn new(within_ns: Option<u64>) -> Self {
        Self { within_ns, wall: Wall::default(), look_ns: 0, is_synchronised: false }
    }

    /// Reads the clock. `None` if it is not used.
    pub(crate) fn read(&mut self) -> Option<RealtimeClock> {
        let within_ns = self.within_ns?;
        let now_ns = clock::monotonic_ns();
        if now_ns >= self.look_ns {
            self.look_ns = now_ns + POLL_INTERVAL_NS;
            self.query(within_ns);
        }
        let reading = Reading {
            now_ns,
            between_ns: clock::realtime_minus_monotonic_ns()?,
            is_synchronised: self.is_synchronised,
        };
        let realtime_ns = self.wall.note(reading)?;
        Some(RealtimeClock { realtime_ns, within_ns })
    }

    fn query(&mut self, within_ns: u64) {
        let most_ns = within_ns.max(MAX_ERROR_NS);
        let found = clock::synchronisation();
        let is_kept = |state: &clock::Synchronisation| {
            state.is_synchronised && state.most_error_ns <= most_ns
        };
        self.is_synchronised = found.as_ref().is_ok_and(is_kept);
        if self.is_synchronised || IS_LOGGED.swap(true, Ordering::Relaxed) {
            return;
        }
        let why = match found {
            Err(error) => format!("the kernel does not report its state: {error}"),
            Ok(state) if state.is_synchronised => format!(
                "its error may be {} µs, allowed are {}",
                state.most_error_ns / 1_000,
                most_ns / 1_000
            ),
            Ok(_) => "nothing keeps it".to_owned(),
        };
        tracing::warn!(
            "the realtime clock of this host does not count ({why}): round trips alone compare clocks"
        );
    }
}
