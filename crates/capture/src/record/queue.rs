//! Bounded queue between the draining thread and the writing thread: a slow disk causes counted
//! message loss, without effect on other processes.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::item::Item;

/// The queue.
#[derive(Debug)]
pub(crate) struct Queue {
    state: Mutex<State>,
    changed: Condvar,
    max_bytes: usize,
}

#[derive(Debug, Default)]
struct State {
    items: VecDeque<Item>,
    bytes: usize,
    closed: bool,
}

/// Result of waiting for an item.
#[derive(Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "it is destructured where it is created"
)]
pub(crate) enum Popped {
    /// The oldest item.
    Item(Item),
    /// Timeout.
    Nothing,
    /// The queue is closed and empty.
    Closed,
}

impl Queue {
    pub(crate) fn new(max_bytes: usize) -> Self {
        Self {
            state: Mutex::default(),
            changed: Condvar::new(),
            max_bytes,
        }
    }

    /// Appends the item unless the queue is full; then it is dropped. Returns whether it was
    /// appended.
    #[must_use]
    pub(crate) fn push(&self, item: Item) -> bool {
        let bytes = item.bytes();
        let mut state = self.lock();
        // An item larger than the whole queue fits into an empty one.
        let full = state.bytes + bytes > self.max_bytes && !state.items.is_empty();
        if full || state.closed {
            return false;
        }
        state.bytes += bytes;
        state.items.push_back(item);
        drop(state);
        self.changed.notify_one();
        true
    }

    /// Removes the oldest item, waiting up to `patience` for one.
    pub(crate) fn pop(&self, patience: Duration) -> Popped {
        let state = self.lock();
        let is_idle = |state: &mut State| state.items.is_empty() && !state.closed;
        let waited = self.changed.wait_timeout_while(state, patience, is_idle);
        let (mut state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        match state.items.pop_front() {
            Some(item) => {
                state.bytes -= item.bytes();
                Popped::Item(item)
            }
            None if state.closed => Popped::Closed,
            None => Popped::Nothing,
        }
    }

    /// Closes the queue.
    pub(crate) fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    /// No panic occurs while the lock is held, and the items would still be valid.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
