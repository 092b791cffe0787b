//! Sample accounting per source: sent = accepted + dropped, exactly.

use joulebus_settings::FleetSettings;
use joulebus_wire::{DropCounts, DropReason, SampleHeader};
use serde::{Deserialize, Serialize};

use crate::layout::shift::Shift;

/// One run of a source.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
struct SourceRun {
    epoch: u64,
    /// Samples accounted for: taken, refused or lost.
    accounted: u64,
}

impl SourceRun {
    /// Accounts for a frame, and counts the samples lost before it. Returns false for a frame seen
    /// before.
    fn account(&mut self, header: &SampleHeader, samples: u64, drops: &mut DropCounts) -> bool {
        let Some(lost) = header.samples_before.checked_sub(self.accounted) else {
            return false;
        };
        let reason =
            if self.accounted == 0 { DropReason::BeforeJoin } else { DropReason::Overflow };
        drops.add(reason, lost);
        self.accounted = header.samples_before.saturating_add(samples);
        true
    }
}

/// A source, with the run whose samples are taken.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(crate) struct Source {
    id: u64,
    run: SourceRun,
    /// The previous run. If it turns out to be the newer one, its samples are not counted again.
    other: Option<SourceRun>,
    /// When a frame of it was last taken, monotonic ns of the worker. 0 once its run has ended:
    /// from then on it counts as silent for ever.
    taken_ns: u64,
}

impl Source {
    /// `accounted`: samples of the run that are not to be counted as lost.
    const fn new(header: &SampleHeader, accounted: u64, now_ns: u64) -> Self {
        Self {
            id: header.source_id,
            run: SourceRun { epoch: header.source_epoch, accounted },
            other: None,
            taken_ns: seen_at(now_ns),
        }
    }

    /// Takes a frame or refuses it. `silent` states that the accepted run has been silent for so
    /// long that any frame is believed instead.
    fn frame(
        &mut self,
        header: &SampleHeader,
        samples: u64,
        silent: bool,
        drops: &mut DropCounts,
    ) -> Result<(), DropReason> {
        if header.source_epoch < self.run.epoch {
            if !silent {
                return Err(DropReason::OldEpoch);
            }
            // Its losses in the meantime are unknown.
            self.replace(header.samples_before, header.source_epoch);
        } else if header.source_epoch > self.run.epoch {
            let returned = self.other.filter(|run| run.epoch == header.source_epoch);
            self.replace(returned.map_or(0, |run| run.accounted), header.source_epoch);
        }
        if self.run.account(header, samples, drops) {
            return Ok(());
        }
        if !silent {
            return Err(DropReason::Duplicate);
        }
        // The number far ahead was false, so this frame's number is correct again.
        self.run.accounted = header.samples_before.saturating_add(samples);
        Ok(())
    }

    /// True if it has ended, or is silent for longer than `allowed_ns`.
    const fn is_silent_for(&self, allowed_ns: u64, now_ns: u64) -> bool {
        self.taken_ns == 0 || now_ns.saturating_sub(self.taken_ns) > allowed_ns
    }

    /// Moves the instants to another clock.
    pub(crate) fn shift(&mut self, shift: Shift) {
        let Self {
            id: _,
            // Runs are names.
            run: _,
            other: _,
            taken_ns,
        } = self;
        shift.instant(taken_ns);
    }

    fn replace(&mut self, accounted: u64, epoch: u64) {
        self.other = Some(self.run);
        self.run = SourceRun { epoch, accounted };
    }
}

/// `now_ns` as an instant that is not taken for an end.
const fn seen_at(now_ns: u64) -> u64 {
    if now_ns == 0 { 1 } else { now_ns }
}

/// The sources that have sent a frame.
///
/// A source that has been silent for the time after which a robot leaves gives its slot to another.
/// A run that has been silent for the time after which a robot is stale is replaced by any run that
/// sends. One false frame therefore shuts a source out for that time. A source that has ended counts
/// as silent for ever, until a frame of it is taken.
#[derive(Debug)]
pub(crate) struct Sources {
    sources: Vec<Source>,
    most: usize,
    leave_after_ns: u64,
    yield_after_ns: u64,
    /// Place of the source that was looked up last.
    recent: usize,
}

impl Sources {
    pub(crate) fn new(settings: &FleetSettings) -> Self {
        let most = usize::from(settings.intake.max_sources);
        let stale_after_ns = settings.platforms.iter().map(|platform| platform.stale_after_ns);
        Self {
            sources: Vec::with_capacity(most),
            most,
            leave_after_ns: settings.intake.leave_after_ns,
            yield_after_ns: stale_after_ns.max().unwrap_or_default(),
            recent: 0,
        }
    }

