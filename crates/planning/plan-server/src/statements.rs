//! What persons state of robots, on its way to the worker of this process.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};

use joulebus_wire::Statement;

/// Statements that wait for the worker's next tick, at most.
const MAX_STATEMENTS: usize = 64;

/// Leads statements to the worker, and shows which of them it has taken.
#[derive(Debug, Clone)]
pub struct Statements {
    to: SyncSender<(u32, Statement)>,
    sent: Arc<AtomicU64>,
    taken: Arc<AtomicU64>,
}

impl Statements {
    /// The two ends for the worker: the statements, and where it counts those that a tick has taken
    /// whose budgets and journal are sent. They are taken in the order of sending.
    #[must_use]
    pub fn channel() -> (Self, Receiver<(u32, Statement)>, Arc<AtomicU64>) {
        let (to, from) = sync_channel(MAX_STATEMENTS);
        let taken = Arc::<AtomicU64>::default();
        (Self { to, sent: Arc::default(), taken: Arc::clone(&taken) }, from, taken)
    }

    /// Sends one, and returns its number.
    pub(crate) fn send(
        &self,
        stated: (u32, Statement),
    ) -> Result<u64, TrySendError<(u32, Statement)>> {
        self.to.try_send(stated)?;
        Ok(self.sent.fetch_add(1, Ordering::Relaxed) + 1)
    }

    /// True if the worker has taken the statement of this number.
    pub(crate) fn has_taken(&self, number: u64) -> bool {
        number <= self.taken.load(Ordering::Acquire)
    }
}
