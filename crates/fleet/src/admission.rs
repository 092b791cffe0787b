//! How a sample gets in: its robot's slot, who may speak for the robot, and what is refused.

use joulebus_wire::{DropReason, Sample, SampleHeader};

use crate::account::{Facts, judge};
use crate::columns::Columns;
use crate::detector::Detector;
use crate::intake::{check_values, invalid};
use crate::interval::Interval;
use crate::lanes::{self, Block as _, LANES};
use crate::mixture::Blend;
use crate::robot::{Gate, Last, News, Pending};
use crate::window::Window;
use crate::{Fleet, Ledger, Scores};

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
        if self.columns.gates[slot].taken >= most {
            return Err(DropReason::Backlog);
        }
        if !self.columns.news[slot / LANES].is(slot % LANES, News::None) {
            self.catch_up(slot);
        }
        let gate = &self.columns.gates[slot];
        check_values(sample, &self.kinds[usize::from(gate.platform)].platform)?;
        let broken = !in_time(gate, sample.stamp_ns, self.settings.intake.max_jump_ns);
        if broken && !gate.renewed {
            return Err(DropReason::BadTime);
        }
        let gate = self.hear(slot);
        gate.taken += 1;
        gate.renewed = false;
        (gate.taken_ns, gate.invalid, gate.refused_run) = (now_ns, None, 0);
        let (news, lane) = (&mut self.columns.news[slot / LANES], slot % LANES);
        let pending = Pending::new(sample, broken);
        news.samples.set(lane, true, pending);
        news.mark(lane, true, News::Waiting);
        Ok(())
    }

    /// Ownership, run and order: who may speak for the robot, once.
    fn identify(&mut self, slot: usize, header: &SampleHeader, seq: u64) -> Result<(), DropReason> {
        let gate = &mut self.columns.gates[slot];
        if gate.source_id != header.source_id {
            return Err(DropReason::ForeignSource);
        }
        if header.source_epoch < gate.source_epoch {
            return Err(DropReason::OldEpoch);
        }
        if header.source_epoch > gate.source_epoch {
            (gate.source_epoch, gate.ordered, gate.renewed) = (header.source_epoch, false, true);
        }
        if gate.ordered && seq <= gate.seq {
            return Err(if seq == gate.seq {
                DropReason::Duplicate
            } else {
                DropReason::OutOfOrder
            });
        }
        (gate.seq, gate.ordered) = (seq, true);
        Ok(())
    }

    pub(crate) fn refuse(&mut self, header: &SampleHeader, sample: &Sample, reason: DropReason) {
        self.drops.add(reason, 1);
        self.refused.note(sample.robot, reason, header.pid);
        let (Some(invalid), Some(slot)) = (invalid(reason), self.find(sample.robot)) else {
            return;
        };
        // Nothing better will come of it in this tick: the others need not wait for it.
        let gate = self.hear(slot);
        gate.refused_run = gate.refused_run.saturating_add(1);
        gate.invalid = Some(invalid);
        self.columns.lasts[slot / LANES].refused[slot % LANES] += 1;
        let rules = self.rules();
        let kind = &self.kinds[usize::from(self.columns.gates[slot].platform)];
        let gate = &self.columns.gates[slot];
        let last = lanes::get(&self.columns.lasts, slot);
        let scored = lanes::get(&self.columns.scores, slot).count;
        let mut detector = lanes::get(&self.columns.detectors, slot);
        let facts = Facts::of(gate, &last);
        let conditions = judge(&rules, kind, &facts, scored, &detector);
        detector.decide(conditions, &self.settings.alarms);
        lanes::set(&mut self.columns.detectors, slot, detector);
    }

    /// Takes note that a sample of the robot has come in this tick.
    fn hear(&mut self, slot: usize) -> &mut Gate {
        let gate = &mut self.columns.gates[slot];
        self.reported += usize::from(!gate.heard);
        gate.heard = true;
        gate
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
            .gates
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
        let kind = self.platform_of(robot).ok_or(DropReason::UnknownRobot)?;
        let Columns { slots, gates, .. } = &mut self.columns;
        let slot = slots.take(kind, |slot| gates[slot].platform);
        let slot = slot.ok_or(DropReason::OverCapacity)?;
        self.slot_of.insert(robot, slot as u32);
        self.occupy(slot, robot, kind, header, now_ns);
        Ok(slot)
    }

    fn occupy(&mut self, slot: usize, id: u32, kind: u16, header: &SampleHeader, now_ns: u64) {
        let departed = self.departed.take(id);
        let columns = &mut self.columns;
        columns.gates[slot] = Gate {
            id,
            present: true,
            platform: kind,
            generation: columns.gates[slot].generation,
            source_id: header.source_id,
            source_epoch: header.source_epoch,
            taken_ns: now_ns,
            charged: departed.is_some_and(|departed| departed.charged),
            ..Gate::FREE
        };
        let kind = &self.kinds[usize::from(kind)];
        if let Some(blending) = &kind.blending {
            columns.blends[slot] = Blend::new(blending);
        }
        let residual = kind.model.residual();
        columns.news[slot / LANES].mark(slot % LANES, true, News::None);
        lanes::set(&mut columns.windows, slot, Window::EMPTY);
        lanes::set(&mut columns.lasts, slot, Last::NONE);
        let ledger = departed.map_or_else(Ledger::default, |departed| departed.ledger);
        let interval = Interval::new(
            residual.q05_w,
            residual.q95_w,
            kind.platform.power_resolution_w,
            self.settings.interval.coverage,
        );
        lanes::set(&mut columns.ledgers, slot, ledger);
        lanes::set(&mut columns.intervals, slot, interval);
        lanes::set(&mut columns.scores, slot, Scores::default());
        lanes::set(&mut columns.detectors, slot, Detector::new());
    }

    pub(crate) fn platform_of(&self, robot: u32) -> Option<u16> {
        let after = self.ranges.partition_point(|(start, _, _)| *start <= robot);
        let (_, end, kind) = self.ranges.get(after.checked_sub(1)?)?;
        (robot <= *end).then_some(*kind)
    }
}

/// Whether a stamp lies after the robot's last one, and not further than `longest_ns`.
fn in_time(gate: &Gate, stamp_ns: u64, longest_ns: u64) -> bool {
    !gate.accepted || (stamp_ns > gate.stamp_ns && stamp_ns - gate.stamp_ns <= longest_ns)
}