    /// Takes the header of a frame that came at `now_ns`, and the number of samples in it. Counts
    /// the samples lost before it, and refuses a frame of an older run, a frame seen before, and a
    /// source too many.
    pub(crate) fn frame(
        &mut self,
        header: &SampleHeader,
        samples: u64,
        now_ns: u64,
        drops: &mut DropCounts,
    ) -> Result<(), DropReason> {
        let at = match self.find(header.source_id) {
            Some(at) => at,
            None if self.sources.len() < self.most => {
                self.sources.push(Source::new(header, 0, now_ns));
                self.sources.len() - 1
            }
            None => {
                let at = self.silent(now_ns).ok_or(DropReason::TooManySources)?;
                // It may have been here before, or was refused. No sample is counted twice.
                self.sources[at] = Source::new(header, header.samples_before, now_ns);
                at
            }
        };
        let silent = self.is_silent(&self.sources[at], now_ns);
        let source = &mut self.sources[at];
        source.frame(header, samples, silent, drops)?;
        source.taken_ns = seen_at(now_ns);
        Ok(())
    }

    /// The run `epoch` of a source has ended: its process is gone, or has closed its port. A run
    /// that has been replaced means nothing.
    pub(crate) fn end(&mut self, id: u64, epoch: u64) {
        if let Some(source) = self.sources.iter_mut().find(|source| source.id == id)
            && source.run.epoch == epoch
        {
            source.taken_ns = 0;
        }
    }

    /// True if a source has ended, or its place was given to another: its robots are free.
    pub(crate) fn has_ended(&self, id: u64) -> bool {
        let source = self.sources.iter().find(|source| source.id == id);
        source.is_none_or(|source| source.taken_ns == 0)
    }

    /// True if a frame that came at `now_ns`, or a later one of its source, has been taken,
    /// refused, or counted as lost.
    ///
    /// A frame of a replaced run counts as refused, unless the later run is silent, as in
    /// [`Sources::frame`]: the clock of a host that has booted restarts, and with it the numbers of
    /// its runs.
    pub(crate) fn has_accounted(&self, header: &SampleHeader, now_ns: u64) -> bool {
        let source = self.sources.iter().find(|source| source.id == header.source_id);
        source.is_some_and(|source| {
            let (run, epoch) = (&source.run, header.source_epoch);
            let other = source.other.filter(|other| other.epoch == epoch);
            match (epoch == run.epoch, other) {
                (true, _) => header.samples_before < run.accounted,
                (false, Some(other)) => header.samples_before < other.accounted,
                (false, None) => epoch < run.epoch && !self.is_silent(source, now_ns),
            }
        })
    }

    /// True if the accepted run gives way to any other.
    const fn is_silent(&self, source: &Source, now_ns: u64) -> bool {
        source.is_silent_for(self.yield_after_ns, now_ns)
    }

    /// The place of the source that has been silent longest, if that is long enough to give it to
    /// another.
    fn silent(&self, now_ns: u64) -> Option<usize> {
        let sources = self.sources.iter().enumerate();
        let (at, oldest) = sources.min_by_key(|(_, source)| source.taken_ns)?;
        oldest.is_silent_for(self.leave_after_ns, now_ns).then_some(at)
    }

    pub(crate) fn all(&self) -> &[Source] {
        &self.sources
    }

    /// Replaces the sources, at most as many as the capacity allows.
    pub(crate) fn replace(&mut self, sources: &[Source]) {
        self.sources.clear();
        self.sources.extend_from_slice(sources);
        self.recent = 0;
    }

