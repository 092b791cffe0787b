//! The account of messages and values that could not be mapped.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use joulebus_plausibility::Unusable;
use serde::Serialize;

/// Maximum number of names kept for each route and reason, because messages may contain any name.
const MAX_NAMES: usize = 16;
/// Maximum number of pairs of route and reason that are counted separately.
const MAX_KINDS: usize = 1_000;
/// Maximum number of pairs of route and robot whose fields are watched.
const MAX_ROBOTS: usize = 10_000;
/// Messages after which a field that none of them had is named.
const MANY_MESSAGES: u32 = 20;
/// Maximum length of a kept name, letters.
const MAX_LETTERS: usize = 80;

/// Reason that a message, or a value in it, was not mapped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Reason {
    /// Longer than `max_payload_bytes`, or than 64 KiB in ROS 2.
    TooLong,
    NotJson,
    NotCdr,
    /// Not encoded in plain CDR, or as a message of MQTT.
    WrongEncoding,
    /// A participant with an incompatible quality of service.
    IncompatibleQos,
    UnknownRobot,
    /// A version of a standard that is not known: 1 to 3 of VDA 5050 are.
    UnknownVersion,
    Nothing,
    /// A value, or a topic, of another type than expected.
    WrongType,
    /// NaN, infinite or beyond what 32 bits hold.
    NotFinite,
    /// A share beyond 0 to 1, or a code that the message's definition does not have.
    OutOfRange,
    /// A charge that its sender does not know: NaN or −1.
    Unknown,
    /// Stamped by another clock than `/clock`, or before a reset of the simulation.
    WrongStamp,
    /// Retained by the broker, so of unknown age.
    Retained,
    /// Made long before it arrived, or by a clock that differs. It counts all the same.
    Late,
    NoRoute,
    /// A field that none of the first messages of a robot had.
    NeverCame,
    NoAnswer,
    /// A broker or a participant refuses.
    Refused,
}

impl From<Unusable> for Reason {
    fn from(why: Unusable) -> Self {
        match why {
            Unusable::NotFinite => Self::NotFinite,
            Unusable::OutOfRange => Self::OutOfRange,
            Unusable::Unknown => Self::Unknown,
        }
    }
}

impl Reason {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::TooLong => "too_long",
            Self::NotJson => "not_json",
            Self::NotCdr => "not_cdr",
            Self::WrongEncoding => "wrong_encoding",
            Self::IncompatibleQos => "incompatible_qos",
            Self::UnknownRobot => "unknown_robot",
            Self::UnknownVersion => "unknown_version",
            Self::Nothing => "nothing_mapped",
            Self::WrongType => "wrong_type",
            Self::NotFinite => "not_finite",
            Self::OutOfRange => "out_of_range",
            Self::Unknown => "unknown",
            Self::WrongStamp => "wrong_stamp",
            Self::Retained => "retained",
            Self::Late => "late",
            Self::NoRoute => "no_route",
            Self::NeverCame => "never_came",
            Self::NoAnswer => "no_answer",
            Self::Refused => "refused",
        }
    }

    /// True if a value was lost. Retained messages are skipped on purpose, a filter may match topics
    /// of others, and a field that never came, or that is unknown, is not lost.
    const fn is_loss(self) -> bool {
        !matches!(
            self,
            Self::Unknown
                | Self::Retained
                | Self::Late
                | Self::NoAnswer
                | Self::NoRoute
                | Self::NeverCame
        )
    }
}

