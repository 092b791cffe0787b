//! How a sample gets in: its robot's slot, who may speak for the robot, and what is refused.

use joulebus_wire::{DropReason, Sample, SampleHeader};

use crate::alarms::detector::Detector;
use crate::estimate::interval::ConformalInterval;
use crate::estimate::mixture::Blend;
use crate::estimate::scores::Scores;
use crate::estimate::window::Window;
use crate::fleet::Fleet;
use crate::ingest::check::{check_values, invalid};
use crate::ingest::robot::{AdmissionState, Last, Pending, PendingState};
use crate::layout::lanes::{self, Block as _, LANES};
use crate::ledger::energy::Ledger;
use crate::state::columns::Columns;
use crate::tick::score::{Facts, judge};

impl Fleet {
    pub(crate) fn accept(
        &mut self,
        header: &SampleHeader,
        sample: &Sample,
        now_ns: u64,
    ) -> Result<(), DropReason> {
        let slot = self.slot(header, sample.robot, now_ns)?;
        self.identify(slot, header, sample.seq)?;
        let most = self.settings.intake.max_samples_per_tick;
        if self.columns.admissions[slot].taken >= most {
            return Err(DropReason::Backlog);
        }
        if !self.columns.pending[slot / LANES].is(slot % LANES, PendingState::None) {
            self.catch_up(slot);
        }
        let admission = &self.columns.admissions[slot];
        check_values(
            sample,
            &self.contexts[usize::from(admission.platform)].platform,
        )?;
        let broken = !in_time(admission, sample.stamp_ns, self.settings.intake.max_jump_ns);
        if broken && !admission.renewed {
            return Err(DropReason::BadTime);
        }
        let admission = self.hear(slot);
        admission.taken += 1;
        admission.renewed = false;
        (admission.taken_ns, admission.invalid, admission.refused_run) = (now_ns, None, 0);
        let (block, lane) = (&mut self.columns.pending[slot / LANES], slot % LANES);
        let pending = Pending::new(sample, broken);
        block.samples.set(lane, true, pending);
        block.mark(lane, true, PendingState::Waiting);
        Ok(())
    }

    /// Ownership, run and order: who may speak for the robot, once.
    fn identify(&mut self, slot: usize, header: &SampleHeader, seq: u64) -> Result<(), DropReason> {
        let admission = &mut self.columns.admissions[slot];
        if admission.source_id != header.source_id {
            return Err(DropReason::ForeignSource);
        }
        if header.source_epoch < admission.source_epoch {
            return Err(DropReason::OldEpoch);
        }
        if header.source_epoch > admission.source_epoch {
            (admission.source_epoch, admission.ordered, admission.renewed) =
                (header.source_epoch, false, true);
        }
        if admission.ordered && seq <= admission.seq {
            return Err(if seq == admission.seq {
                DropReason::Duplicate
            } else {
                DropReason::OutOfOrder
            });
        }
        (admission.seq, admission.ordered) = (seq, true);
        Ok(())
    }

    pub(crate) fn refuse(&mut self, header: &SampleHeader, sample: &Sample, reason: DropReason) {
        self.drops.add(reason, 1);
        self.refused.note(sample.robot, reason, header.pid);
        let (Some(invalid), Some(slot)) = (invalid(reason), self.find(sample.robot)) else {
            return;
        };
        // Nothing better will come of it in this tick: the others need not wait for it.
        let admission = self.hear(slot);
        admission.refused_run = admission.refused_run.saturating_add(1);
        admission.invalid = Some(invalid);
        self.columns.lasts[slot / LANES].refused[slot % LANES] += 1;
        let rules = self.rules();
        let context = &self.contexts[usize::from(self.columns.admissions[slot].platform)];
        let admission = &self.columns.admissions[slot];
        let last = lanes::get(&self.columns.lasts, slot);
        let scored = lanes::get(&self.columns.scores, slot).count;
        let mut detector = lanes::get(&self.columns.detectors, slot);
        let facts = Facts::of(admission, &last);
        let conditions = judge(&rules, context, &facts, scored, &detector);
        detector.decide(conditions, &self.settings.alarms);
        lanes::set(&mut self.columns.detectors, slot, detector);
    }

    /// Takes note that a sample of the robot has come in this tick.
    fn hear(&mut self, slot: usize) -> &mut AdmissionState {
        let admission = &mut self.columns.admissions[slot];
        self.reported += usize::from(!admission.heard);
        admission.heard = true;
        admission
    }

    /// The robot's slot; a robot heard of for the first time is given one.
    fn slot(
        &mut self,
        header: &SampleHeader,
        robot: u32,
        now_ns: u64,
    ) -> Result<usize, DropReason> {
        let guessed = self
            .columns
            .admissions
            .get(self.guess)
            .filter(|guess| guess.present && guess.id == robot);
        let found = match guessed {
            Some(_) => Some(self.guess),
            None => self.find(robot),
        };
        if let Some(slot) = found {
            self.guess = slot + 1;
            return Ok(slot);
        }
        let context = self.platform_of(robot).ok_or(DropReason::UnknownRobot)?;
        let Columns {
            slots, admissions, ..
        } = &mut self.columns;
        let slot = slots.take(context, |slot| admissions[slot].platform);
        let slot = slot.ok_or(DropReason::OverCapacity)?;
        self.slot_of.insert(robot, slot as u32);
        self.occupy(slot, robot, context, header, now_ns);
        Ok(slot)
    }

    fn occupy(&mut self, slot: usize, id: u32, context: u16, header: &SampleHeader, now_ns: u64) {
        let departed = self.departed.take(id);
        let columns = &mut self.columns;
        columns.admissions[slot] = AdmissionState {
            id,
            present: true,
            platform: context,
            generation: columns.admissions[slot].generation,
            source_id: header.source_id,
            source_epoch: header.source_epoch,
            taken_ns: now_ns,
            charged: departed.is_some_and(|departed| departed.charged),
            ..AdmissionState::FREE
        };
        let context = &self.contexts[usize::from(context)];
        if let Some(blending) = &context.blending {
            columns.blends[slot] = Blend::new(blending);
        }
        let residual = context.model.residual();
        columns.pending[slot / LANES].mark(slot % LANES, true, PendingState::None);
        lanes::set(&mut columns.windows, slot, Window::EMPTY);
        lanes::set(&mut columns.lasts, slot, Last::NONE);
        let ledger = departed.map_or_else(Ledger::default, |departed| departed.ledger);
        let interval = ConformalInterval::new(
            residual.q05_w,
            residual.q95_w,
            context.platform.power_resolution_w,
            self.settings.interval.coverage,
        );
        lanes::set(&mut columns.ledgers, slot, ledger);
        lanes::set(&mut columns.intervals, slot, interval);
        lanes::set(&mut columns.scores, slot, Scores::default());
        lanes::set(&mut columns.detectors, slot, Detector::new());
    }

    pub(crate) fn platform_of(&self, robot: u32) -> Option<u16> {
        let after = self.ranges.partition_point(|(start, _, _)| *start <= robot);
        let (_, end, context) = self.ranges.get(after.checked_sub(1)?)?;
        (robot <= *end).then_some(*context)
    }
}

/// Whether a stamp lies after the robot's last one, and not further than `longest_ns`.
fn in_time(admission: &AdmissionState, stamp_ns: u64, longest_ns: u64) -> bool {
    !admission.accepted
        || (stamp_ns > admission.stamp_ns && stamp_ns - admission.stamp_ns <= longest_ns)
}
