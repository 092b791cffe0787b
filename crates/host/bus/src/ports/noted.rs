//! Memory of sources, which is mapped before it is read.

use joulebus_wire::Samples;

use super::Received;
use crate::os::memory;

/// Number of sources that [`Noted`] remembers.
const MAX_NOTED: usize = 256;

/// Ports of sources whose memory is completely mapped.
#[derive(Debug)]
pub(super) struct Noted(Vec<u128>);

impl Noted {
    pub(super) fn new() -> Self {
        Self(Vec::with_capacity(MAX_NOTED))
    }

    /// Maps the memory of the frame's source.
    pub(super) fn note(&mut self, received: &Received<Samples>) {
        let source = received.writer();
        if self.0.contains(&source) {
            return;
        }
        // Bounded, because sources are replaced over months. Forgetting one costs one more scan.
        if self.0.len() == MAX_NOTED {
            self.0.clear();
        }
        self.0.push(source);
        memory::map(&source.to_string());
    }
}
