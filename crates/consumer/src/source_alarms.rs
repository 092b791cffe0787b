//! Alarms of sources: robots whose readings are implausible, as who publishes them finds.

use std::collections::BTreeMap;

use joulebus_bus::clock;
use joulebus_config::Config;
use joulebus_connect::findings::implausible_robots;

use crate::alarms::Change;

/// Interval at which findings are looked for, ns.
const POLL_INTERVAL_NS: u64 = 1_000_000_000;

/// A raise or an end of the alarm of a robot.
///
/// [`SourceAlarms`] has an example.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct SourceChange {
    /// The robot.
    pub robot: u32,
    /// The change.
    pub change: Change,
    /// When, monotonic ns.
    pub at_ns: u64,
    /// When it was raised, monotonic ns.
    pub raised_ns: u64,
}

/// The robots with the alarm [`joulebus_wire::AlarmCard::IMPLAUSIBLE`], from one look to the next.
///
/// ```no_run
/// # use joulebus_consumer::{Config, SourceAlarms};
/// # fn example(config: &Config) {
/// let mut alarms = SourceAlarms::new(config);
/// alarms.changes(|change| println!("robot {}: {}", change.robot, change.change.name()));
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct SourceAlarms {
    config: Config,
    /// Since when, monotonic ns.
    raised: BTreeMap<u32, u64>,
    look_at_ns: u64,
}

impl SourceAlarms {
    /// Watches the sources of a fleet.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        Self { config: config.clone(), raised: BTreeMap::new(), look_at_ns: 0 }
    }

    /// Looks once a second, and calls `each` for every raise and end. Does not wait.
    pub fn changes(&mut self, mut each: impl FnMut(SourceChange)) {
        let now_ns = clock::monotonic_ns();
        if now_ns < self.look_at_ns {
            return;
        }
        self.look_at_ns = now_ns + POLL_INTERVAL_NS;
        let found = implausible_robots(&self.config);
        let mut pass_on = |robot, change, raised_ns| {
            let at_ns = if change == Change::Raised { raised_ns } else { now_ns };
            each(SourceChange { robot, change, at_ns, raised_ns });
        };
        self.raised.retain(|robot, raised_ns| {
            let stays = found.contains_key(robot);
            if !stays {
                pass_on(*robot, Change::Cleared, *raised_ns);
            }
            stays
        });
        for (robot, since_ns) in found {
            self.raised.entry(robot).or_insert_with(|| {
                pass_on(robot, Change::Raised, since_ns);
                since_ns
            });
        }
    }

    /// The robots that have it, and since when, monotonic ns.
    pub fn raised(&self) -> impl Iterator<Item = (u32, u64)> {
        self.raised.iter().map(|(robot, since_ns)| (*robot, *since_ns))
    }
}
