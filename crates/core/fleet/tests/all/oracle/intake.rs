//! Reference of ingest: which samples are taken, and which are refused for which reason:
//! membership, ownership, order, values.

use std::collections::{BTreeMap, VecDeque};

use joulebus_predictor::Model;
use joulebus_settings::FleetSettings;
use joulebus_wire::{DropReason, InvalidReason, SCHEMA_VERSION, Sample, SampleHeader, sample_flag};

use super::robot::{Account, Errors, Robot};

/// A robot in the fleet, with its admission state.
#[derive(Debug)]
pub(crate) struct Member {
    pub robot: Robot,
    pub context: usize,
    owner: u64,
    epoch: u64,
    seqs: Vec<u64>,
    fresh_run: bool,
    pub received_ns: u64,
    /// The lowest free slot when it joined: robots that leave together do so in this order.
    slot: usize,
    taken: u16,
    pub refused: u64,
    pub invalid: Option<InvalidReason>,
}

/// A source, with the two runs of it that matter: epochs and samples accounted for.
#[derive(Debug, Clone, Copy)]
struct Known {
    id: u64,
    run: (u64, u64),
    other: Option<(u64, u64)>,
    received_ns: u64,
}

pub(crate) struct Oracle {
    settings: FleetSettings,
    pub models: Vec<Model>,
    pub errors: Vec<Errors>,
    pub members: BTreeMap<u32, Member>,
    pub departed: VecDeque<(u32, Account)>,
    sources: Vec<Known>,
    /// Sources that had to make room for others.
    pub recycled: u64,
    pub ended: u64,
    pub accepted: u64,
    pub drops: BTreeMap<&'static str, u64>,
}

impl Oracle {
    pub(crate) fn new(settings: FleetSettings, models: Vec<Model>) -> Self {
        let errors = models.iter().zip(&settings.platforms);
        Self {
            errors: errors.map(|(model, platform)| Errors::new(model, platform)).collect(),
            settings,
            models,
            members: BTreeMap::new(),
            departed: VecDeque::new(),
            sources: Vec::new(),
            recycled: 0,
            ended: 0,
            accepted: 0,
            drops: BTreeMap::new(),
        }
    }

    pub(crate) fn keeps_account_of(&self, source_id: u64) -> bool {
        self.sources.iter().any(|known| known.id == source_id)
    }

    pub(crate) fn has_free_place(&self) -> bool {
        self.sources.len() < usize::from(self.settings.intake.max_sources)
    }

    fn drop(&mut self, reason: DropReason, count: u64) {
        if count > 0 {
            let counted = self.drops.entry(reason.name()).or_default();
            *counted = counted.saturating_add(count);
        }
    }

    pub(crate) fn take(&mut self, header: &SampleHeader, samples: &[Sample], now_ns: u64) {
        if let Err(reason) = self.frame(header, samples.len() as u64, now_ns) {
            self.drop(reason, samples.len() as u64);
            return;
        }
        for sample in samples {
            match self.sample(header, sample, now_ns) {
                Ok(()) => self.accepted += 1,
                Err(reason) => self.refuse(sample.robot, reason),
            }
        }
    }

    fn frame(&mut self, header: &SampleHeader, count: u64, now_ns: u64) -> Result<(), DropReason> {
        if header.schema != SCHEMA_VERSION {
            return Err(DropReason::Schema);
        }
        let epoch = header.source_epoch;
        let at = self.place(header, now_ns)?;
        let mut known = self.sources[at];
        let platforms = self.settings.platforms.iter();
        let stale_after_ns = platforms.map(|platform| platform.stale_after_ns).max();
        let silent = now_ns - known.received_ns > stale_after_ns.expect("there are platforms");
        let next = header.samples_before.saturating_add(count);
        if epoch < known.run.0 && !silent {
            return Err(DropReason::OldEpoch);
        }
        if epoch != known.run.0 {
            let newer = epoch > known.run.0;
            let before = known.other.filter(|(other, _)| newer && *other == epoch);
            let unaccounted = if newer { 0 } else { header.samples_before };
            known.other = Some(known.run);
            known.run = before.unwrap_or((epoch, unaccounted));
        }
        self.sources[at] = known;
        let accounted = known.run.1;
        if header.samples_before < accounted && !silent {
            return Err(DropReason::Duplicate);
        }
        self.lose(header.samples_before, accounted);
        known.run.1 = next;
        known.received_ns = now_ns;
        self.sources[at] = known;
        Ok(())
    }

    /// The present run of a source has ended.
    pub(crate) fn end(&mut self, id: u64, epoch: u64) {
        for known in &mut self.sources {
            if (known.id, known.run.0) == (id, epoch) {
                known.received_ns = 0;
                self.ended += 1;
            }
        }
    }

    /// The source's slot. A new source gets a free one, or that of the source that was silent
    /// longest.
    fn place(&mut self, header: &SampleHeader, now_ns: u64) -> Result<usize, DropReason> {
        let (id, epoch) = (header.source_id, header.source_epoch);
        if let Some(at) = self.sources.iter().position(|known| known.id == id) {
            return Ok(at);
        }
        let free = self.has_free_place();
        let new = Known {
            id,
            // A source that returns, or was refused before, is not counted twice.
            run: (epoch, if free { 0 } else { header.samples_before }),
            other: None,
            received_ns: now_ns,
        };
        let intake = self.settings.intake;
        if free {
            self.sources.push(new);
            return Ok(self.sources.len() - 1);
        }
        let longest = self.sources.iter().map(|known| known.received_ns).min();
        let longest = longest.expect("there are places");
        if now_ns - longest <= intake.leave_after_ns {
            return Err(DropReason::TooManySources);
        }
        let silent = |known: &Known| known.received_ns == longest;
        let at = self.sources.iter().position(silent).expect("just found");
        self.sources[at] = new;
        self.recycled += 1;
        Ok(at)
    }

