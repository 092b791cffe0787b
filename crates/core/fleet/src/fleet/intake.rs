//! Ingest of samples: frames, the checks of each sample in their order, and refusals.

use std::sync::atomic::Ordering;

use joulebus_wire::{DropReason, SCHEMA_VERSION, Sample, SampleHeader, Statement, sample_flag};

use crate::alarms::conditions::{AlarmInputs, judge};
use crate::fleet::Fleet;
use crate::ingest::admission::AdmissionState;
use crate::ingest::check;
use crate::ingest::frame::FrameIntake;
use crate::ingest::pending::{Pending, PendingState};
use crate::layout::lanes::{self, Block as _, LANES};
use crate::ledger::battery::{At, BatteryState, Known, StatedBattery};
use crate::ledger::departed::Account;
use crate::ledger::energy::Ledger;

impl Fleet {
    /// Takes a frame of samples, in the order in which they were sent. `now_ns` is the worker's
    /// monotonic time. Refusals are counted and named, and affect no other robot.
    pub fn take(&mut self, header: &SampleHeader, samples: &[Sample], now_ns: u64) {
        let frame = self.begin_frame(header, samples.len() as u64, now_ns);
        self.take_part(&frame, samples);
    }

    /// True if the account of the frame's source contains the frame, which came at `now_ns`: it was
    /// taken, refused or counted as lost. Who continues from a [state](crate::FleetState) takes no
    /// frame twice.
    pub fn has_accounted(&self, header: &SampleHeader, now_ns: u64) -> bool {
        self.sources.has_accounted(header, now_ns)
    }

    /// Begins a frame of `count` samples that are [taken](Fleet::take_part) in parts, in their
    /// order, all before the next frame or tick. The same as [`Fleet::take`] of the whole frame.
    pub fn begin_frame(&mut self, header: &SampleHeader, count: u64, now_ns: u64) -> FrameIntake {
        self.intake.frames += 1;
        self.intake.first.get_or_insert((header.intended_ns, header.sent_ns, now_ns));
        let admitted = if header.schema == SCHEMA_VERSION {
            self.sources.frame(header, count, now_ns, &mut self.drops)
        } else {
            self.drops.add(DropReason::Schema, count);
            Err(DropReason::Schema)
        };
        FrameIntake { header: *header, now_ns, admitted }
    }

    /// The run `epoch` of a source has ended: it was dropped, or its process is dead. From now on
    /// other sources may publish for its robots. Does nothing if a later run of it has been seen.
    pub fn end_source(&mut self, source_id: u64, epoch: u64) {
        self.sources.end(source_id, epoch);
    }

    /// Takes the next samples of a frame.
    pub fn take_part(&mut self, frame: &FrameIntake, samples: &[Sample]) {
        let FrameIntake { header, now_ns, admitted } = frame;
        match admitted {
            Ok(()) => {
                for sample in samples {
                    match self.accept(header, sample, *now_ns) {
                        Ok(()) => self.accepted += 1,
                        Err(reason) => self.refuse((header, *now_ns), sample, reason),
                    }
                }
                self.oldest_ns.fetch_min(*now_ns, Ordering::Relaxed);
            }
            // Its contents are unreliable, including robot ids. It is only counted.
            Err(DropReason::Schema) => {}
            Err(reason) => {
                for sample in samples {
                    self.refuse((header, *now_ns), sample, *reason);
                }
            }
        }
    }

    /// Takes what a person states of a robot, at the worker's monotonic time `now_ns`.
    ///
    /// With a [new normal](Statement::NewNormal) alarms of its level end, and its power is compared
    /// with that from now on. That does nothing if the robot is not in the fleet, or its level is not
    /// judged. The state of a battery is that of the account, also of a robot that is not in the
    /// fleet: time before `now_ns` costs it nothing any more.
    ///
    /// Returns the battery of a robot that is not in the fleet, which has no budget to save.
    pub fn take_statement(
        &mut self,
        robot: u32,
        statement: Statement,
        now_ns: u64,
    ) -> Option<StatedBattery> {
        let slot = self.find(robot);
        if statement.is_of_battery() {
            return self.state_battery(robot, slot, statement, now_ns);
        }
        if let Some(slot) = slot
            && let Some(levels) = self.columns.levels.get_mut(slot / LANES)
        {
            levels.accept(slot % LANES);
        }
        None
    }

