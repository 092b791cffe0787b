//! Orders of robots.

use std::cmp::Ordering;

use joulebus_wire::{Level, budget_flag, forecast_flag};

use crate::board::{Board, Newest};

/// Sort order of robots.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sort {
    /// Level (error, stale, warn, ok), then time to empty.
    Urgency,
    /// Id.
    Robot,
    /// State of charge.
    Soc,
    /// Time to empty.
    Left,
    /// Newest reading.
    Power,
    /// Level: ok, warn, error, stale.
    Level,
}

/// A robot's key in every order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SortKey {
    rank: u16,
    value: Option<f64>,
    robot: u32,
}

impl SortKey {
    /// The robot's id.
    pub const fn robot(&self) -> u32 {
        self.robot
    }
}

impl Sort {
    /// All orders with their names, in the order of their discriminants.
    pub const ALL: [(Self, &'static str); 6] = [
        (Self::Urgency, "urgency"),
        (Self::Robot, "robot"),
        (Self::Soc, "soc"),
        (Self::Left, "left"),
        (Self::Power, "power"),
        (Self::Level, "level"),
    ];

    /// The key of a robot with these rows.
    #[must_use]
    pub fn key(self, robot: u32, newest: &Newest) -> SortKey {
        SortKey { rank: self.rank(newest), value: self.value(newest), robot }
    }

    fn rank(self, newest: &Newest) -> u16 {
        match (self, newest.level()) {
            (Self::Urgency, Level::Error) => 0,
            (Self::Urgency, Level::Stale) => 1,
            (Self::Urgency, Level::Warn) => 2,
            (Self::Urgency, Level::Ok) => 3,
            (Self::Level, level) => level.code(),
            _ => 0,
        }
    }

    fn value(self, newest: &Newest) -> Option<f64> {
        match self {
            Self::Urgency | Self::Left => newest
                .budget
                .filter(|budget| budget.flags & budget_flag::TIME_TO_EMPTY != 0)
                .map(|budget| f64::from(budget.time_to_empty_s))
                .filter(|left_s| left_s.is_finite()),
            Self::Soc => newest.soc(),
            Self::Power => {
                let read = newest.forecast.flags & forecast_flag::READING != 0;
                read.then(|| f64::from(newest.forecast.reading_w))
            }
            Self::Robot | Self::Level => None,
        }
    }

    /// Compares two robots. Unknown values are last in either direction, and equal ones are ordered
    /// by id.
    #[must_use]
    pub fn compare(self, descending: bool, a: &SortKey, b: &SortKey) -> Ordering {
        let turned = |order: Ordering| if descending { order.reverse() } else { order };
        let by_rank = turned(a.rank.cmp(&b.rank));
        let by_value = match (a.value, b.value) {
            (Some(a), Some(b)) => turned(a.total_cmp(&b)),
            (a, b) => a.is_none().cmp(&b.is_none()),
        };
        let by_id = a.robot.cmp(&b.robot);
        let by_id = if self == Self::Robot { turned(by_id) } else { by_id };
        by_rank.then(by_value).then(by_id)
    }
}

impl Board {
    /// Ids of all robots, the most urgent first.
    #[must_use]
    pub fn by_urgency(&self) -> Vec<u32> {
        let sort = Sort::Urgency;
        let mut keys: Vec<SortKey> =
            self.rows.iter().map(|(robot, row)| sort.key(*robot, &row.newest())).collect();
        keys.sort_unstable_by(|a, b| sort.compare(false, a, b));
        keys.iter().map(SortKey::robot).collect()
    }
}
