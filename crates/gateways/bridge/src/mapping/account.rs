//! What could not be mapped: counted, and named.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use serde::Serialize;

/// Names that are kept for each route and reason; messages may name anything.
const MOST_NAMES: usize = 16;
/// Routes and reasons that are kept apart.
const MOST_KINDS: usize = 1_000;
/// Letters of a name that are kept.
const MOST_LETTERS: usize = 80;

/// Why a message, or a value in it, was not mapped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Reason {
    /// Longer than `max_payload_bytes`, or than 64 KiB in ROS 2.
    TooLong,
    /// Not JSON, or nested too deeply, or with numbers that no computer holds.
    NotJson,
    /// Not the CDR of its type.
    NotCdr,
    /// Encoded otherwise than in plain CDR.
    WrongEncoding,
    /// A participant whose quality of service does not fit.
    IncompatibleQos,
    /// No name of `[robots]`.
    UnknownRobot,
    /// Nothing in it that the mapping names.
    Nothing,
    /// A value, or a topic, of another type than expected.
    WrongType,
    /// NaN, infinite or beyond what 32 bits hold.
    NotFinite,
    /// A share beyond 0 to 1, or a code that the message's definition does not have.
    OutOfRange,
    /// Kept by the broker from earlier: nobody knows from when.
    Retained,
    /// An answer to no request of ours.
    NotAsked,
    /// A request without answer.
    NoAnswer,
    /// An answer that says that it failed, or has no body.
    Refused,
}

impl Reason {
    /// The name, as in reports.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::TooLong => "too_long",
            Self::NotJson => "not_json",
            Self::NotCdr => "not_cdr",
            Self::WrongEncoding => "wrong_encoding",
            Self::IncompatibleQos => "incompatible_qos",
            Self::UnknownRobot => "unknown_robot",
            Self::Nothing => "nothing_mapped",
            Self::WrongType => "wrong_type",
            Self::NotFinite => "not_finite",
            Self::OutOfRange => "out_of_range",
            Self::Retained => "retained",
            Self::NotAsked => "not_asked",
            Self::NoAnswer => "no_answer",
            Self::Refused => "refused",
        }
    }

    /// Whether something was lost: old messages that a broker kept are passed over, and robots that are switched off
    /// do not answer.
    const fn is_loss(self) -> bool {
        !matches!(self, Self::Retained | Self::NoAnswer)
    }
}

/// Counts by route and reason.
#[derive(Debug, Clone, Default)]
pub(crate) struct Account {
    kinds: BTreeMap<(String, Reason), Kind>,
    lost: u64,
    /// Kinds and names that were not told yet.
    news: Vec<String>,
}

#[derive(Debug, Clone, Default)]
struct Kind {
    count: u64,
    names: BTreeSet<String>,
}

/// One line of the account.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct UnmappedRecord {
    /// The topic's pattern.
    pub(crate) route: String,
    /// The reason's name.
    pub(crate) reason: &'static str,
    /// How often.
    pub(crate) count: u64,
    /// The first robots, topics or fields that it was.
    pub(crate) names: Vec<String>,
}

impl Account {
    /// Counts one; `name` is the robot, topic or field.
    pub(crate) fn count(&mut self, route: &str, reason: Reason, name: &str) {
        self.lost += u64::from(reason.is_loss());
        let is_full = self.kinds.len() >= MOST_KINDS;
        let key = (route.to_owned(), reason);
        if is_full && !self.kinds.contains_key(&key) {
            return;
        }
        let kind = self.kinds.entry(key).or_default();
        kind.count += 1;
        if kind.names.len() >= MOST_NAMES {
            return;
        }
        let name: String = name.chars().take(MOST_LETTERS).collect();
        let news = format!("{route}: {}: {name}", reason.name());
        if kind.names.insert(name) {
            self.news.push(news);
        }
    }

    /// What was counted for the first time since the last call: a line for each name that is kept.
    pub(crate) fn take_news(&mut self) -> Vec<String> {
        std::mem::take(&mut self.news)
    }

    /// How many messages or values were lost.
    pub(crate) const fn lost(&self) -> u64 {
        self.lost
    }

    /// All counts, by route and reason.
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
        let Self {
            route,
            reason,
            count,
            names,
        } = self;
        write!(out, "{route}: {reason} {count} ({})", names.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert_eq!(records[1].names[0].len(), MOST_LETTERS);
        assert_eq!(account.lost(), 1_000, "what was retained is no loss");
        for route in 0..2_000 {
            account.count(&route.to_string(), Reason::NotJson, "");
        }
        assert_eq!(account.records().len(), MOST_KINDS);
        assert_eq!(account.lost(), 3_000);
    }
}