    fn state_battery(
        &mut self,
        robot: u32,
        slot: Option<usize>,
        statement: Statement,
        now_ns: u64,
    ) -> Option<StatedBattery> {
        let number = self.platform_of(robot)?;
        let platform = &self.tick.platforms[usize::from(number)].platform;
        let battery = platform.battery.as_ref()?;
        // What is silent beside a period will be unmetered, and lies before the statement.
        let at = |ledger: &Ledger| {
            let silent_ns = ledger.stamp_ns().map_or(0, |stamp_ns| now_ns.saturating_sub(stamp_ns));
            At::new(ledger).silent_for(silent_ns.saturating_sub(platform.period_ns))
        };
        if let Some(slot) = slot {
            let mut known = lanes::get(&self.columns.batteries, slot);
            let at = at(&lanes::get(&self.columns.ledgers, slot));
            known.state((battery, platform), at, statement);
            lanes::set(&mut self.columns.batteries, slot, known);
            return None;
        }
        let is_new = self.departed.ledger(robot).is_none();
        // It takes no place that a robot of the fleet will need when it leaves.
        if is_new && !self.departed.has_room_for(self.len()) {
            return None;
        }
        let account = self.departed.take(robot).unwrap_or(Account::new(robot));
        let used = account.charged || (is_new && self.departed.is_lost(robot));
        let mut known = BatteryState::joining(battery, account.battery, used, &account.ledger);
        known.state((battery, platform), at(&account.ledger), statement);
        let stamp_ns = account.ledger.stamp_ns().unwrap_or(0);
        self.departed.keep(Account { battery: Known::Kept(known), ..account });
        Some(StatedBattery { robot, stamp_ns, battery: known.saved(battery) })
    }

    fn accept(
        &mut self,
        header: &SampleHeader,
        sample: &Sample,
        now_ns: u64,
    ) -> Result<(), DropReason> {
        let slot = self.slot(header, sample.robot, now_ns)?;
        let sources = &self.sources;
        let admission = &mut self.columns.admissions[slot];
        check::sender(admission, header, sample.seq, |owner| sources.has_ended(owner))?;
        let most = self.tick.settings.intake.max_samples_per_tick;
        check::backlog(&self.columns.admissions[slot], most)?;
        if !self.columns.pending[slot / LANES].is(slot % LANES, PendingState::None) {
            self.catch_up(slot);
        }
        let admission = &self.columns.admissions[slot];
        let context = &self.tick.platforms[usize::from(admission.platform)];
        context.platform.admit(sample)?;
        let max_jump_ns = self.tick.settings.intake.max_jump_ns;
        let broken = check::time(admission, sample.stamp_ns, max_jump_ns)?;
        if let Some(battery) = &context.platform.battery {
            self.columns.batteries[slot / LANES].note(slot % LANES, sample, battery);
        }
        let admission = self.mark_reported(slot);
        admission.taken += 1;
        admission.renewed = false;
        admission.implausible = sample.has(sample_flag::IMPLAUSIBLE);
        (admission.taken_ns, admission.invalid, admission.refused_run) = (now_ns, None, 0);
        let (block, lane) = (&mut self.columns.pending[slot / LANES], slot % LANES);
        let pending = Pending::new(sample, broken);
        block.samples.set(lane, true, pending);
        block.mark(lane, true, PendingState::Waiting);
        Ok(())
    }

    fn refuse(
        &mut self,
        (header, now_ns): (&SampleHeader, u64),
        sample: &Sample,
        reason: DropReason,
    ) {
        self.drops.add(reason, 1);
        self.refused.note(sample.robot, reason, header.process());
        let invalid = check::invalid(reason);
        self.refusal_log.note(header, sample, (reason, invalid.is_some()), now_ns);
        let (Some(invalid), Some(slot)) = (invalid, self.find(sample.robot)) else {
            return;
        };
        // The robot will not send another sample in this tick: the others need not wait for it.
        let admission = self.mark_reported(slot);
        admission.refused_run = admission.refused_run.saturating_add(1);
        admission.invalid = Some(invalid);
        self.columns.lasts[slot / LANES].refused[slot % LANES] += 1;
        let admission = &self.columns.admissions[slot];
        let context = &self.tick.platforms[usize::from(admission.platform)];
        let last = lanes::get(&self.columns.lasts, slot);
        let scored = lanes::get(&self.columns.scores, slot).count;
        let mut detector = lanes::get(&self.columns.detectors, slot);
        let inputs = AlarmInputs::new(admission, &last);
        let (alarms, missed) = (&context.alarms, self.tick.deadline_missed);
        let platform = &context.platform;
        let conditions = judge(alarms, platform, &inputs, scored, &detector, missed);
        detector.decide(conditions, alarms);
        lanes::set(&mut self.columns.detectors, slot, detector);
    }

    /// Marks the robot as having reported in this tick.
    fn mark_reported(&mut self, slot: usize) -> &mut AdmissionState {
        let admission = &mut self.columns.admissions[slot];
        self.reported += usize::from(!admission.reported);
        admission.reported = true;
        admission
    }

    /// The robot's slot. A new robot gets one.
    fn slot(
        &mut self,
        header: &SampleHeader,
        robot: u32,
        now_ns: u64,
    ) -> Result<usize, DropReason> {
        let likely = self
            .columns
            .admissions
            .get(self.likely_slot)
            .filter(|admission| admission.present && admission.id == robot);
        let found = match likely {
            Some(_) => Some(self.likely_slot),
            None => self.find(robot),
        };
        if let Some(slot) = found {
            self.likely_slot = slot + 1;
            return Ok(slot);
        }
        let platform = self.platform_of(robot).ok_or(DropReason::UnknownRobot)?;
        let admissions = &self.columns.admissions;
        let slot = self.slots.take(platform, |slot| admissions[slot].platform);
        let slot = slot.ok_or(DropReason::OverCapacity)?;
        self.slot_of.insert(robot, slot as u32);
        self.occupy(slot, robot, platform, header, now_ns);
        Ok(slot)
    }
}
