//! Which slots are in use.

use std::ops::Range;

use crate::columns::BLOCKS;
use crate::lanes::LANES;

/// Slots in one word.
pub(crate) const WORD: usize = u64::BITS as usize;

/// A bit per slot. The lowest free slot is given first, so that robots lie close together in
/// memory, and in the order in which their source first named them.
#[derive(Debug)]
pub(crate) struct Slots {
    words: Vec<u64>,
    capacity: usize,
    used: usize,
    /// Slots that have ever been in use: all below.
    reach: usize,
    /// No word before this one has a free slot.
    first_free: usize,
}

impl Slots {
    pub(crate) fn new(capacity: usize) -> Self {
        Self {
            words: vec![0; capacity.div_ceil(WORD)],
            capacity,
            used: 0,
            reach: 0,
            first_free: 0,
        }
    }

    /// Takes the lowest free slot, if there is one.
    pub(crate) fn take(&mut self) -> Option<usize> {
        if self.used == self.capacity {
            return None;
        }
        while self.words[self.first_free] == u64::MAX {
            self.first_free += 1;
        }
        let word = &mut self.words[self.first_free];
        let bit = word.trailing_ones();
        *word |= 1 << bit;
        self.used += 1;
        let slot = self.first_free * WORD + bit as usize;
        self.reach = self.reach.max(slot + 1);
        Some(slot)
    }

    /// Gives back a slot in use.
    pub(crate) fn free(&mut self, slot: usize) {
        self.words[slot / WORD] &= !(1 << (slot % WORD));
        self.used -= 1;
        self.first_free = self.first_free.min(slot / WORD);
    }

    pub(crate) fn used(&self) -> usize {
        self.used
    }

    pub(crate) fn reach(&self) -> usize {
        self.reach
    }

    /// Has just these slots in use, all below the capacity, and all that ever were below `reach`.
    pub(crate) fn replace(&mut self, reach: usize, slots: impl Iterator<Item = usize>) {
        self.words.fill(0);
        (self.used, self.reach, self.first_free) = (0, reach, 0);
        for slot in slots {
            self.words[slot / WORD] |= 1 << (slot % WORD);
            self.used += 1;
        }
    }

    pub(crate) fn words(&self) -> &[u64] {
        &self.words
    }

    /// The slot in use that has `place` others before it.
    pub(crate) fn at(&self, place: usize) -> Option<usize> {
        let mut before = 0;
        for (index, word) in self.words.iter().enumerate() {
            let here = word.count_ones() as usize;
            if place < before + here {
                return slots(&[*word])
                    .nth(place - before)
                    .map(|slot| index * WORD + slot);
            }
            before += here;
        }
        None
    }

    /// The slots in use, ascending.
    pub(crate) fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        slots(&self.words)
    }
}

/// The set bits of words, ascending.
pub(crate) fn slots(words: &[u64]) -> impl Iterator<Item = usize> + '_ {
    words.iter().enumerate().flat_map(|(index, word)| Bits {
        word: *word,
        first: index * WORD,
    })
}

/// The blocks of 16 slots that have one in use, each with a bit for every slot that is.
#[inline(always)]
pub(crate) fn blocks(words: &[u64]) -> impl Iterator<Item = (usize, u16)> + '_ {
    let all = words.iter().enumerate().flat_map(|(index, word)| {
        let lanes = move |part: usize| (*word >> (part * LANES)) as u16;
        (0..BLOCKS).map(move |part| (index * BLOCKS + part, lanes(part)))
    });
    all.filter(|(_, lanes)| *lanes != 0)
}

/// The set bits of a block, ascending.
#[inline(always)]
pub(crate) fn bits(lanes: u16) -> impl Iterator<Item = usize> {
    Bits {
        word: lanes.into(),
        first: 0,
    }
}

/// How many slots of these words are in use.
pub(crate) fn count(words: &[u64]) -> usize {
    words.iter().map(|word| word.count_ones() as usize).sum()
}

/// Words that hold the first `robots` slots in use.
pub(crate) fn words_of(words: &[u64], robots: usize) -> Range<usize> {
    let mut before = 0;
    let end = words.iter().position(|word| {
        let reached = before >= robots;
        before += word.count_ones() as usize;
        reached
    });
    0..end.unwrap_or(words.len())
}

struct Bits {
    word: u64,
    first: usize,
}

impl Iterator for Bits {
    type Item = usize;

    #[inline]
    fn next(&mut self) -> Option<usize> {
        if self.word == 0 {
            return None;
        }
        let bit = self.word.trailing_zeros() as usize;
        self.word &= self.word - 1;
        Some(self.first + bit)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn the_lowest_free_slot_is_given_and_places_count_the_slots_before(
            capacity in 1usize..200, moves in prop::collection::vec(any::<(bool, u8)>(), 0..600),
        ) {
            let (mut slots, mut set) = (Slots::new(capacity), BTreeSet::new());
            for (take, which) in moves {
                if take {
                    let lowest = (0..capacity).find(|slot| !set.contains(slot));
                    prop_assert_eq!(slots.take(), lowest);
                    set.extend(lowest);
                } else if set.remove(&usize::from(which)) {
                    slots.free(which.into());
                }
                prop_assert_eq!(slots.used(), set.len());
                prop_assert_eq!(slots.iter().collect::<BTreeSet<usize>>(), set.clone());
            }
            for (place, slot) in set.iter().enumerate() {
                prop_assert_eq!(slots.at(place), Some(*slot));
            }
            prop_assert_eq!(slots.at(set.len()), None);
            for robots in 0..=set.len() {
                let words = words_of(slots.words(), robots);
                let held = count(&slots.words()[words.clone()]);
                prop_assert!(held >= robots);
                prop_assert!(words.end == 0 || count(&slots.words()[..words.end - 1]) < robots);
            }
        }
    }
}
