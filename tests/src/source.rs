//! A source controlled by a test.

use joulebus_wire::Sample;

use crate::{Child, Ended, Forge, FrameLine, PATIENCE, SourceLine};

/// A source in a separate process.
#[derive(Debug)]
pub struct Source {
    pub child: Child,
    /// When its run began, monotonic ns.
    pub source_epoch: u64,
    read: usize,
}

impl Source {
    pub(crate) fn new(child: Child) -> Self {
        let mut source = Self { child, source_epoch: 0, read: 0 };
        match source.answer() {
            SourceLine::Ready { source_epoch } => source.source_epoch = source_epoch,
            other => panic!("{other:?}: {}", source.child.tail()),
        }
        source
    }

    /// Sends a frame; returns the number of readers.
    pub fn send(&mut self, samples: &[Sample]) -> usize {
        self.send_forged(samples, Forge::default())
    }

    /// Sends a frame with a forged header; returns the number of readers.
    pub fn send_forged(&mut self, samples: &[Sample], forge: Forge) -> usize {
        self.send_all(&[FrameLine::new(samples, forge)])
    }

    /// Sends frames without a pause; returns the number of readers of the last one.
    pub fn send_all(&mut self, frames: &[FrameLine]) -> usize {
        let line = serde_json::to_string(frames).expect("plain data");
        self.child.send_line(&line);
        match self.answer() {
            SourceLine::Sent { readers, .. } => readers,
            other => panic!("{other:?}: {}", self.child.tail()),
        }
    }

    /// Closes its stdin and waits for the exit.
    pub fn leave(mut self) -> Ended {
        self.child.finish()
    }

    fn answer(&mut self) -> SourceLine {
        let lines = self.child.lines(self.read, PATIENCE);
        let Some(line) = lines.first() else {
            panic!("no answer: {}", self.child.tail());
        };
        self.read += 1;
        serde_json::from_str(line).unwrap_or_else(|error| panic!("{error} in {line:?}"))
    }
}
