//! Processes start, end, and are killed.

use std::panic::{AssertUnwindSafe, catch_unwind};

use simulated_bus as bus;
use simulated_host::{self as host, disk, memory, time};

use super::state::{PIDS, SECOND, World};
use crate::check::{Checked, Ending, failure};
use crate::ledger::newest_whole;
use crate::process::{
    self, BridgeProgram, ClientProgram, DisplayProgram, Finished, POLL_INTERVAL_NS, PlannerProgram,
    Program, SourceProgram,
};
use crate::scenario::Role;

impl World<'_> {
    pub(super) fn start(&mut self, place: usize) -> Checked {
        let pid = self.pid(self.slots[place].last_pid);
        let config = &self.config;
        let setup = &self.scenario.setup;
        let slot = &mut self.slots[place];
        (slot.pid, slot.last_pid) = (pid, pid);
        slot.cost_ns = host::USUAL_COST_NS;
        (slot.follows, slot.watched, slot.shown) = (None, None, None);
        (slot.learn_until_ns, slot.is_warned) = (u64::MAX, false);
        host::begin_life(pid);
        if slot.blind_until_ns > time::now_ns() {
            host::take_descriptors(pid, true);
        }
        slot.is_killed_at_disk();
        if slot.role == Some(Role::Worker) {
            self.checker.worker_begins(pid);
            self.answered = 0;
        }
        self.outcome.processes += 1;
        self.names += 1;
        let number = self.names;
        host::enter(pid, slot.cost_ns);
        let opened = catch_unwind(AssertUnwindSafe(|| match slot.role {
            Some(Role::Worker) => process::worker(config).map_err(|error| slot.last = error).ok(),
            Some(Role::Planner(number)) => PlannerProgram::open(config, setup, number)
                .map(|planner| Program::Planner(Box::new(planner))),
            Some(Role::Client(_)) => {
                ClientProgram::open(config, setup).map(|client| Program::Client(Box::new(client)))
            }
            Some(Role::Recorder) => process::recorder(config, format!("/sim/captures/{number}-")),
            Some(Role::Display(number)) => DisplayProgram::open(config, number)
                .map(|display| Program::Display(Box::new(display))),
            Some(Role::Bridge) => {
                BridgeProgram::open(config, &slot.name, slot.robots.clone(), setup)
                    .map(|bridge| Program::Bridge(Box::new(bridge)))
            }
            Some(Role::Source(_)) | None => {
                SourceProgram::open(config, &slot.name, slot.robots.clone(), setup)
                    .map(|source| Program::Source(Box::new(source)))
            }
        }));
        let _ = host::leave();
        slot.opened_bytes = memory::live(pid);
        slot.program = match opened {
            Ok(program) => program,
            Err(panic) => match process::cause(panic) {
                Ok(_) => None,
                Err(text) => return Err(failure("nothing panics", text)),
            },
        };
        slot.wake_ns = time::now_ns();
        if slot.program.is_none() {
            if slot.role == Some(Role::Worker) {
                self.checker.observe()?;
            }
            let path = format!("/sim/captures/{number}-");
            self.gone(place, Ending::Killed)?;
            return self.checker.capture(&path, None);
        }
        if self.slots[place].role == Some(Role::Worker) {
            self.checker.observe()?;
        }
        match std::mem::take(&mut self.slots[place].greeting) {
            0 => {}
            frames => self.attack(frames),
        }
        Ok(())
    }

    /// A free pid. In a container a process often has the pid of the one before: `last`.
    fn pid(&mut self, last: u32) -> u32 {
        if host::once_in(3) && last != 0 && host::life(last).is_none() {
            return last;
        }
        loop {
            let pid = self.next_pid;
            self.next_pid = if pid + 1 == PIDS.end { PIDS.start } else { pid + 1 };
            if host::life(pid).is_none() {
                return pid;
            }
        }
    }

    /// A process was killed: what it had in memory is gone, and its destructors do nothing.
    pub(super) fn dies(&mut self, place: usize) -> Checked {
        if self.slots[place].program.is_none() {
            return Ok(());
        }
        if self.slots[place].role == Some(Role::Worker) {
            // Its earlier frames are out.
            self.checker.observe()?;
        }
        let slot = &mut self.slots[place];
        let pid = slot.pid;
        host::bury(pid);
        let program = slot.program.take();
        let capture = match &program {
            Some(Program::Recorder(_, path)) => Some(path.clone()),
            _ => None,
        };
        host::remove_threads(pid);
        drop(program);
        let _ = host::leave();
        self.gone(place, Ending::Killed)?;
        match capture {
            Some(path) => self.checker.capture(&path, None),
            None => Ok(()),
        }
    }

    /// A process ends in order.
    pub(super) fn ends(&mut self, place: usize) -> Checked {
        let slot = &mut self.slots[place];
        let Some(program) = slot.program.take() else {
            return Ok(());
        };
        let capture = match &program {
            Program::Recorder(_, path) => Some(path.clone()),
            _ => None,
        };
        host::enter(slot.pid, slot.cost_ns);
        let finished = catch_unwind(AssertUnwindSafe(|| program.finish()));
        let _ = host::leave();
        let pid = slot.pid;
        let is_worker = slot.role == Some(Role::Worker);
        let mut ending = Ending::InOrder;
        let finished = match finished.map_err(process::cause) {
            Ok(finished) => finished,
            Err(Ok(_)) => {
                ending = Ending::Between;
                if is_worker {
                    self.checker.observe()?;
                }
                host::bury(pid);
                host::remove_threads(pid);
                let _ = host::leave();
                Finished::Nothing
            }
            Err(Err(text)) => return Err(failure("nothing panics", text)),
        };
        if is_worker {
            self.checker.observe()?;
        }
        self.deliver();
        self.gone(place, ending)?;
        let recorded = match finished {
            Finished::Answered(report) if report.answered < self.answered => {
                let found = format!("{} were answered, {} counted", self.answered, report.answered);
                return Err(failure("answers are counted", found));
            }
            Finished::Recorded(summary) => Some(summary),
            _ => None,
        };
        match capture {
            Some(path) => self.checker.capture(&path, recorded.as_deref()),
            None => Ok(()),
        }
    }

    /// The process of a place is gone; it is started again.
    pub(super) fn gone(&mut self, place: usize, ending: Ending) -> Checked {
        let now_ns = time::now_ns();
        let slot = &mut self.slots[place];
        let (ports, thread) = (bus::ports_of(slot.pid), host::next_thread(slot.pid));
        if ports > 0 || thread.is_some() {
            let found = format!("{}: {ports} ports, thread {thread:?}", slot.name);
            return Err(failure("an end leaves no port and no thread", found));
        }
        bus::remove_process(slot.pid);
        host::end_life(slot.pid);
        slot.pid = 0;
        slot.program = None;
        slot.paused_until_ns = 0;
        slot.start_ns = now_ns + SECOND / 10 + host::below(2_000) as u64 * 1_000_000;
        if slot.role.is_none() {
            slot.start_ns = u64::MAX;
        }
        self.power_loss_ns = self.power_loss_ns.max(std::mem::take(&mut slot.power_loss_ns));
        if slot.role != Some(Role::Worker) {
            return Ok(());
        }
        self.worker_ended_ns = now_ns;
        if let Some(run) = self.checker.worker_ends(ending) {
            self.planners_must_learn(run);
        }
        self.ledger_is_kept(newest_whole(disk::peek))
    }

    /// The newest ledger that was whole when a worker ended, or a newer one, is `found`.
    pub(super) fn ledger_is_kept(&mut self, found: u64) -> Checked {
        let before = std::mem::replace(&mut self.saved, found);
        if found >= before {
            return Ok(());
        }
        let found = format!("generation {before} was on the disk, the newest whole one is {found}");
        Err(failure("the newest saved ledger is kept", found))
    }

    /// Each planner that runs and has frames of the worker's run `ended` must learn of its end.
    fn planners_must_learn(&mut self, ended: u64) {
        let now_ns = time::now_ns();
        let period_ns = self.scenario.setup.period_ns;
        for slot in &mut self.slots {
            let is_planner = matches!(slot.program, Some(Program::Planner(_)));
            let is_hindered = slot.paused_until_ns > now_ns || slot.slow_until_ns > now_ns;
            if is_planner
                && !is_hindered
                && !slot.is_warned
                && slot.follows.is_some_and(|(_, run, _)| run == ended)
            {
                slot.learn_until_ns = now_ns + 3 * period_ns + 4 * POLL_INTERVAL_NS;
                slot.wake_ns = slot.wake_ns.min(now_ns + 50_000);
            }
        }
    }

    pub(super) fn bury_all(mut self) {
        for slot in &mut self.slots {
            host::bury(slot.pid);
            let program = slot.program.take();
            host::remove_threads(slot.pid);
            drop(program);
        }
        let _ = host::leave();
    }
}
