//! Positions of robots in a frame.

use std::collections::HashMap;

/// Positions of robots, kept from frame to frame and checked at each use: the order of a frame
/// changes only when robots join or leave.
#[derive(Debug, Default)]
pub(crate) struct RobotIndex {
    positions: HashMap<u32, usize>,
    // The frame from which the positions were last read.
    frame: Option<u64>,
}

impl RobotIndex {
    /// The position of `robot` among the `len` robots of frame `frame`, the one at position `i`
    /// being `id(i)`. Reads the whole frame at most once, and only if the position has changed.
    pub(crate) fn position(
        &mut self,
        robot: u32,
        frame: u64,
        len: usize,
        id: impl Fn(usize) -> u32,
    ) -> Option<usize> {
        let known = |index: &Self| {
            let position = index.positions.get(&robot).copied();
            position.filter(|position| *position < len && id(*position) == robot)
        };
        if let Some(position) = known(self) {
            return Some(position);
        }
        if self.frame == Some(frame) {
            return None;
        }
        self.frame = Some(frame);
        self.positions.clear();
        self.positions.extend((0..len).rev().map(|position| (id(position), position)));
        known(self)
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn the_index_equals_a_linear_search(
            frames in prop::collection::vec(prop::collection::vec(0..12u32, 0..10), 1..12),
        ) {
            let mut index = RobotIndex::default();
            for (number, ids) in frames.iter().enumerate() {
                for robot in 0..13 {
                    let found = index.position(robot, number as u64, ids.len(), |i| ids[i]);
                    let robot_of = found.map(|position| ids[position]);
                    let searched = ids.iter().copied().find(|id| *id == robot);
                    prop_assert_eq!(robot_of, searched);
                }
            }
        }
    }

    #[test]
    fn a_frame_in_the_same_order_is_not_read_again() {
        let ids: Vec<u32> = (0..1_000).rev().collect();
        let read = Cell::new(0);
        let id = |i: usize| {
            read.set(read.get() + 1);
            ids[i]
        };
        let mut index = RobotIndex::default();
        assert_eq!(index.position(7, 1, ids.len(), id), Some(992));
        assert_eq!(read.replace(0), 1_001);
        for frame in 2..100 {
            assert_eq!(index.position(9, frame, ids.len(), id), Some(990));
        }
        assert_eq!(read.replace(0), 98);
        // Missing robots cost one pass per frame, however many they are.
        for robot in 5_000..5_100 {
            assert_eq!(index.position(robot, 100, ids.len(), id), None);
        }
        assert_eq!(read.get(), 1_000);
    }
}