    /// The last one found is checked first, because frames of one source often follow each other.
    fn find(&mut self, id: u64) -> Option<usize> {
        if self.sources.get(self.recent).is_some_and(|source| source.id == id) {
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

    const STALE_NS: u64 = 500;
    const LEAVE_NS: u64 = 3_000;

    fn sources(most: usize) -> Sources {
        Sources {
            sources: Vec::new(),
            most,
            leave_after_ns: LEAVE_NS,
            yield_after_ns: STALE_NS,
            recent: 0,
        }
    }

    fn header(source_id: u64, source_epoch: u64, samples_before: u64) -> SampleHeader {
        SampleHeader { source_id, source_epoch, samples_before, ..SampleHeader::default() }
    }

    #[test]
    fn what_is_lost_before_and_between_frames_is_counted() {
        let (mut sources, mut drops) = (sources(2), DropCounts::default());
        let mut frame = |id, epoch, before, drops: &mut DropCounts| {
            sources.frame(&header(id, epoch, before), 10, 1_000, drops)
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

    #[test]
    fn one_false_frame_shuts_a_source_out_for_as_long_as_makes_a_robot_stale_and_no_longer() {
        let far = u64::MAX;
        for (epoch, before, refused) in [
            (far, 0, DropReason::OldEpoch),
            (far, far, DropReason::OldEpoch),
            (8, 0, DropReason::OldEpoch),
            // The run is right and the number false.
            (7, far, DropReason::Duplicate),
            (7, 1 << 40, DropReason::Duplicate),
        ] {
            let (mut sources, mut drops) = (sources(1), DropCounts::default());
            let mut sent = 0;
            let mut real = |sources: &mut Sources, now_ns, drops: &mut DropCounts| {
                let taken = sources.frame(&header(1, 7, sent), 10, now_ns, drops);
                sent += 10;
                taken
            };
            for now_ns in [1_000, 1_100, 1_200] {
                assert_eq!(real(&mut sources, now_ns, &mut drops), Ok(()));
            }
            let forged = sources.frame(&header(1, epoch, before), 10, 1_250, &mut drops);
            assert_eq!(forged, Ok(()), "{epoch} {before}: it looks like the next run");
            for now_ns in (1_300..=1_250 + STALE_NS).step_by(100) {
                let taken = real(&mut sources, now_ns, &mut drops);
                assert_eq!(taken, Err(refused), "{epoch} {before} at {now_ns}");
            }
            let lost = drops;
            for now_ns in (1_800..9_000).step_by(100) {
                let taken = real(&mut sources, now_ns, &mut drops);
                assert_eq!(taken, Ok(()), "{epoch} {before} at {now_ns}");
            }
            // Refused samples are not counted as lost too.
            assert_eq!(drops, lost, "{epoch} {before}");
        }
    }

    #[test]
    fn a_source_has_ended_until_a_frame_of_it_is_taken_and_an_earlier_run_ends_nothing() {
        let (mut sources, mut drops) = (sources(2), DropCounts::default());
        assert!(sources.has_ended(1), "never seen");
        for (step, epoch) in [5, 6].into_iter().enumerate() {
            let taken = sources.frame(&header(1, epoch, 0), 10, 1_000, &mut drops);
            assert_eq!(taken, Ok(()), "step {step}");
        }
        sources.end(1, 5);
        sources.end(2, 6);
        assert!(!sources.has_ended(1), "run 5 was replaced by run 6");
        sources.end(1, 6);
        assert!(sources.has_ended(1));
        // A refused frame revives nobody.
        let strange = sources.frame(&header(2, 1, 0), 10, 1_001, &mut drops);
        assert_eq!((strange, sources.has_ended(1)), (Ok(()), true));
        assert_eq!(sources.frame(&header(1, 6, 10), 10, 1_002, &mut drops), Ok(()));
        assert!(!sources.has_ended(1));
        // Its slot is given away at once where there is no other.
        sources.end(1, 6);
        assert_eq!(sources.frame(&header(3, 1, 0), 10, 1_003, &mut drops), Ok(()));
        assert!(sources.has_ended(1) && !sources.has_ended(2));
        assert_eq!(drops.total(), 0);
    }

    #[test]
    fn an_older_run_is_accounted_for_until_the_later_one_gives_way_to_it() {
        let (mut sources, mut drops) = (sources(1), DropCounts::default());
        assert_eq!(sources.frame(&header(1, 7, 0), 10, 1_000, &mut drops), Ok(()));
        // Its host has booted.
        let booted = header(1, 2, 0);
        for now_ns in [0, 1_000, 1_000 + STALE_NS] {
            assert!(sources.has_accounted(&booted, now_ns), "at {now_ns}");
        }
        let now_ns = 1_001 + STALE_NS;
        assert!(!sources.has_accounted(&booted, now_ns));
        // A taken frame is not taken again, however late it comes.
        assert!(sources.has_accounted(&header(1, 7, 0), now_ns));
        assert_eq!(sources.frame(&booted, 10, now_ns, &mut drops), Ok(()));
        assert!(sources.has_accounted(&booted, now_ns));
        assert!(!sources.has_accounted(&header(1, 2, 10), now_ns));
        assert_eq!(drops.total(), 0);
    }

    #[test]
    fn a_hundred_thousand_names_find_places_and_no_living_source_loses_its_own() {
        let (mut sources, mut drops) = (sources(64), DropCounts::default());
        for name in 0..100_000_u64 {
            // 64 names in less than the time that makes a source leave would be too many.
            let now_ns = name * LEAVE_NS / 60;
            let living = sources.frame(&header(u64::MAX, 1, 10 * name), 10, now_ns, &mut drops);
            assert_eq!(living, Ok(()), "at {now_ns}");
            let named = sources.frame(&header(name, 1, 0), 10, now_ns, &mut drops);
            assert_eq!(named, Ok(()), "name {name} at {now_ns}");
        }
        assert_eq!((sources.all().len(), drops.total()), (64, 0));
    }

    #[test]
    fn a_flood_of_names_takes_the_places_of_silent_sources_alone() {
        let (mut sources, mut drops) = (sources(4), DropCounts::default());
        let mut taken = 0;
        for step in 0..10_000_u64 {
            let now_ns = step * 10;
            for id in [u64::MAX, u64::MAX - 1] {
                let living = sources.frame(&header(id, 1, 10 * step), 10, now_ns, &mut drops);
                assert_eq!(living, Ok(()), "{id} at {now_ns}");
            }
            let flooding = sources.frame(&header(step, 1, 0), 10, now_ns, &mut drops);
            taken += u64::from(flooding.is_ok());
        }
        // Two places, each free again after the silence.
        assert_eq!(taken, 2 * 100_000_u64.div_ceil(LEAVE_NS + 10));
    }
}
