//! Orders of robots.

use std::cmp::Ordering;

use joulebus_wire::{Level, budget_flag, forecast_flag};

use super::entry::Entry;

/// What robots are sorted by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sort {
    Urgency,
    Robot,
    Soc,
    Left,
    Power,
    Level,
}

impl Sort {
    /// All, in the order of their discriminants.
    pub(super) const ALL: [(Self, &'static str); 6] = [
        (Self::Urgency, "urgency"),
        (Self::Robot, "robot"),
        (Self::Soc, "soc"),
        (Self::Left, "left"),
        (Self::Power, "power"),
        (Self::Level, "level"),
    ];

    fn rank(self, entry: &Entry) -> u16 {
        let level = entry.newest.level();
        match (self, level) {
            (Self::Urgency, Level::Error) => 0,
            (Self::Urgency, Level::Stale) => 1,
            (Self::Urgency, Level::Warn) => 2,
            (Self::Urgency, Level::Ok) => 3,
            (Self::Level, level) => level.code(),
            _ => 0,
        }
    }

    fn value(self, entry: &Entry) -> Option<f64> {
        let newest = &entry.newest;
        let of_budget = |flag: u32, value: f32| {
            let has = newest.budget.is_some_and(|budget| budget.flags & flag != 0);
            has.then(|| f64::from(value))
                .filter(|value| value.is_finite())
        };
        match self {
            Self::Urgency | Self::Left => of_budget(
                budget_flag::TIME_TO_EMPTY,
                newest
                    .budget
                    .map_or(f32::NAN, |budget| budget.time_to_empty_s),
            ),
            Self::Soc => of_budget(
                budget_flag::BATTERY,
                newest.budget.map_or(f32::NAN, |budget| budget.soc),
            ),
            Self::Power => {
                let read = newest.forecast.flags & forecast_flag::READING != 0;
                read.then(|| f64::from(newest.forecast.reading_w))
            }
            Self::Robot | Self::Level => None,
        }
    }

    /// Orders two robots; unknown values are last in either direction, and equal ones are in the order of ids.
    pub(super) fn compare(self, descending: bool, a: &Entry, b: &Entry) -> Ordering {
        let turned = |order: Ordering| if descending { order.reverse() } else { order };
        let by_rank = turned(self.rank(a).cmp(&self.rank(b)));
        let by_value = match (self.value(a), self.value(b)) {
            (Some(a), Some(b)) => turned(a.total_cmp(&b)),
            (a, b) => a.is_none().cmp(&b.is_none()),
        };
        let by_id = a.robot.cmp(&b.robot);
        let by_id = if self == Self::Robot {
            turned(by_id)
        } else {
            by_id
        };
        by_rank.then(by_value).then(by_id)
    }
}
