//! Between the thread that empties shared memory and the one that writes: a queue of bounded size,
//! so that a slow disk costs messages, which are counted, and nobody else anything.

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

/// What waiting for an item came to.
#[derive(Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "it is taken apart where it is made"
)]
pub(crate) enum Popped {
    /// The oldest item.
    Item(Item),
    /// Nothing came in time.
    Nothing,
    /// Nothing will come any more.
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

    /// Appends the item if there is room; otherwise it is lost. Returns whether there was.
    #[must_use]
    pub(crate) fn push(&self, item: Item) -> bool {
        let bytes = item.bytes();
        let mut state = self.lock();
        // An item that is larger than the whole queue fits into an empty one.
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

    /// Takes the oldest item, waiting for one as long as `patience`.
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

    /// Nothing more goes in.
    pub(crate) fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    /// Nobody panics while holding the lock; and if so, the items are still whole.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
