//! The robots' names in other systems, and their ids in the fleet.

use std::collections::{BTreeMap, HashMap};
use std::ops::RangeInclusive;

const MAX_BYTES: usize = 128;
const MAX_RANGE: u32 = 100_000;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum RobotsError {
    #[error("is no name: 1 to {MAX_BYTES} bytes without / + # and control characters")]
    Name,
    #[error("is given to robot {first} and to robot {second}")]
    TwoIds { first: u32, second: u32 },
    #[error("gives a second name to robot {robot}, which is {first:?} already")]
    TwoNames { robot: u32, first: String },
    #[error(
        "has {found:?}, allowed are an id (7), or with {{id}} in the name a range (\"0-19\") of \
         at most {MAX_RANGE}"
    )]
    Ids { found: String },
}

/// A bijection between names and ids.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Robots {
    ids: HashMap<String, u32>,
    names: BTreeMap<u32, String>,
}

impl Robots {
    /// Adds a robot. With `{id}` in the name it adds one for each id of a range such as `0-19`.
    pub(crate) fn add(&mut self, name: &str, ids: &str) -> Result<(), RobotsError> {
        let range = range(ids).filter(|ids| ids.start() == ids.end() || name.contains("{id}"));
        let range = range.ok_or_else(|| RobotsError::Ids { found: ids.to_owned() })?;
        range.into_iter().try_for_each(|id| self.insert(name.replace("{id}", &id.to_string()), id))
    }

    fn insert(&mut self, name: String, id: u32) -> Result<(), RobotsError> {
        if !is_name(&name) {
            return Err(RobotsError::Name);
        }
        if let Some(first) = self.ids.get(&name) {
            let (first, second) = (*first, id);
            return Err(RobotsError::TwoIds { first, second });
        }
        if let Some(first) = self.names.get(&id) {
            let first = first.clone();
            return Err(RobotsError::TwoNames { robot: id, first });
        }
        self.ids.insert(name.clone(), id);
        self.names.insert(id, name);
        Ok(())
    }

    pub(crate) fn id(&self, name: &str) -> Option<u32> {
        self.ids.get(name).copied()
    }

    pub(crate) fn name(&self, id: u32) -> Option<&str> {
        self.names.get(&id).map(String::as_str)
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (u32, &str)> {
        self.names.iter().map(|(id, name)| (*id, name.as_str()))
    }

    pub(crate) fn len(&self) -> usize {
        self.names.len()
    }
}

/// True if the text can be a name. Names are levels of topics, so they contain neither wildcards
/// nor separators.
fn is_name(name: &str) -> bool {
    let is_bad =
        |letter: char| matches!(letter, '/' | '+' | '#' | '{' | '}') || letter.is_control();
    (1..=MAX_BYTES).contains(&name.len()) && !name.contains(is_bad)
}

fn range(text: &str) -> Option<RangeInclusive<u32>> {
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    let (first, last): (u32, u32) = (first.trim().parse().ok()?, last.trim().parse().ok()?);
    (first <= last && last - first < MAX_RANGE).then_some(first..=last)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_ids_are_one_to_one() {
        let mut robots = Robots::default();
        robots.add("agv-{id}", "8-10").unwrap();
        robots.add("lifter", "3").unwrap();
        for (name, id) in [("agv-8", 8), ("agv-10", 10), ("lifter", 3)] {
            assert_eq!(robots.id(name), Some(id));
            assert_eq!(robots.name(id), Some(name));
        }
        assert_eq!((robots.len(), robots.id("agv-11"), robots.name(11)), (4, None, None));
        assert_eq!(robots.add("lifter", "4"), Err(RobotsError::TwoIds { first: 3, second: 4 }));
        assert!(matches!(robots.add("other", "9"), Err(RobotsError::TwoNames { robot: 9, .. })));
    }

    #[test]
    fn what_is_no_name_or_no_range_is_refused() {
        for name in ["", "a/b", "+", "#", "a\0", "a{b", &"x".repeat(129)] {
            assert_eq!(Robots::default().add(name, "1"), Err(RobotsError::Name), "{name:?}");
        }
        for ids in ["", "x", "-1", "3-1", "1-2-3", "0-100000", "4294967296"] {
            let refused = Robots::default().add("r{id}", ids);
            assert!(matches!(refused, Err(RobotsError::Ids { .. })), "{ids:?}");
        }
        assert!(Robots::default().add("one", "1-2").is_err(), "two robots of one name");
    }
}
