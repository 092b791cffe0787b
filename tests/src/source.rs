//! A source that sends what a test tells it to.

use joulebus_wire::Sample;

use crate::{Child, Ended, Forge, FrameLine, PATIENCE, SourceLine};

/// A source in a process of its own.
#[derive(Debug)]
pub struct Source {
    /// The process.
    pub child: Child,
    /// When its run began, monotonic ns.
    pub source_epoch: u64,
    read: usize,
}

impl Source {
    pub(crate) fn new(child: Child) -> Self {
        let mut source = Self {
            child,
            source_epoch: 0,
            read: 0,
        };
        match source.answer() {
            SourceLine::Ready { source_epoch } => source.source_epoch = source_epoch,
            other => panic!("{other:?}: {}", source.child.tail()),
        }
        source
    }

    /// Sends a frame; how many read it.
    pub fn send(&mut self, samples: &[Sample]) -> usize {
        self.send_forged(samples, Forge::default())
    }

    /// Sends a frame whose header lies; how many read it.
    pub fn send_forged(&mut self, samples: &[Sample], forge: Forge) -> usize {
        let samples = samples.iter().copied().map(Into::into).collect();
        self.send_all(&[FrameLine { samples, forge }])
    }

    /// Sends frames one right after the other; how many read the last.
    pub fn send_all(&mut self, frames: &[FrameLine]) -> usize {
        let line = serde_json::to_string(frames).expect("plain data");
        self.child.tell(&line);
        match self.answer() {
            SourceLine::Sent { readers, .. } => readers,
            other => panic!("{other:?}: {}", self.child.tail()),
        }
    }

    /// Lets it leave, and waits for it.
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
