//! A copy of the newest rows at one time, from which the clients' windows are cut.

use std::sync::{Arc, OnceLock};

use joulebus_board::{Board, Platforms, RobotRecord, Sort, SortKey};
use joulebus_wire::fnv1a;
use serde::Serialize;
use serde_json::Value;

use super::alarms::Alarms;
use super::entry::{Entry, Object};
use super::fleet::FleetRecord;
use super::totals::{Accumulated, Accumulator};

/// A snapshot of this age is no news of the worker, ns: the reading thread makes ten a second.
const OLD_NS: u64 = 2_000_000_000;

#[derive(Serialize)]
struct ShownRecord<'a> {
    #[serde(flatten)]
    record: RobotRecord,
    platform: Option<&'a str>,
    /// Time since the stamp of the newest sample, s, rounded to tenths.
    sample_age_s: Option<f64>,
}

/// A fleet at one time. What is computed from it is computed once for all clients.
#[derive(Debug)]
pub(super) struct Snapshot {
    pub(super) fleet: FleetRecord,
    pub(super) alarms: Arc<Alarms>,
    pub(super) accumulated: Accumulated,
    pub(super) at_ns: u64,
    platforms: Arc<Platforms>,
    entries: Vec<Entry>,
    /// Hash of the robots' levels. An order by urgency may change with it.
    levels_hash: u64,
    orders: [[OnceLock<Vec<u32>>; 2]; Sort::ALL.len()],
    fleet_object: OnceLock<Arc<Object>>,
}

impl Snapshot {
    pub(super) fn new(
        board: &Board,
        fleet: FleetRecord,
        alarms: Arc<Alarms>,
        accumulator: &mut Accumulator,
        at_ns: u64,
        platforms: Arc<Platforms>,
    ) -> Self {
        let accumulated = accumulator.add(board);
        let rows = board.rows.iter().map(|(robot, row)| Entry {
            robot: *robot,
            platform: platforms.of_robot(*robot),
            newest: row.newest(),
            consumed_uj: accumulator.consumed_uj(*robot),
            record: OnceLock::new(),
        });
        let levels = board.rows.iter().flat_map(|(robot, row)| {
            let level = row.level().code().to_le_bytes();
            robot.to_le_bytes().into_iter().chain(level)
        });
        Self {
            entries: rows.collect(),
            fleet,
            alarms,
            accumulated,
            at_ns,
            levels_hash: fnv1a(levels),
            orders: Default::default(),
            fleet_object: OnceLock::new(),
            platforms,
        }
    }

    /// Reason that the worker may not serve at `now_ns` (monotonic). `None` if its frames arrive.
    pub(super) fn why_not_up(&self, now_ns: u64) -> Option<String> {
        let worker = &self.fleet.worker;
        let age_ns = now_ns.saturating_sub(self.at_ns);
        if age_ns > OLD_NS {
            let (age_s, old_s) = (age_ns as f64 * 1e-9, OLD_NS as f64 * 1e-9);
            return Some(format!(
                "the thread that reads shared memory has shown nothing for {age_s:.1} s, {old_s:.1} s are allowed: \
                 restart this server"
            ));
        }
        let reason = worker.reason.as_ref()?;
        Some(format!("the worker is {}: {reason}", worker.state))
    }

    pub(super) fn platforms(&self) -> &Platforms {
        &self.platforms
    }

    /// All robots, sorted by id.
    pub(super) fn entries(&self) -> &[Entry] {
        &self.entries
    }

    pub(super) fn entry(&self, place: u32) -> &Entry {
        &self.entries[place as usize]
    }

    pub(super) const fn levels_hash(&self) -> u64 {
        self.levels_hash
    }

    /// Places of all robots in an order.
    pub(super) fn order(&self, sort: Sort, descending: bool) -> &[u32] {
        self.orders[sort as usize][usize::from(descending)].get_or_init(|| {
            let keys = self.entries.iter();
            let keys = keys.map(|entry| sort.key(entry.robot, &entry.newest));
            let mut places: Vec<(SortKey, u32)> = keys.zip(0..).collect();
            places.sort_unstable_by(|(a, _), (b, _)| sort.compare(descending, a, b));
            places.into_iter().map(|(_, place)| place).collect()
        })
    }

    /// A robot as in `watch --format json`, with its platform.
    pub(super) fn robot(&self, robot: u32) -> Option<Arc<Object>> {
        let place = self.entries.binary_search_by_key(&robot, |entry| entry.robot).ok()?;
        let entry = &self.entries[place];
        let record = entry.record.get_or_init(|| {
            object(&ShownRecord {
                record: RobotRecord::new(robot, &entry.newest),
                sample_age_s: entry
                    .sample_age_ns(self.at_ns)
                    .map(|age_ns| (age_ns / 100_000_000) as f64 * 0.1),
                platform: entry.platform.map(|place| self.platforms.names()[place].as_str()),
            })
        });
        Some(Arc::clone(record))
    }

    /// The fleet as an object.
    pub(super) fn fleet_object(&self) -> &Arc<Object> {
        self.fleet_object.get_or_init(|| object(&self.fleet))
    }
}

/// A value as an object.
pub(super) fn object(value: &impl Serialize) -> Arc<Object> {
    match serde_json::to_value(value) {
        Ok(Value::Object(object)) => Arc::new(object),
        // Records have names, and only those.
        _ => Arc::default(),
    }
}
