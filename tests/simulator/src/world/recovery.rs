//! After the last fault everything works again, and after the end nothing is left.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use simulated_bus as bus;
use simulated_host::{self as host, disk, time};

use super::state::{FOREIGN, SECOND, World};
use crate::check::{Checked, failure};
use crate::ledger::LEDGER;
use crate::process::{POLL_INTERVAL_NS, Program, Shown};
use crate::scenario::Role;

/// The robot of the source that joins last.
const LAST_ROBOT: u32 = 900_001;

impl World<'_> {
    /// After the last fault everything works again within a bound, and after a kill of the worker.
    pub(super) fn everything_works_again(&mut self) -> Checked {
        let setup = &self.scenario.setup;
        let (settle_ns, period_ns) = (setup.settle_ns(), setup.period_ns);
        // Requested kills that are still due do not happen any more.
        host::spare_all();
        for slot in &mut self.slots {
            (slot.kills_at_disk, slot.power_loss_ns) = (VecDeque::new(), 0);
        }
        let visitors_ns = self.slots.iter().filter(|slot| slot.role.is_none());
        let last_ns = visitors_ns.map(|slot| slot.until_ns).max().unwrap_or(0);
        let paused_ns = self.slots.iter().map(|slot| slot.paused_until_ns.max(slot.slow_until_ns));
        let quiet_ns = paused_ns.max().unwrap_or(0).max(last_ns).max(self.disk_until_ns);
        self.run_until(quiet_ns.max(self.memory_until_ns).max(time::now_ns()) + settle_ns)?;
        self.visitor("the last".to_owned(), vec![LAST_ROBOT], time::now_ns(), u64::MAX);
        self.run_until(time::now_ns() + 30 * period_ns + 2 * SECOND)?;
        self.all_answered()?;
        self.planners_are_fresh()?;
        self.boards_are_fresh()?;
        self.clients_are_answered()?;
        if self.scenario.setup.everything {
            let worker = self.slot(Role::Worker);
            self.dies(worker)?;
            self.run_until(time::now_ns() + 30 * period_ns + 5 * SECOND)?;
            self.all_answered()?;
            self.planners_are_fresh()?;
            self.boards_are_fresh()?;
            self.clients_are_answered()?;
        }
        for slot in 0..self.slots.len() {
            self.ends(slot)?;
        }
        self.nothing_is_left()
    }

    /// All robots of sources have forecasts; if not, the error states which processes run.
    fn all_answered(&self) -> Checked {
        self.checker.all_answered(LAST_ROBOT).map_err(|mut failure| {
            for slot in &self.slots {
                let (name, is_running) = (&slot.name, slot.program.is_some());
                failure.found += &format!("; {name} (runs: {is_running}) {}", slot.last);
            }
            failure
        })
    }

    fn planners_are_fresh(&self) -> Checked {
        let most_ns = 2 * self.scenario.setup.period_ns + 2 * POLL_INTERVAL_NS + SECOND / 10;
        for slot in &self.slots {
            let Some(Program::Planner(planner)) = &slot.program else {
                if matches!(slot.role, Some(Role::Planner(_))) {
                    let found = format!("{} does not run", slot.name);
                    return Err(failure("everything works again once faults stop", found));
                }
                continue;
            };
            let age_ns = planner.age_ns();
            if age_ns.is_none_or(|age_ns| age_ns > most_ns) {
                let found = format!("the newest frame of a planner is {age_ns:?} ns old");
                return Err(failure("everything works again once faults stop", found));
            }
        }
        Ok(())
    }

    /// Each board shows the worker alive, and forecasts of all robots that are as new.
    fn boards_are_fresh(&self) -> Checked {
        let most_ns = 2 * self.scenario.setup.period_ns + 4 * POLL_INTERVAL_NS + SECOND / 10;
        for slot in &self.slots {
            if !matches!(slot.role, Some(Role::Display(_) | Role::Bridge)) {
                continue;
            }
            let shown = slot.program.as_ref().and_then(Program::shown);
            let is_fresh = |shown: &Shown| {
                let sent_ns = shown.frame.map_or(0, |(_, sent_ns)| sent_ns);
                shown.is_live
                    && time::monotonic_ns() <= sent_ns + most_ns
                    && shown.robots.len() == self.checker.newest.len()
            };
            if !shown.as_ref().is_some_and(is_fresh) {
                let found = format!("{}: {shown:?}; {}", slot.name, slot.last);
                return Err(failure("everything works again once faults stop", found));
            }
        }
        Ok(())
    }

    /// Each client was answered lately: it has asked all the time.
    fn clients_are_answered(&self) -> Checked {
        let period_ns = self.scenario.setup.period_ns;
        let most_ns = 20 * period_ns + 4 * SECOND;
        for slot in &self.slots {
            let is_client = matches!(slot.role, Some(Role::Client(_)));
            let found = match &slot.program {
                Some(Program::Client(client)) if time::now_ns() <= client.answered_ns + most_ns => {
                    continue;
                }
                Some(Program::Client(client)) => format!(
                    "{} was answered at {} ns last: {}",
                    slot.name, client.answered_ns, client.last
                ),
                _ if is_client => format!("{} does not run: {}", slot.name, slot.last),
                _ => continue,
            };
            return Err(failure("everything works again once faults stop", found));
        }
        Ok(())
    }

    /// After the end: no port, and no file but the ledger's and foreign ones, unchanged.
    fn nothing_is_left(&self) -> Checked {
        for path in FOREIGN {
            if disk::peek(Path::new(path)).as_deref() != Some(path.as_bytes()) {
                return Err(failure("nothing of others is changed", path.to_owned()));
            }
        }
        // The observer has two.
        if bus::size() > 2 {
            return Err(failure("nothing is left behind", format!("{} ports", bus::size())));
        }
        let ours = |path: &PathBuf| {
            let name = path.display().to_string();
            FOREIGN.contains(&name.as_str()) || name.starts_with(LEDGER)
        };
        let names = disk::names();
        let is_aside = |path: &&PathBuf| path.display().to_string().contains(".damaged-");
        let kept = names.iter().filter(|path| !is_aside(path)).count();
        match names.iter().find(|path| !ours(path)) {
            Some(path) => Err(failure("nothing is left behind", path.display().to_string())),
            // Two generations and a temporary file, beside those that were set aside.
            None if kept > FOREIGN.len() + 3 => {
                Err(failure("nothing is left behind", format!("{kept} files")))
            }
            None => Ok(()),
        }
    }
}
