//! Allocation of robot slots by a bitmap.

use std::ops::Range;

use crate::layout::lanes::LANES;

/// Slots in one word.
pub(crate) const WORD: usize = u64::BITS as usize;

/// Blocks of 16 slots in one word.
pub(crate) const BLOCKS: usize = WORD / LANES;

/// One bit per slot. The lowest free slot is assigned first, so that robots are dense in memory,
/// and in the order in which their source first listed them, but robots of different platforms get
/// separate blocks while there are empty ones, because a block is processed once per platform in
/// it.
#[derive(Debug)]
pub(crate) struct Slots {
    words: Vec<u64>,
    capacity: usize,
    used: usize,
    /// Upper bound of the slots ever used.
    reach: usize,
    /// By platform, the lower bound of the platform's blocks with a free slot. It only speeds up
    /// the search.
    look: Vec<usize>,
}

impl Slots {
    pub(crate) fn new(capacity: usize, platforms: usize) -> Self {
        Self {
            words: vec![0; capacity.div_ceil(WORD)],
            capacity,
            used: 0,
            reach: 0,
            look: vec![0; platforms],
        }
    }

    /// Allocates a slot for a robot of this platform, if one is free. `platform_at` returns the
    /// platform of the robot in a slot.
    pub(crate) fn take(
        &mut self,
        platform: u16,
        platform_at: impl Fn(usize) -> u16,
    ) -> Option<usize> {
        if self.used == self.capacity {
            return None;
        }
        let blocks = self.capacity.div_ceil(LANES);
        let of_platform = usize::from(platform);
        let own = (self.look[of_platform]..blocks).find(|block| {
            let lanes = lanes(&self.words, *block);
            let first = block * LANES + lanes.trailing_zeros() as usize;
            self.free_in(*block).is_some() && (lanes == 0 || platform_at(first) == platform)
        });
        self.look[of_platform] = own.unwrap_or(blocks);
        // If no block is empty, platforms share.
        let block = own.or_else(|| (0..blocks).find(|block| self.free_in(*block).is_some()))?;
        let slot = self.free_in(block)?;
        self.words[slot / WORD] |= 1 << (slot % WORD);
        self.used += 1;
        self.reach = self.reach.max(slot + 1);
        Some(slot)
    }

    /// The lowest free slot of a block.
    fn free_in(&self, block: usize) -> Option<usize> {
        let slot = block * LANES + lanes(&self.words, block).trailing_ones() as usize;
        (slot < self.capacity.min(block * LANES + LANES)).then_some(slot)
    }

    /// Frees a slot in use.
    pub(crate) fn free(&mut self, slot: usize) {
        self.words[slot / WORD] &= !(1 << (slot % WORD));
        self.used -= 1;
        for look in &mut self.look {
            *look = (*look).min(slot / LANES);
        }
    }

    pub(crate) fn used(&self) -> usize {
        self.used
    }

    pub(crate) fn reach(&self) -> usize {
        self.reach
    }

    /// Marks exactly these slots as used, all below the capacity. All slots ever used were below
    /// `reach`.
    pub(crate) fn replace(&mut self, reach: usize, slots: impl Iterator<Item = usize>) {
        self.words.fill(0);
        (self.used, self.reach) = (0, reach);
        self.look.fill(0);
        for slot in slots {
            self.words[slot / WORD] |= 1 << (slot % WORD);
            self.used += 1;
        }
    }

    pub(crate) fn words(&self) -> &[u64] {
        &self.words
    }

    /// The slot in use with `place` used slots before it.
    pub(crate) fn at(&self, place: usize) -> Option<usize> {
        let mut before = 0;
        for (index, word) in self.words.iter().enumerate() {
            let here = word.count_ones() as usize;
            if place < before + here {
                return slots(&[*word]).nth(place - before).map(|slot| index * WORD + slot);
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
    words.iter().enumerate().flat_map(|(index, word)| Bits { word: *word, first: index * WORD })
}

/// Used slots of a block, one bit each.
fn lanes(words: &[u64], block: usize) -> u16 {
    (words[block / BLOCKS] >> (block % BLOCKS * LANES)) as u16
}

/// The blocks of 16 slots with a used one, each with its bits.
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
    Bits { word: lanes.into(), first: 0 }
}

/// Number of used slots in these words.
pub(crate) fn count(words: &[u64]) -> usize {
    words.iter().map(|word| word.count_ones() as usize).sum()
}

/// Words that hold the first `robots` used slots.
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
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    /// The result of [`Slots::take`] by linear search.
    fn expected(set: &BTreeMap<usize, u16>, capacity: usize, platform: u16) -> Option<usize> {
        let free = |slot: &usize| !set.contains_key(slot);
        let for_it = |slot: &usize| {
            let first = slot / LANES * LANES;
            let owner = set.range(first..first + LANES).next();
            owner.is_none_or(|(_, owner)| *owner == platform)
        };
        let own = (0..capacity).filter(free).find(for_it);
        own.or_else(|| (0..capacity).find(free))
    }

    proptest! {
        #[test]
        fn the_lowest_free_slot_of_the_platforms_blocks_is_assigned_and_places_are_ranks(
            capacity in 1usize..200, steps in prop::collection::vec(any::<(bool, u8, u8)>(), 0..600),
        ) {
            const PLATFORMS: u16 = 3;
            let mut slots = Slots::new(capacity, PLATFORMS.into());
            let mut set = BTreeMap::new();
            for (take, which, platform) in steps {
                if take {
                    let platform = u16::from(platform) % PLATFORMS;
                    let found = slots.take(platform, |slot| set[&slot]);
                    prop_assert_eq!(found, expected(&set, capacity, platform));
                    set.extend(found.map(|slot| (slot, platform)));
                } else if set.remove(&usize::from(which)).is_some() {
                    slots.free(which.into());
                }
                prop_assert_eq!(slots.used(), set.len());
                prop_assert!(slots.iter().eq(set.keys().copied()));
            }
            for (place, slot) in set.keys().enumerate() {
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
