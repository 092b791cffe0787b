//! Index of robots by id: an open-addressing hash table of positions. The ids themselves are stored
//! elsewhere.

const EMPTY: u32 = u32::MAX;

/// Positions by id, in a table 1.5 times as large as its maximum number of entries, so that it
/// never grows. The ids are not in it: `id_of` returns the id at a position.
#[derive(Debug)]
pub(crate) struct Index {
    table: Vec<u32>,
}

impl Index {
    /// For at most `most` positions, each below `most`.
    pub(crate) fn new(most: u32) -> Self {
        let most = most as usize;
        Self { table: vec![EMPTY; most + most / 2 + 1] }
    }

    pub(crate) fn clear(&mut self) {
        self.table.fill(EMPTY);
    }

    /// The position of `id`, if it has one.
    pub(crate) fn find(&self, id: u32, id_of: impl Fn(u32) -> u32) -> Option<u32> {
        self.position(id, id_of).map(|position| self.table[position])
    }

    /// Adds a position for an id that has none.
    pub(crate) fn insert(&mut self, id: u32, place: u32) {
        let mut position = self.home(id);
        // There is always an empty entry: it never holds more than `most`.
        while self.table[position] != EMPTY {
            position = self.after(position);
        }
        self.table[position] = place;
    }

    /// Removes the position of `id`, and returns it.
    pub(crate) fn remove(&mut self, id: u32, id_of: impl Fn(u32) -> u32) -> Option<u32> {
        let mut hole = self.position(id, &id_of)?;
        let place = self.table[hole];
        // Backward-shift deletion: entries that follow without a gap move up, unless their home is
        // after the hole.
        let mut next = self.after(hole);
        while self.table[next] != EMPTY {
            let home = self.home(id_of(self.table[next]));
            if self.distance(home, next) >= self.distance(hole, next) {
                self.table[hole] = self.table[next];
                hole = next;
            }
            next = self.after(next);
        }
        self.table[hole] = EMPTY;
        Some(place)
    }

    /// Replaces the position of an id that has one.
    pub(crate) fn replace(&mut self, id: u32, place: u32, id_of: impl Fn(u32) -> u32) {
        if let Some(position) = self.position(id, id_of) {
            self.table[position] = place;
        }
    }

    fn position(&self, id: u32, id_of: impl Fn(u32) -> u32) -> Option<usize> {
        let mut position = self.home(id);
        loop {
            match self.table[position] {
                EMPTY => return None,
                place if id_of(place) == id => return Some(position),
                _ => position = self.after(position),
            }
        }
    }

    /// Hashes ids, which follow patterns (Murmur3's finaliser), then scales to the table's length.
    fn home(&self, id: u32) -> usize {
        let mut hash = id;
        hash = (hash ^ (hash >> 16)).wrapping_mul(0x85eb_ca6b);
        hash = (hash ^ (hash >> 13)).wrapping_mul(0xc2b2_ae35);
        hash ^= hash >> 16;
        ((u64::from(hash) * self.table.len() as u64) >> 32) as usize
    }

    fn after(&self, position: usize) -> usize {
        if position + 1 == self.table.len() { 0 } else { position + 1 }
    }

    fn distance(&self, from: usize, to: usize) -> usize {
        if to >= from { to - from } else { to + self.table.len() - from }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn it_equals_a_map_under_insertion_and_removal(
            most in 1u32..40, stride in any::<u32>(),
            steps in prop::collection::vec((any::<bool>(), 0u32..60), 0..400),
        ) {
            let (mut index, mut map) = (Index::new(most), HashMap::new());
            let (mut ids, mut free) = (vec![0; most as usize], (0..most).collect::<Vec<u32>>());
            for (joins, which) in steps {
                let id = which.wrapping_mul(stride | 1);
                if !joins {
                    let found = index.remove(id, |place| ids[place as usize]);
                    prop_assert_eq!(found, map.remove(&id));
                    free.extend(found);
                } else if !map.contains_key(&id) && let Some(place) = free.pop() {
                    ids[place as usize] = id;
                    index.insert(id, place);
                    map.insert(id, place);
                }
                for which in 0..60u32 {
                    let id = which.wrapping_mul(stride | 1);
                    let found = index.find(id, |place| ids[place as usize]);
                    prop_assert_eq!(found, map.get(&id).copied());
                }
            }
        }
    }
}
