//! Bounded queue between the draining thread and the writing thread: a slow disk causes counted
//! message loss, without effect on other processes.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::item::Item;

#[derive(Debug)]
pub(crate) struct Queue {
    state: Mutex<State>,
    max_bytes: usize,
}

#[derive(Debug, Default)]
struct State {
    items: VecDeque<Item>,
    bytes: usize,
    closed: bool,
}

impl Queue {
    pub(crate) fn new(max_bytes: usize) -> Self {
        Self { state: Mutex::default(), max_bytes }
    }

    /// Appends the item unless the queue is full. Then it is dropped. Returns whether it was
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
        true
    }

    /// Removes the oldest item. `None` if there is none now.
    pub(crate) fn pop(&self) -> Option<Item> {
        let mut state = self.lock();
        let item = state.items.pop_front()?;
        state.bytes -= item.bytes();
        Some(item)
    }

    /// Closes the queue: what is pushed from now on is dropped.
    pub(crate) fn close(&self) {
        self.lock().closed = true;
    }

    /// No panic occurs while the lock is held, and the items would still be valid.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
