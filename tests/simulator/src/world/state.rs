//! The processes of a simulation, and what is known of them.

use std::sync::atomic::AtomicBool;

use joulebus_config::Config;
use joulebus_predictor::Model;
use simulated_host as host;

use super::outcome::Outcome;
use super::slot::Slot;
use crate::check::{Answers, Checker};
use crate::scenario::{Role, Scenario};

pub(super) const SECOND: u64 = 1_000_000_000;
/// Files of others beside it.
pub(super) const FOREIGN: [&str; 3] =
    ["/sim/ledger.json.mine", "/sim/notes.txt", "/sim/captures/other.mcap"];
/// Pids are reused after so many processes.
pub(super) const PIDS: std::ops::Range<u32> = host::FIRST_PID..host::FIRST_PID + 40;

pub(super) struct World<'a> {
    pub(super) scenario: &'a Scenario,
    pub(super) stop: &'a AtomicBool,
    pub(super) config: Config,
    pub(super) slots: Vec<Slot>,
    pub(super) checker: Checker,
    pub(super) next_pid: u32,
    pub(super) names: u64,
    pub(super) woken: Vec<u32>,
    pub(super) disk_until_ns: u64,
    pub(super) memory_until_ns: u64,
    /// A process has died with which the power fails, for so long.
    pub(super) power_loss_ns: u64,
    /// The newest generation of the ledger that was whole when a worker ended.
    pub(super) saved: u64,
    /// When a worker has ended last, simulated ns.
    pub(super) worker_ended_ns: u64,
    /// Questions that clients were answered in the life of this worker.
    pub(super) answered: u64,
    pub(super) outcome: Outcome,
}

impl<'a> World<'a> {
    pub(super) fn new(
        scenario: &'a Scenario,
        stop: &'a AtomicBool,
        config: Config,
        models: Vec<Model>,
    ) -> Self {
        let setup = &scenario.setup;
        let mut checker = Checker::new(setup, &config, models);
        checker.answers = (!setup.everything).then(Answers::default);
        checker.join();
        let mut world = Self {
            scenario,
            stop,
            config,
            slots: Vec::new(),
            checker,
            next_pid: PIDS.start,
            names: 0,
            woken: Vec::new(),
            disk_until_ns: 0,
            memory_until_ns: 0,
            power_loss_ns: 0,
            saved: 0,
            worker_ended_ns: 0,
            answered: 0,
            outcome: Outcome::default(),
        };
        world.place(Some(Role::Worker), "worker".to_owned(), Vec::new(), 0);
        for source in 0..setup.sources {
            let robots = (0..setup.robots).map(|robot| (10 * source + robot) as u32);
            // The first answers are the same only if the worker has read the first sample.
            let name = format!("source-{source}");
            world.place(Some(Role::Source(source)), name, robots.collect(), SECOND / 10);
        }
        for planner in 0..setup.planners {
            world.place(Some(Role::Planner(planner)), "planner".to_owned(), Vec::new(), 0);
        }
        for client in 0..setup.clients {
            world.place(
                Some(Role::Client(client)),
                format!("client-{client}"),
                Vec::new(),
                SECOND / 5,
            );
        }
        if setup.records {
            world.place(Some(Role::Recorder), "recorder".to_owned(), Vec::new(), SECOND / 20);
        }
        for display in 0..setup.displays {
            world.place(Some(Role::Display(display)), "display".to_owned(), Vec::new(), 0);
        }
        for bridge in 0..setup.bridges {
            let robots =
                (0..setup.robots).map(|robot| (10 * (setup.sources + bridge) + robot) as u32);
            world.place(Some(Role::Bridge), "bridge".to_owned(), robots.collect(), SECOND / 10);
        }
        world
    }

    fn place(&mut self, role: Option<Role>, name: String, robots: Vec<u32>, start_ns: u64) {
        self.slots.push(Slot::new(role, name, robots, start_ns));
    }

    pub(super) fn slot(&self, role: Role) -> usize {
        let found = self.slots.iter().position(|slot| slot.role == Some(role));
        found.unwrap_or_default()
    }

    pub(super) fn visitor(&mut self, name: String, robots: Vec<u32>, start_ns: u64, until_ns: u64) {
        self.place(None, name, robots, start_ns);
        if let Some(slot) = self.slots.last_mut() {
            slot.until_ns = until_ns;
        }
    }
}
