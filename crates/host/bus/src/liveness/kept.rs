//! Ports and nodes of this process, and when they may be dropped.
#![allow(unsafe_code)] // A value is dropped, or not.

use std::mem::ManuallyDrop;
use std::ops::{Deref, DerefMut};

use super::presence::Need;

/// A port or node with the files it needs. Dropping it removes its files by name. If ours were
/// removed, these may be another process's by then: in that case the value is leaked. The process
/// is about to end.
#[derive(Debug)]
pub(crate) struct Kept<T> {
    need: Option<Need>,
    value: ManuallyDrop<T>,
}

impl<T> Kept<T> {
    pub(crate) const fn new(value: T, need: Need) -> Self {
        Self { need: Some(need), value: ManuallyDrop::new(value) }
    }
}

impl<T> Drop for Kept<T> {
    fn drop(&mut self) {
        let is_whole = self.need.as_ref().is_some_and(Need::is_met);
        // From here on the files may be removed.
        self.need = None;
        if is_whole {
            // SAFETY: the value is dropped once, and not used afterwards.
            unsafe { ManuallyDrop::drop(&mut self.value) };
        }
    }
}

impl<T> Deref for Kept<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T> DerefMut for Kept<T> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.value
    }
}
