//! Accounts for every sample of each source: sent = accepted + dropped, exactly.

use joulebus_wire::{DropCounts, DropReason, SampleHeader};
use serde::{Deserialize, Serialize};

/// One run of one source.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(crate) struct Source {
    id: u64,
    epoch: u64,
    /// Samples of this epoch accounted for: taken, refused or lost.
    accounted: u64,
}

/// The sources that have sent a frame.
#[derive(Debug)]
pub(crate) struct Sources {
    sources: Vec<Source>,
    most: usize,
    /// Place of the source that was looked up last.
    recent: usize,
}

impl Sources {
    pub(crate) fn new(most: u16) -> Self {
        let most = usize::from(most);
        Self {
            sources: Vec::with_capacity(most),
            most,
            recent: 0,
        }
    }

    /// Takes a frame's header and the number of samples in it. Counts what was lost before it, and
    /// refuses a frame of an older run, a frame seen before, and a source too many.
    pub(crate) fn frame(
        &mut self,
        header: &SampleHeader,
        samples: u64,
        drops: &mut DropCounts,
    ) -> Result<(), DropReason> {
        let at = match self.find(header.source_id) {
            Some(at) => at,
            None if self.sources.len() == self.most => return Err(DropReason::TooManySources),
            None => {
                self.sources.push(Source {
                    id: header.source_id,
                    epoch: header.source_epoch,
                    accounted: 0,
                });
                self.sources.len() - 1
            }
        };
        let source = &mut self.sources[at];
        if header.source_epoch < source.epoch {
            return Err(DropReason::OldEpoch);
        }
        if header.source_epoch > source.epoch {
            *source = Source {
                accounted: 0,
                epoch: header.source_epoch,
                ..*source
            };
        }
        if header.samples_before < source.accounted {
            return Err(DropReason::Duplicate);
        }
        let lost = header.samples_before - source.accounted;
        let reason = if source.accounted == 0 {
            DropReason::BeforeJoin
        } else {
            DropReason::Overflow
        };
        drops.add(reason, lost);
        source.accounted = header.samples_before.saturating_add(samples);
        Ok(())
    }

    pub(crate) fn all(&self) -> &[Source] {
        &self.sources
    }

    /// Continues with `sources`, at most as many as the capacity allows.
    pub(crate) fn replace(&mut self, sources: &[Source]) {
        self.sources.clear();
        self.sources.extend_from_slice(sources);
        self.recent = 0;
    }

    /// The last one found is looked at first: frames of one source follow each other.
    fn find(&mut self, id: u64) -> Option<usize> {
        if self
            .sources
            .get(self.recent)
            .is_some_and(|source| source.id == id)
        {
            return Some(self.recent);
        }
        let at = self.sources.iter().position(|source| source.id == id)?;
        self.recent = at;
        Some(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(source_id: u64, source_epoch: u64, samples_before: u64) -> SampleHeader {
        SampleHeader {
            source_id,
            source_epoch,
            samples_before,
            ..SampleHeader::default()
        }
    }

    #[test]
    fn what_is_lost_before_and_between_frames_is_counted() {
        let (mut sources, mut drops) = (Sources::new(2), DropCounts::default());
        let mut frame = |id, epoch, before, drops: &mut DropCounts| {
            sources.frame(&header(id, epoch, before), 10, drops)
        };
        assert_eq!(frame(1, 5, 30, &mut drops), Ok(()));
        assert_eq!(drops.get(DropReason::BeforeJoin), 30);
        assert_eq!(frame(1, 5, 40, &mut drops), Ok(()));
        assert_eq!(frame(1, 5, 70, &mut drops), Ok(()));
        assert_eq!(drops.get(DropReason::Overflow), 20);
        assert_eq!(frame(1, 5, 70, &mut drops), Err(DropReason::Duplicate));
        assert_eq!(frame(1, 4, 0, &mut drops), Err(DropReason::OldEpoch));
        assert_eq!(frame(1, 6, 0, &mut drops), Ok(()));
        assert_eq!(frame(2, 1, 0, &mut drops), Ok(()));
        assert_eq!(frame(3, 1, 0, &mut drops), Err(DropReason::TooManySources));
        assert_eq!(drops.total(), 50);
    }
}
