//! How a sample gets in: its robot's slot, who may speak for the robot, and what is refused.

use joulebus_wire::{DropReason, Sample, SampleHeader, sample_flag};

use crate::detector::Detector;
use crate::intake::{check_values, invalid};
use crate::interval::Interval;
use crate::robot::{Last, Pending, Robot};
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
        let robot = &self.robots[slot];
        if robot.taken >= most {
            return Err(DropReason::Backlog);
        }
        let kind = usize::from(robot.platform);
        if robot.waiting {
            self.pass(kind);
        }
        check_values(sample, &self.kinds[kind].platform)?;
        let mut sample = *sample;
        if !self.in_time(slot, sample.stamp_ns) {
            if !self.robots[slot].renewed {
                return Err(DropReason::BadTime);
            }
            sample.flags |= sample_flag::DISCONTINUITY;
        }
        let robot = self.hear(slot);
        robot.taken += 1;
        (robot.renewed, robot.waiting) = (false, true);
        (robot.taken_ns, robot.invalid, robot.refused_run) = (now_ns, None, 0);
        self.pending[slot] = Pending::new(&sample);
        self.kinds[kind].waiting.push(slot as u32);
        Ok(())
    }

    /// Ownership, run and order: who may speak for the robot, once.
    fn identify(&mut self, slot: usize, header: &SampleHeader, seq: u64) -> Result<(), DropReason> {
        let robot = &mut self.robots[slot];
        if robot.source_id != header.source_id {
            return Err(DropReason::ForeignSource);
        }
        if header.source_epoch < robot.source_epoch {
            return Err(DropReason::OldEpoch);
        }
        if header.source_epoch > robot.source_epoch {
            (robot.source_epoch, robot.seq) = (header.source_epoch, None);
            robot.renewed = true;
        }
        match robot.seq {
            Some(last) if seq == last => return Err(DropReason::Duplicate),
            Some(last) if seq < last => return Err(DropReason::OutOfOrder),
            _ => robot.seq = Some(seq),
        }
        Ok(())
    }

    fn in_time(&self, slot: usize, stamp_ns: u64) -> bool {
        let last = &self.robots[slot].last;
        let longest = self.settings.intake.max_jump_ns;
        !last.accepted || (stamp_ns > last.stamp_ns && stamp_ns - last.stamp_ns <= longest)
    }

    pub(crate) fn refuse(&mut self, header: &SampleHeader, sample: &Sample, reason: DropReason) {
        self.drops.add(reason, 1);
        self.refused.note(sample.robot, reason, header.pid);
        let (Some(invalid), Some(slot)) = (invalid(reason), self.slot_of.get(&sample.robot)) else {
            return;
        };
        let slot = *slot as usize;
        // Nothing better will come of it in this tick: the others need not wait for it.
        let robot = self.hear(slot);
        robot.refused += 1;
        robot.refused_run = robot.refused_run.saturating_add(1);
        robot.invalid = Some(invalid);
        self.judge(slot);
    }

    /// Takes note that a sample of the robot has come in this tick.
    fn hear(&mut self, slot: usize) -> &mut Robot {
        let robot = &mut self.robots[slot];
        self.reported += usize::from(!robot.heard);
        robot.heard = true;
        robot
    }

    /// The robot's slot; a robot heard of for the first time is given one.
    fn slot(
        &mut self,
        header: &SampleHeader,
        robot: u32,
        now_ns: u64,
    ) -> Result<usize, DropReason> {
        let guessed = self
            .robots
            .get(self.guess)
            .filter(|guess| guess.present && guess.id == robot);
        let found = match guessed {
            Some(_) => Some(self.guess),
            None => self.slot_of.get(&robot).map(|slot| *slot as usize),
        };
        if let Some(slot) = found {
            self.guess = slot + 1;
            return Ok(slot);
        }
        let kind = self.platform_of(robot).ok_or(DropReason::UnknownRobot)?;
        let slot = self.free.pop().ok_or(DropReason::OverCapacity)?;
        self.slot_of.insert(robot, slot);
        self.live.push(slot);
        let slot = slot as usize;
        self.used = self.used.max(slot + 1);
        self.occupy(slot, robot, kind, header, now_ns);
        Ok(slot)
    }

    fn occupy(&mut self, slot: usize, id: u32, kind: u16, header: &SampleHeader, now_ns: u64) {
        let departed = self.departed.take(id);
        self.robots[slot] = Robot {
            id,
            present: true,
            platform: kind,
            generation: self.robots[slot].generation,
            source_id: header.source_id,
            source_epoch: header.source_epoch,
            renewed: false,
            waiting: false,
            seq: None,
            taken_ns: now_ns,
            taken: 0,
            heard: false,
            refused: 0,
            refused_run: 0,
            invalid: None,
            last: Last {
                charged: departed.is_some_and(|departed| departed.charged),
                ..Last::NONE
            },
        };
        let kind = &self.kinds[usize::from(kind)];
        let residual = kind.model.residual();
        self.windows[slot] = Window::EMPTY;
        self.ledgers[slot] = departed.map_or_else(Ledger::default, |departed| departed.ledger);
        self.intervals[slot] = Interval::new(
            residual.q05_w,
            residual.q95_w,
            residual.std_w,
            kind.platform.power_resolution_w,
            self.settings.interval.coverage,
        );
        self.scores[slot] = Scores::default();
        self.detectors[slot] = Detector::new();
    }

    pub(crate) fn platform_of(&self, robot: u32) -> Option<u16> {
        let after = self.ranges.partition_point(|(start, _, _)| *start <= robot);
        let (_, end, kind) = self.ranges.get(after.checked_sub(1)?)?;
        (robot <= *end).then_some(*kind)
    }
}
