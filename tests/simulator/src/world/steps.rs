//! Time passes: the next process or thread makes a step.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::Ordering;

use simulated_host::{self as host, disk, memory, time};

use super::state::{SECOND, World};
use crate::check::{Checked, failure};
use crate::grown;
use crate::process::{self, Learned, Outcome, Shown, Stepped};
use crate::scenario::Role;

impl World<'_> {
    /// Lets the fleet run until `until_ns` (simulated).
    pub(super) fn run_until(&mut self, until_ns: u64) -> Checked {
        loop {
            if self.stop.load(Ordering::Relaxed) {
                self.outcome.is_stopped = true;
                return Err(failure("it runs to its end", "it was stopped".to_owned()));
            }
            if self.power_loss_ns > 0 {
                let for_ns = std::mem::take(&mut self.power_loss_ns);
                self.power_loss(for_ns)?;
            }
            let due = (0..self.slots.len()).map(|slot| (self.due_ns(slot), slot)).min();
            match due {
                Some((at_ns, slot)) if at_ns <= until_ns => {
                    time::pass_until(at_ns);
                    self.end_windows();
                    self.advance(slot)?;
                }
                _ => {
                    time::pass_until(until_ns);
                    self.end_windows();
                    return Ok(());
                }
            }
        }
    }

    /// Ends faults that last for a time.
    fn end_windows(&mut self) {
        let now_ns = time::now_ns();
        if self.disk_until_ns != 0 && now_ns >= self.disk_until_ns {
            self.disk_until_ns = 0;
            disk::fail(disk::Fault::None);
        }
        if self.memory_until_ns != 0 && now_ns >= self.memory_until_ns {
            self.memory_until_ns = 0;
            host::fill_memory(false);
        }
    }

    fn due_ns(&self, slot: usize) -> u64 {
        let slot = &self.slots[slot];
        if slot.program.is_none() {
            return slot.start_ns;
        }
        let thread_ns = host::next_thread(slot.pid).map_or(u64::MAX, |(_, due_ns)| due_ns);
        slot.wake_ns.min(thread_ns).min(slot.until_ns).max(slot.paused_until_ns)
    }

    fn advance(&mut self, place: usize) -> Checked {
        let now_ns = time::now_ns();
        let slot = &mut self.slots[place];
        if slot.program.is_none() {
            return self.start(place);
        }
        if now_ns >= slot.until_ns {
            self.ends(place)?;
            self.slots.remove(place);
            return Ok(());
        }
        if now_ns >= slot.slow_until_ns {
            slot.cost_ns = host::USUAL_COST_NS;
        }
        if slot.blind_until_ns != 0 && now_ns >= slot.blind_until_ns {
            slot.blind_until_ns = 0;
            host::take_descriptors(slot.pid, false);
        }
        let thread = host::next_thread(slot.pid).filter(|(_, due_ns)| *due_ns <= slot.wake_ns);
        self.step(place, thread.map(|(number, _)| number))
    }

    /// One step of a process: of its main loop, or of a thread.
    fn step(&mut self, place: usize, thread: Option<u64>) -> Checked {
        let slot = &mut self.slots[place];
        let Some(mut program) = slot.program.take() else {
            return Ok(());
        };
        host::enter(slot.pid, slot.cost_ns);
        let stepped = catch_unwind(AssertUnwindSafe(|| match thread {
            Some(number) => {
                host::run_thread(number);
                None
            }
            None => Some(program.step()),
        }));
        let deadline_ns = host::leave();
        slot.program = Some(program);
        let is_worker = slot.role == Some(Role::Worker);
        match stepped {
            Ok(None) => {}
            Ok(Some(Stepped::On(wake_ns))) => {
                slot.wake_ns = deadline_ns.map_or(wake_ns, time::simulated_ns);
            }
            Ok(Some(Stepped::Learned(wake_ns, learned))) => {
                slot.wake_ns = wake_ns;
                self.learns(place, &learned)?;
            }
            Ok(Some(Stepped::Shown(wake_ns, shown))) => {
                slot.wake_ns = wake_ns;
                self.shows(place, &shown)?;
            }
            Ok(Some(Stepped::Asked(wake_ns, result))) => {
                slot.wake_ns = deadline_ns.map_or(wake_ns, time::simulated_ns);
                self.takes_outcome(&result)?;
            }
            Ok(Some(Stepped::Ended(reason))) => {
                slot.last = reason;
                return self.ends(place);
            }
            Err(panic) => match process::cause(panic) {
                Ok(_) => return self.dies(place),
                Err(text) => return Err(failure("nothing panics", text)),
            },
        }
        self.deliver();
        if is_worker && thread.is_none() {
            self.checker.observe()?;
        }
        self.memory_is_bounded(place)
    }

    /// A process allocates at most so much more than when it began its work.
    fn memory_is_bounded(&mut self, place: usize) -> Checked {
        let slot = &self.slots[place];
        let Some(program) = &slot.program else {
            return Ok(());
        };
        let bytes = memory::live(slot.pid) - slot.opened_bytes;
        let max_bytes = grown::max_bytes(program, &self.scenario.setup);
        if bytes > max_bytes {
            let found =
                format!("{} has grown by {bytes} bytes, allowed are {max_bytes}", slot.name);
            return Err(failure("memory is bounded", found));
        }
        self.outcome.grown.note(program, bytes);
        Ok(())
    }

    /// Wakes processes that wait for an event that has happened.
    pub(super) fn deliver(&mut self) {
        host::take_woken(&mut self.woken);
        let woken = std::mem::take(&mut self.woken);
        for pid in &woken {
            for slot in self.slots.iter_mut().filter(|slot| slot.pid == *pid) {
                let latency_ns = 20_000 + host::below(60_000) as u64;
                slot.wake_ns = slot.wake_ns.min(time::now_ns() + latency_ns);
            }
        }
        self.woken = woken;
        self.woken.clear();
    }

    fn takes_outcome(&mut self, result: &Outcome) -> Checked {
        match result {
            Outcome::Nothing => Ok(()),
            Outcome::Answer(answered) => {
                // One of the worker before may be found late.
                let is_its = self.checker.run() == Some(answered.worker_epoch);
                self.answered += u64::from(is_its);
                self.outcome.questions += 1;
                self.checker.answered(answered)
            }
            Outcome::TimedOut(asked_ns) if *asked_ns < self.worker_ended_ns => {
                let found = format!("asked at {asked_ns} ns, the worker ended later");
                Err(failure("clients learn of every end", found))
            }
            Outcome::TimedOut(_) => Ok(()),
        }
    }

    fn learns(&mut self, place: usize, learned: &Learned) -> Checked {
        if learned.is_false {
            let found = "a planner believes a false frame".to_owned();
            return Err(failure("only the worker is believed", found));
        }
        let slot = &mut self.slots[place];
        let looked_ns = std::mem::replace(&mut slot.looked_ns, time::now_ns());
        for frame in &learned.frames {
            let before = slot.follows.replace(*frame);
            if before.is_none_or(|before| before.1 != frame.1) {
                slot.watched = (self.checker.run() == Some(frame.1)).then_some(frame.1);
            }
            if before.is_some_and(|(_, run, tick)| (frame.1, frame.2) <= (run, tick)) {
                let found = format!("a planner has frame {frame:?} after {before:?}");
                return Err(failure("planners see runs and ticks in order", found));
            }
            let is_late = time::now_ns() - looked_ns > 2 * learned.every_ns;
            if let Some(before) = before.filter(|_| learned.polls && !is_late) {
                self.checker.none_between(before, *frame)?;
            }
        }
        self.checker.end_is_reported(learned, slot.watched)?;
        if learned.is_worse || !learned.frames.is_empty() {
            slot.learn_until_ns = u64::MAX;
            slot.is_warned = learned.is_worse;
        } else if time::now_ns() > slot.learn_until_ns {
            let found = format!(
                "{:?} has ended, and a planner was not told by {}",
                slot.follows, slot.learn_until_ns
            );
            return Err(failure("planners learn of every end", found));
        }
        Ok(())
    }

    /// A board shows what the worker has sent, in order, and counts each tick that it has missed.
    fn shows(&mut self, place: usize, shown: &Shown) -> Checked {
        self.outcome.boards += 1;
        self.checker.is_sent(shown)?;
        let slot = &mut self.slots[place];
        let looked_ns = std::mem::replace(&mut slot.looked_ns, time::now_ns());
        let most_ns = (SECOND / 5).max(2 * self.scenario.setup.period_ns);
        // A thread whose process was stopped reads after this.
        if time::now_ns() - looked_ns > most_ns {
            slot.late_until_ns = time::now_ns() + most_ns;
        }
        let is_late = time::now_ns() < slot.late_until_ns;
        let Some((frame, _)) = shown.frame else { return Ok(()) };
        let before = slot.shown.replace((frame, shown.frames, shown.missed));
        let Some(((_, run, tick), frames, missed)) = before else { return Ok(()) };
        if (frame.1, frame.2) < (run, tick) {
            let found = format!("{frame:?} after {before:?}");
            return Err(failure("boards see runs and ticks in order", found));
        }
        let counted = (shown.frames - frames) + (shown.missed - missed);
        if frame.1 == run && counted != frame.2 - tick {
            let found = format!("{before:?}, then {frame:?}: {counted} ticks are counted");
            return Err(failure("boards count each tick", found));
        }
        if shown.missed > missed && !is_late {
            let found = format!("{before:?}, then {frame:?}: {} are missed", shown.missed);
            return Err(failure("boards see every frame", found));
        }
        Ok(())
    }
}