/// Counters by route and reason.
#[derive(Debug, Clone, Default)]
pub(crate) struct Account {
    kinds: BTreeMap<(String, Reason), Kind>,
    lost: u64,
    /// The fields that came, by route and robot.
    came: BTreeMap<(String, String), Came>,
    /// Pairs and names that were not logged yet.
    news: Vec<String>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Came {
    messages: u32,
    /// A bit for each field.
    fields: u32,
}

#[derive(Debug, Clone, Default)]
struct Kind {
    count: u64,
    names: BTreeSet<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct UnmappedRecord {
    pub(crate) route: String,
    pub(crate) reason: &'static str,
    pub(crate) count: u64,
    pub(crate) names: Vec<String>,
}

impl Account {
    /// Counts one occurrence. `name` is the robot, topic or field.
    pub(crate) fn count(&mut self, route: &str, reason: Reason, name: &str) {
        self.lost += u64::from(reason.is_loss());
        let is_full = self.kinds.len() >= MAX_KINDS;
        let key = (route.to_owned(), reason);
        if is_full && !self.kinds.contains_key(&key) {
            return;
        }
        let kind = self.kinds.entry(key).or_default();
        kind.count += 1;
        if kind.names.len() >= MAX_NAMES {
            return;
        }
        let name: String = name.chars().take(MAX_LETTERS).collect();
        let news = format!("{route}: {}: {name}", reason.name());
        if kind.names.insert(name) {
            self.news.push(news);
        }
    }

    /// Adds which of the mapped fields a message of a robot had. After [`MANY_MESSAGES`] the fields
    /// that none of them had are counted by name.
    pub(crate) fn came(&mut self, route: &str, robot: &str, fields: &[(&'static str, bool)]) {
        let key = (route.to_owned(), robot.to_owned());
        let is_full = self.came.len() >= MAX_ROBOTS;
        if is_full && !self.came.contains_key(&key) {
            return;
        }
        let came = self.came.entry(key).or_default();
        came.messages = came.messages.saturating_add(1);
        for (place, (_, has)) in fields.iter().enumerate().take(32) {
            came.fields |= u32::from(*has) << place;
        }
        let seen = came.fields;
        if came.messages != MANY_MESSAGES {
            return;
        }
        for (place, (name, _)) in fields.iter().enumerate().take(32) {
            if seen & (1 << place) == 0 {
                self.count(route, Reason::NeverCame, &format!("{name} of {robot}"));
            }
        }
    }

    /// The new entries since the last call, one line for each kept name.
    pub(crate) fn take_news(&mut self) -> Vec<String> {
        std::mem::take(&mut self.news)
    }

    pub(crate) const fn lost(&self) -> u64 {
        self.lost
    }

    pub(crate) fn records(&self) -> Vec<UnmappedRecord> {
        let record = |((route, reason), kind): (&(String, Reason), &Kind)| UnmappedRecord {
            route: route.clone(),
            reason: reason.name(),
            count: kind.count,
            names: kind.names.iter().cloned().collect(),
        };
        self.kinds.iter().map(record).collect()
    }
}

impl fmt::Display for UnmappedRecord {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { route, reason, count, names } = self;
        write!(out, "{route}: {reason} {count} ({})", names.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_that_never_came_is_named_once_and_is_no_loss() {
        let mut account = Account::default();
        for message in 0..100 {
            account.came("a", "r1", &[("power", false), ("soc", true), ("v", message == 7)]);
            account.came("a", "r2", &[("power", true), ("soc", true), ("v", true)]);
        }
        assert_eq!(account.take_news(), ["a: never_came: power of r1"]);
        assert_eq!((account.records().len(), account.lost()), (1, 0));
    }

    #[test]
    fn everything_is_counted_and_only_the_first_names_are_kept() {
        let mut account = Account::default();
        for robot in 0..1_000 {
            account.count("a/{robot}", Reason::UnknownRobot, &format!("r{robot}"));
            let news = account.take_news();
            assert_eq!(news.len(), usize::from(robot < 16), "{robot}");
        }
        account.count("a/{robot}", Reason::Retained, &"x".repeat(9_999));
        let records = account.records();
        assert_eq!(records.len(), 2);
        assert_eq!((records[0].count, records[0].names.len()), (1_000, 16));
        assert_eq!(records[1].names[0].len(), MAX_LETTERS);
        assert_eq!(account.lost(), 1_000, "what was retained is no loss");
        for route in 0..2_000 {
            account.count(&route.to_string(), Reason::NotJson, "");
        }
        assert_eq!(account.records().len(), MAX_KINDS);
        assert_eq!(account.lost(), 3_000);
    }
}
