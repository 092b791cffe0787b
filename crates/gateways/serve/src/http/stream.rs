//! A client's stream of events: first the whole view, then its changes. Nothing is queued. A
//! message is made of the newest snapshot when the client has taken the previous one.

use std::collections::HashMap;
use std::sync::Arc;

use serde_json::{Value, json};

use super::alarms::Alarms;
use super::entry::Object;
use super::snapshot::{Snapshot, object};
use super::view::{View, Window};

/// Minimum time between changes that affect only the order, ns. Rows that move under the pointer
/// are hard to click.
const HOLD_ORDER_NS: u64 = 2_000_000_000;

/// A client, with the events that it has already received.
#[derive(Debug)]
pub(super) struct Client {
    view: View,
    /// The robot shown in detail.
    robot: Option<u32>,
    sent: Option<Sent>,
    seq: u64,
}

#[derive(Debug)]
struct Sent {
    fleet: Arc<Object>,
    window: Window,
    rows: HashMap<u32, Arc<Object>>,
    robot: Option<Arc<Object>>,
    alarms: Arc<Alarms>,
    levels_hash: u64,
    ordered_ns: u64,
}

impl Client {
    pub(super) const fn new(view: View, robot: Option<u32>) -> Self {
        Self { view, robot, sent: None, seq: 0 }
    }

    pub(super) fn message(&mut self, snapshot: &Snapshot) -> String {
        self.seq += 1;
        let (event, data) = match self.sent.take() {
            None => ("view", self.whole(snapshot)),
            Some(sent) => ("delta", self.delta(sent, snapshot)),
        };
        format!("event: {event}\ndata: {data}\n\n")
    }

    fn whole(&mut self, snapshot: &Snapshot) -> Value {
        let window = self.view.window(snapshot);
        let rows = rows(&window.robots, snapshot);
        let listed = window.robots.iter().filter_map(|robot| rows.get(robot));
        let listed: Vec<Object> = listed.map(|row| (**row).clone()).collect();
        let sent = Sent {
            fleet: Arc::clone(snapshot.fleet_object()),
            robot: self.robot.and_then(|robot| snapshot.robot(robot)),
            alarms: Arc::clone(&snapshot.alarms),
            levels_hash: snapshot.levels_hash(),
            ordered_ns: snapshot.at_ns,
            rows: HashMap::new(),
            window,
        };
        let data = json!({
            "seq": self.seq,
            "fleet": *sent.fleet,
            "robots": {
                "total": sent.window.total,
                "matched": sent.window.matched,
                "from": self.view.from,
                "robots": listed,
            },
            "robot": sent.robot.as_deref(),
            "alarms": *sent.alarms,
        });
        self.sent = Some(Sent { rows, ..sent });
        data
    }

    fn delta(&mut self, mut sent: Sent, snapshot: &Snapshot) -> Value {
        let mut data = Object::new();
        data.insert("seq".to_owned(), self.seq.into());
        let fleet = changed(&sent.fleet, snapshot.fleet_object());
        if !fleet.is_empty() {
            data.insert("fleet".to_owned(), fleet.into());
            sent.fleet = Arc::clone(snapshot.fleet_object());
        }
        if let Some(robots) = self.robots(&mut sent, snapshot) {
            data.insert("robots".to_owned(), robots.into());
        }
        if let Some(wanted) = self.robot {
            let newest = snapshot.robot(wanted);
            if let Some(robot) = detail(sent.robot.as_deref(), newest.as_deref()) {
                data.insert("robot".to_owned(), robot);
            }
            sent.robot = newest;
        }
        if let Some(alarms) = alarms(&sent.alarms, &snapshot.alarms) {
            data.insert("alarms".to_owned(), alarms.into());
            sent.alarms = Arc::clone(&snapshot.alarms);
        }
        self.sent = Some(sent);
        data.into()
    }

    fn robots(&self, sent: &mut Sent, snapshot: &Snapshot) -> Option<Object> {
        let mut window = self.view.window(snapshot);
        let mut robots = Object::new();
        let is_new = window.robots != sent.window.robots;
        let may_move = snapshot.levels_hash() != sent.levels_hash
            || (window.total, window.matched) != (sent.window.total, sent.window.matched)
            || snapshot.at_ns.saturating_sub(sent.ordered_ns) >= HOLD_ORDER_NS;
        if is_new && may_move {
            robots.insert("order".to_owned(), window.robots.clone().into());
            sent.levels_hash = snapshot.levels_hash();
            sent.ordered_ns = snapshot.at_ns;
        } else if is_new {
            window.robots.clone_from(&sent.window.robots);
        }
        let newest = rows(&window.robots, snapshot);
        let changes = newest.iter().filter_map(|(robot, row)| {
            let change =
                sent.rows.get(robot).map_or_else(|| (**row).clone(), |before| changed(before, row));
            (!change.is_empty()).then(|| (robot.to_string(), Value::from(change)))
        });
        let changes: Object = changes.collect();
        if !changes.is_empty() {
            robots.insert("rows".to_owned(), changes.into());
        }
        let counted = (window.total, window.matched) != (sent.window.total, sent.window.matched);
        sent.rows = newest;
        sent.window = window;
        if robots.is_empty() && !counted {
            return None;
        }
        for (name, count) in [
            ("total", sent.window.total),
            ("matched", sent.window.matched),
            ("from", self.view.from),
        ] {
            robots.insert(name.to_owned(), count.into());
        }
        Some(robots)
    }
}

fn rows(robots: &[u32], snapshot: &Snapshot) -> HashMap<u32, Arc<Object>> {
    let rows = robots.iter();
    rows.filter_map(|robot| Some((*robot, snapshot.robot(*robot)?))).collect()
}

/// The values of `after` that differ from those of `before`.
fn changed(before: &Object, after: &Object) -> Object {
    let differ = after.iter().filter(|(name, value)| before.get(*name) != Some(*value));
    differ.map(|(name, value)| (name.clone(), value.clone())).collect()
}

/// The detail of the selected robot to send. `None` if it has not changed.
fn detail(before: Option<&Object>, after: Option<&Object>) -> Option<Value> {
    match (before, after) {
        (None, None) => None,
        (Some(_), None) => Some(Value::Null),
        (None, Some(after)) => Some(after.clone().into()),
        (Some(before), Some(after)) => {
            let change = changed(before, after);
            (!change.is_empty()).then(|| change.into())
        }
    }
}

fn alarms(before: &Alarms, after: &Alarms) -> Option<Object> {
    let new = usize::try_from(after.number - before.number).unwrap_or(usize::MAX);
    if new == 0 {
        return None;
    }
    let value = object(&Alarms {
        raised: after.raised.clone(),
        changes: after.changes.iter().take(new).cloned().collect(),
        number: after.number,
    });
    let mut value = Arc::unwrap_or_clone(value);
    if before.raised == after.raised {
        value.remove("raised");
    }
    Some(value)
}