    fn lose(&mut self, before: u64, accounted: u64) {
        let reason = if accounted == 0 { DropReason::BeforeJoin } else { DropReason::Overflow };
        self.drop(reason, before.saturating_sub(accounted));
    }

    fn kind_of(&self, id: u32) -> Option<usize> {
        self.settings
            .platforms
            .iter()
            .position(|platform| platform.robots.iter().any(|range| range.contains(&id)))
    }

    fn join(&mut self, header: &SampleHeader, id: u32, now_ns: u64) -> Result<(), DropReason> {
        if self.members.contains_key(&id) {
            return Ok(());
        }
        let context = self.kind_of(id).ok_or(DropReason::UnknownRobot)?;
        if self.members.len() == self.settings.capacity as usize {
            return Err(DropReason::OverCapacity);
        }
        let kept = self.departed.iter().position(|(kept, _)| *kept == id);
        let account = kept.map_or_else(Account::default, |place| {
            // The oldest moves to the freed slot.
            self.departed.swap(0, place);
            self.departed.pop_front().expect("it was just found").1
        });
        let slot = (0..self.members.len())
            .find(|slot| self.members.values().all(|member| member.slot != *slot))
            .unwrap_or(self.members.len());
        let member = Member {
            robot: Robot::new(
                id,
                self.settings.platforms[context].clone(),
                account,
                self.errors[context].calibration.platform(),
            ),
            context,
            owner: header.source_id,
            epoch: header.source_epoch,
            seqs: Vec::new(),
            fresh_run: false,
            received_ns: now_ns,
            slot,
            taken: 0,
            refused: 0,
            invalid: None,
        };
        self.members.insert(id, member);
        Ok(())
    }

    fn sample(
        &mut self,
        header: &SampleHeader,
        sample: &Sample,
        now_ns: u64,
    ) -> Result<(), DropReason> {
        self.join(header, sample.robot, now_ns)?;
        let intake = self.settings.intake;
        let member = self.members.get_mut(&sample.robot).expect("the robot has joined");
        let owner = self.sources.iter().find(|known| known.id == member.owner);
        let is_free = owner.is_none_or(|owner| owner.received_ns == 0);
        let is_own = member.owner == header.source_id;
        if !is_own && !is_free {
            return Err(DropReason::ForeignSource);
        }
        member.owner = header.source_id;
        if !is_own || header.source_epoch != member.epoch {
            member.epoch = header.source_epoch;
            member.seqs.clear();
            member.fresh_run = true;
        }
        let highest = member.seqs.iter().max().copied();
        if highest == Some(sample.seq) {
            return Err(DropReason::Duplicate);
        }
        if highest > Some(sample.seq) {
            return Err(DropReason::OutOfOrder);
        }
        member.seqs.push(sample.seq);
        if member.taken >= intake.max_samples_per_tick {
            return Err(DropReason::Backlog);
        }
        // Of which values are admitted, joulebus-settings has its own tests.
        member.robot.platform.admit(sample)?;
        let mut sample = *sample;
        if let Some(last) = member.robot.last {
            let later = sample.stamp_ns > last.stamp_ns;
            let near = sample.stamp_ns.saturating_sub(last.stamp_ns) <= intake.max_jump_ns;
            if !(later && near) {
                if !member.fresh_run {
                    return Err(DropReason::BadTime);
                }
                sample.flags |= sample_flag::DISCONTINUITY;
            }
        }
        member.fresh_run = false;
        member.taken += 1;
        (member.received_ns, member.invalid) = (now_ns, None);
        let (model, errors) = (&self.models[member.context], &mut self.errors[member.context]);
        member.robot.accept(&sample, model, errors);
        Ok(())
    }

    fn refuse(&mut self, id: u32, reason: DropReason) {
        self.drop(reason, 1);
        let invalid = match reason {
            DropReason::NotFinite => InvalidReason::NotFinite,
            DropReason::PowerOutOfRange => InvalidReason::PowerOutOfRange,
            DropReason::CommandOutOfRange => InvalidReason::CommandOutOfRange,
            DropReason::BadFlags => InvalidReason::BadFlags,
            DropReason::BatteryOutOfRange => InvalidReason::BatteryOutOfRange,
            DropReason::BadTime => InvalidReason::BadTime,
            _ => return,
        };
        let member = self.members.get_mut(&id).expect("the robot has joined");
        member.refused += 1;
        member.invalid = Some(invalid);
    }

    /// Ends the tick: robots that have been silent for too long leave.
    pub(crate) fn tick(&mut self, now_ns: u64) {
        let leave_after_ns = self.settings.intake.leave_after_ns;
        let mut gone: Vec<u32> = self
            .members
            .iter()
            .filter(|(_, member)| now_ns - member.received_ns > leave_after_ns)
            .map(|(id, _)| *id)
            .collect();
        gone.sort_by_key(|id| self.members[id].slot);
        for id in gone {
            let member = self.members.remove(&id).expect("it was just found");
            // A robot without any accepted sample has no account. At most as many are kept as the
            // capacity.
            if member.robot.account.last.is_none() {
                continue;
            }
            if self.departed.len() == self.settings.capacity as usize {
                self.departed.pop_front();
            }
            self.departed.push_back((id, member.robot.account));
        }
        for errors in &mut self.errors {
            errors.calibration.add(&std::mem::take(&mut errors.counts));
        }
        for member in self.members.values_mut() {
            member.robot.absorb(&mut self.errors[member.context]);
            member.taken = 0;
        }
    }
}
