//! Faults happen.

use simulated_bus as bus;
use simulated_host::{self as host, disk, time};

use super::state::{FOREIGN, World};
use crate::check::{Checked, Ending};
use crate::hostile;
use crate::ledger::{damage, newest_whole};
use crate::process::Program;
use crate::scenario::{Fault, Role};

impl World<'_> {
    /// A process of the user sends `frames` false frames on each service.
    pub(super) fn attack(&mut self, frames: u64) {
        self.checker.is_irregular(time::now_ns());
        let robots = hostile::OWN_ROBOTS.map(|robot| robot as u32);
        self.checker.strangers.extend(robots);
        hostile::attack(&self.config, frames, self.scenario.setup.regular());
        self.deliver();
    }

    pub(super) fn happens(&mut self, fault: Fault) -> Checked {
        let now_ns = time::now_ns();
        let (period_ns, every_ns) =
            (self.scenario.setup.period_ns, self.scenario.setup.save_every_ns);
        match fault {
            Fault::Kill(role, operations) => {
                let pid = self.slots[self.slot(role)].pid;
                host::kill_in(pid, operations);
            }
            Fault::KillAtDisk(role, accesses, of_next) => {
                let place = self.slot(role);
                let slot = &mut self.slots[place];
                slot.kills_at_disk.extend([accesses, of_next]);
                slot.is_killed_at_disk();
            }
            Fault::PowerLossAtDisk(role, accesses, for_ns) => {
                let place = self.slot(role);
                let slot = &mut self.slots[place];
                slot.kills_at_disk.push_front(accesses);
                slot.power_loss_ns = for_ns;
                slot.is_killed_at_disk();
            }
            Fault::End(role) => return self.ends(self.slot(role)),
            Fault::Pause(role, for_ns) => {
                let place = self.slot(role);
                let slot = &mut self.slots[place];
                slot.paused_until_ns = slot.paused_until_ns.max(now_ns + for_ns);
                slot.learn_until_ns = u64::MAX;
                if role == Role::Worker {
                    self.checker.excuse(now_ns + for_ns);
                }
            }
            Fault::Slow(role, cost_ns, for_ns) => {
                let place = self.slot(role);
                let slot = &mut self.slots[place];
                (slot.cost_ns, slot.slow_until_ns) = (cost_ns, now_ns + for_ns);
                slot.learn_until_ns = u64::MAX;
                // Time passes for all while it works: the processor is one.
                self.checker.excuse(now_ns + 2 * for_ns);
            }
            Fault::WallClock(step_ns) => time::set_wall_clock(step_ns),
            Fault::Drift(ppm) => time::drift(ppm),
            Fault::Suspend(for_ns) => time::suspend(for_ns),
            Fault::Jump(for_ns) => {
                for slot in &mut self.slots {
                    slot.paused_until_ns = slot.paused_until_ns.max(now_ns + for_ns);
                    slot.learn_until_ns = u64::MAX;
                }
                self.checker.excuse(now_ns + for_ns);
            }
            Fault::Disk(fault, for_ns) => {
                disk::fail(fault);
                self.disk_until_ns = now_ns + for_ns;
                self.checker.excuse(now_ns + for_ns);
            }
            Fault::MemoryFull(for_ns) => {
                host::fill_memory(true);
                self.memory_until_ns = now_ns + for_ns;
            }
            Fault::NoDescriptors(role, for_ns) => {
                let place = self.slot(role);
                let slot = &mut self.slots[place];
                slot.blind_until_ns = now_ns + for_ns;
                host::take_descriptors(slot.pid, true);
                if role == Role::Worker {
                    self.checker.excuse(now_ns + for_ns);
                }
            }
            Fault::FilesRemoved => {
                bus::remove_files();
                self.checker.join();
            }
            Fault::DamagedLedger(bits) => {
                let worker = self.slot(Role::Worker);
                self.dies(worker)?;
                self.checker.excuse(now_ns + every_ns);
                damage(bits);
                self.saved = newest_whole(disk::peek);
            }
            Fault::Flood(source, frames) => {
                let place = self.slot(Role::Source(source));
                if let Some(Program::Source(source)) = &mut self.slots[place].program {
                    source.flood = frames;
                }
            }
            Fault::Hostile(frames) => self.attack(frames),
            Fault::HostileAtStart(role, frames) => {
                let place = self.slot(role);
                self.slots[place].greeting = frames;
                return self.ends(place);
            }
            Fault::Forged(source, frames) => {
                let slot = &self.slots[self.slot(Role::Source(source))];
                let (name, robots) = (slot.name.clone(), slot.robots.clone());
                if let Some(header) = self.checker.newest_of(&name) {
                    self.checker.is_irregular(now_ns);
                    hostile::forge(&self.config, frames, &header, &robots);
                    self.deliver();
                }
            }
            Fault::Questions(count) => hostile::ask(&self.config, count),
            Fault::Newcomers(count) => {
                self.checker.is_irregular(now_ns + (count + 8) * period_ns);
                for number in 0..count {
                    self.names += 1;
                    let robot = 1_000 + (self.names % 100_000) as u32;
                    self.checker.strangers.insert(robot);
                    let start_ns = now_ns + number * period_ns / 2;
                    let name = format!("newcomer-{}", self.names);
                    self.visitor(name, vec![robot], start_ns, start_ns + 4 * period_ns);
                }
            }
            Fault::Rival(source, periods) => {
                let robots = self.slots[self.slot(Role::Source(source))].robots.clone();
                self.names += 1;
                let name = format!("rival-{}", self.names % 7);
                self.checker.is_irregular(now_ns + (periods + 1) * period_ns);
                self.visitor(name, robots, now_ns, now_ns + periods * period_ns);
            }
            Fault::Namesake(source, periods) => {
                let slot = &self.slots[self.slot(Role::Source(source))];
                let (name, robots) = (slot.name.clone(), slot.robots.clone());
                self.checker.is_irregular(now_ns + (periods + 1) * period_ns);
                self.visitor(name, robots, now_ns, now_ns + periods * period_ns);
            }
            Fault::PowerLoss(for_ns) => return self.power_loss(for_ns),
        }
        Ok(())
    }

    /// All processes end at once, and the machine starts again.
    pub(super) fn power_loss(&mut self, for_ns: u64) -> Checked {
        for place in 0..self.slots.len() {
            if self.slots[place].role == Some(Role::Worker) {
                self.checker.observe()?;
            }
            let slot = &mut self.slots[place];
            host::bury(slot.pid);
            let program = slot.program.take();
            host::remove_threads(slot.pid);
            drop(program);
            let _ = host::leave();
            if slot.pid != 0 {
                self.gone(place, Ending::Killed)?;
            }
        }
        self.slots.retain(|slot| slot.role.is_some());
        self.power_loss_ns = 0;
        self.saved = newest_whole(disk::peek_durable);
        disk::lose_power();
        self.ledger_is_kept(newest_whole(disk::peek))?;
        bus::begin();
        time::pass(for_ns);
        time::boot();
        self.checker.reboots();
        self.checker.join();
        for slot in &mut self.slots {
            slot.start_ns = slot.start_ns.max(time::now_ns());
            slot.learn_until_ns = u64::MAX;
        }
        // Captures may be damaged after a power failure, and are not read here.
        for name in disk::names() {
            let text = name.to_string_lossy();
            if text.starts_with("/sim/captures/") && !FOREIGN.contains(&&*text) {
                disk::take_away(&name);
            }
        }
        Ok(())
    }
}
