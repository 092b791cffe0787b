//! Ports and nodes of this process, and when they may be dropped.
#![allow(unsafe_code)] // A value is dropped, or not.

use std::fmt;
use std::mem::ManuallyDrop;
use std::ops::{Deref, DerefMut};

use super::presence::RequiredFiles;
use crate::os::fork::ForkSection;

/// A value of iceoryx2 that another crate may own. Each crate compiles the code that drops what it
/// owns, and that of a port is most of iceoryx2. So it is behind a pointer.
pub(crate) struct DropsHere<T> {
    value: ManuallyDrop<T>,
    drop: unsafe fn(&mut ManuallyDrop<T>),
}

impl<T> DropsHere<T> {
    /// To be called in this crate, by what is not generic: what drops `T` is compiled there.
    pub(crate) const fn new(value: T) -> Self {
        Self { value: ManuallyDrop::new(value), drop: ManuallyDrop::drop }
    }

    /// From now on the value stays when this is dropped.
    fn leak(&mut self) {
        self.drop = |_| ();
    }

    pub(crate) fn into_inner(self) -> T {
        let mut this = ManuallyDrop::new(self);
        // SAFETY: the value is taken once, and `this` is not dropped.
        unsafe { ManuallyDrop::take(&mut this.value) }
    }
}

impl<T> Drop for DropsHere<T> {
    fn drop(&mut self) {
        // SAFETY: the value is dropped once, and not used afterwards.
        unsafe { (self.drop)(&mut self.value) };
    }
}

impl<T> Deref for DropsHere<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T> DerefMut for DropsHere<T> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.value
    }
}

impl<T> fmt::Debug for DropsHere<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(std::any::type_name::<T>())
    }
}

/// A port or node with the files it needs. Dropping it removes its files by name. If ours were
/// removed, these may be another process's by then: in that case the value is leaked. The process
/// is about to end.
#[derive(Debug)]
pub(crate) struct Guarded<T> {
    // Dropped in this order.
    need: Option<RequiredFiles>,
    value: DropsHere<T>,
    /// While the value is dropped: the last port of a node drops the node.
    section: Option<ForkSection>,
}

impl<T> Guarded<T> {
    /// As [`DropsHere::new`].
    pub(crate) const fn new(value: T, need: RequiredFiles) -> Self {
        Self { need: Some(need), value: DropsHere::new(value), section: None }
    }
}

impl<T> Drop for Guarded<T> {
    fn drop(&mut self) {
        self.section = Some(ForkSection::enter());
        let is_whole = self.need.as_ref().is_some_and(RequiredFiles::is_met);
        // From here on the files may be removed.
        self.need = None;
        if !is_whole {
            self.value.leak();
        }
    }
}

impl<T> Deref for Guarded<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T> DerefMut for Guarded<T> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.value
    }
}
