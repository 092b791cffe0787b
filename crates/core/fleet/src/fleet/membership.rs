//! Membership: robots join with their first sample and leave after a long silence.

use joulebus_energy::{EnergyState, ErrorCounts};
use joulebus_wire::SampleHeader;

use crate::alarms::detector::Detector;
use crate::alarms::level::Level;
use crate::estimate::interval::ConformalInterval;
use crate::estimate::online::Online;
use crate::estimate::scores::Scores;
use crate::estimate::window::Window;
use crate::fleet::Fleet;
use crate::ingest::admission::AdmissionState;
use crate::ingest::last_sample::Last;
use crate::ingest::pending::PendingState;
use crate::layout::lanes::{self, LANES};
use crate::ledger::battery::{BatteryState, Known, SavedBattery};
use crate::ledger::departed;
use crate::ledger::energy::Ledger;

impl Fleet {
    /// Continues with the account of a robot that an earlier run saved. Call it before the robot's
    /// first sample.
    ///
    /// `charged` states that the robot has been on its charger since. `battery` is the saved state
    /// of its battery, `None` if it was not saved. As many accounts as the capacity are kept, of
    /// robots that are not in the fleet. The oldest is given up for another. Returns whether none
    /// was.
    pub fn restore(
        &mut self,
        robot: u32,
        ledger: Ledger,
        charged: bool,
        battery: Option<SavedBattery>,
    ) -> bool {
        self.departed.keep(departed::Account {
            robot,
            charged,
            ledger,
            battery: battery.map_or(Known::Nothing, Known::saved),
        })
    }

    /// An earlier run gave up the accounts of robots whose ids end with these 16 bits. The battery
    /// of such a robot is unknown when it joins without an account.
    pub fn lose(&mut self, ids: u16) {
        self.departed.lose(ids);
    }

    /// The errors of the energy that each platform's robots have shown, with the hash of the model
    /// that made them, in the order of the settings.
    pub fn remembered_errors(&self) -> impl Iterator<Item = (u64, &ErrorCounts<f32>)> {
        self.tick.platforms.iter().map(|context| (context.model.hash(), context.errors.seen()))
    }

    /// Continues with the errors that an earlier run saved of the platform at `index`. Call it
    /// before the first sample. Returns whether they are of its model, and possible.
    pub fn restore_errors(&mut self, index: usize, model: u64, seen: &ErrorCounts<f32>) -> bool {
        let context = self.tick.platforms.get_mut(index);
        let context = context.filter(|context| context.model.hash() == model);
        context.is_some_and(|context| context.errors.remember(seen))
    }

    /// True if a platform of the config has this robot.
    #[must_use]
    pub fn is_configured(&self, robot: u32) -> bool {
        self.platform_of(robot).is_some()
    }

    /// The slot of a robot in the fleet.
    pub(super) fn find(&self, robot: u32) -> Option<usize> {
        let found = self.slot_of.find(robot, |slot| self.columns.admissions[slot as usize].id);
        found.map(|slot| slot as usize)
    }

    pub(super) fn occupy(
        &mut self,
        slot: usize,
        id: u32,
        platform: u16,
        header: &SampleHeader,
        now_ns: u64,
    ) {
        let departed = self.departed.take(id);
        let columns = &mut self.columns;
        columns.admissions[slot] = AdmissionState {
            id,
            present: true,
            platform,
            generation: columns.admissions[slot].generation,
            source_id: header.source_id,
            source_epoch: header.source_epoch,
            taken_ns: now_ns,
            charged: departed.is_some_and(|departed| departed.charged),
            ..AdmissionState::FREE
        };
        let context = &self.tick.platforms[usize::from(platform)];
        if let Some(members) = &context.members {
            let from_last = context.errors.platform().memory.starts_from_last();
            lanes::set(&mut columns.online, slot, Online::new(members, from_last));
        }
        let residual = context.model.residual();
        columns.pending[slot / LANES].mark(slot % LANES, true, PendingState::None);
        lanes::set(&mut columns.windows, slot, Window::EMPTY);
        lanes::set(&mut columns.lasts, slot, Last::NONE);
        let ledger = departed.map_or_else(Ledger::default, |departed| departed.ledger);
        if let Some(battery) = &context.platform.battery {
            let known = departed.map_or(Known::Nothing, |departed| departed.battery);
            let lost = departed.is_none() && self.departed.is_lost(id);
            let used = lost || columns.admissions[slot].charged;
            let joining = BatteryState::joining(battery, known, used, &ledger);
            // The mean goes on: the robot is the same, and its next gaps are valued by it.
            let last = Last { mean_power_w: joining.mean_w, ..Last::NONE };
            lanes::set(&mut columns.lasts, slot, last);
            lanes::set(&mut columns.batteries, slot, joining);
        }
        let interval = ConformalInterval::new(
            residual.q05_w,
            residual.q95_w,
            context.platform.power_resolution_w,
            self.tick.settings.interval.coverage,
        );
        lanes::set(&mut columns.ledgers, slot, ledger);
        lanes::set(&mut columns.intervals, slot, interval);
        lanes::set(&mut columns.scores, slot, Scores::default());
        lanes::set(&mut columns.detectors, slot, Detector::NONE);
        let rules = context.levels.among(&context.errors.platform().memory);
        lanes::set(&mut columns.levels, slot, Level::new(&rules));
        lanes::set(&mut columns.energy, slot, EnergyState::among(id, context.errors.platform()));
    }

    pub(super) fn platform_of(&self, robot: u32) -> Option<u16> {
        let after = self.ranges.partition_point(|(start, _, _)| *start <= robot);
        let (_, end, platform) = self.ranges.get(after.checked_sub(1)?)?;
        (robot <= *end).then_some(*platform)
    }

    /// Frees the slots of robots that have been silent for too long. Accounts that have begun are
    /// kept.
    pub(super) fn release_departed(&mut self) {
        let leave_after_ns = self.tick.settings.intake.leave_after_ns;
        for slot in 0..self.columns.admissions.len() {
            let admission = &self.columns.admissions[slot];
            let silent_ns = self.tick.now_ns.saturating_sub(admission.taken_ns);
            if !admission.present || silent_ns <= leave_after_ns {
                continue;
            }
            self.catch_up(slot);
            let admission = &mut self.columns.admissions[slot];
            admission.present = false;
            admission.generation = admission.generation.wrapping_add(1);
            let (robot, charged, platform) = (admission.id, admission.charged, admission.platform);
            let admissions = &self.columns.admissions;
            self.slot_of.remove(robot, |slot| admissions[slot as usize].id);
            self.slots.free(slot);
            let ledger = lanes::get(&self.columns.ledgers, slot);
            if ledger.stamp_ns().is_none() {
                // No sample of it was ever accepted: there is no account to keep in place of
                // another's.
                continue;
            }
            let platform = &self.tick.platforms[usize::from(platform)].platform;
            let battery = platform
                .battery
                .map_or(Known::Nothing, |_| Known::Kept(lanes::get(&self.columns.batteries, slot)));
            self.departed.keep(departed::Account { robot, charged, ledger, battery });
        }
    }
}
