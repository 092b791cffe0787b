//! List of recently refused robots, for operators.

use joulebus_wire::{DropReason, Refusal};
use serde::{Deserialize, Serialize};

use crate::ingest::codes::refusals;

/// The newest distinct refusals (robot, reason, source), in a fixed number of entries.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Refused {
    #[serde(with = "refusals")]
    places: [Refusal; 16],
    next: u8,
}

impl Refused {
    pub(crate) fn note(&mut self, robot: u32, reason: DropReason, pid: u32) {
        let code = reason as u32 + 1;
        let known = self
            .places
            .iter_mut()
            .find(|place| place.reason == code && place.robot == robot && place.pid == pid);
        if let Some(place) = known {
            place.count = place.count.saturating_add(1);
            return;
        }
        self.places[usize::from(self.next) % self.places.len()] =
            Refusal { robot, reason: code, pid, count: 1 };
        self.next = (self.next + 1) % self.places.len() as u8;
    }

    pub(crate) fn places(&self) -> [Refusal; 16] {
        self.places
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_are_kept_and_repeats_are_counted() {
        let mut refused = Refused::default();
        for robot in 0..20 {
            for _ in 0..3 {
                refused.note(robot, DropReason::OverCapacity, 9);
            }
        }
        let mut robots: Vec<u32> = refused.places().iter().map(|place| place.robot).collect();
        robots.sort_unstable();
        assert_eq!(robots, (4..20).collect::<Vec<u32>>());
        assert!(refused.places().iter().all(|place| place.count == 3 && place.pid == 9));
    }
}
