//! Accounts of robots that are not in the fleet: departed, or saved by an earlier run.

use serde::{Deserialize, Serialize};

use crate::layout::index::Index;
use crate::layout::shift::Shift;
use crate::ledger::battery::Known;
use crate::ledger::energy::Ledger;

/// One robot's account.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct Account {
    pub robot: u32,
    /// True if it has ever been seen charging.
    pub charged: bool,
    pub ledger: Ledger,
    pub battery: Known,
}

impl Account {
    /// An account that has not begun.
    pub(crate) fn new(robot: u32) -> Self {
        Self { robot, charged: false, ledger: Ledger::default(), battery: Known::Nothing }
    }

    /// Moves the instants to another clock.
    pub(crate) fn shift(&mut self, shift: Shift) {
        let Self { robot: _, charged: _, ledger, battery } = self;
        ledger.shift(shift);
        match battery {
            Known::Kept(kept) => _ = kept.shift_instants(shift),
            // Without instants.
            Known::Nothing | Known::Saved(..) => {}
        }
    }
}

/// Words of [`Departed::lost`].
pub(crate) const LOST_WORDS: usize = (1 << u16::BITS) / u64::BITS as usize;

/// Ring buffer of accounts in columns, with a fixed capacity. The account dropped for another one
/// is among the oldest.
#[derive(Debug)]
pub(crate) struct Departed {
    robots: Vec<u32>,
    charged: Vec<bool>,
    ledgers: Vec<Ledger>,
    /// Empty unless a platform has a battery.
    batteries: Vec<Known>,
    place_of: Index,
    /// Index of the oldest account, and the number of accounts.
    oldest: usize,
    len: usize,
    given_up: u64,
    /// Robots whose account was dropped in this run or in an earlier one, a bit for the last 16
    /// bits of their ids. It may name others, but never leaves one out.
    lost: Vec<u64>,
}

impl Departed {
    /// Size of an account in addition to its [`Ledger`], if no platform has a battery, bytes.
    pub(crate) const BYTES: usize = size_of::<u32>() + size_of::<bool>();

    /// `batteries`: whether a platform has a battery.
    pub(crate) fn new(most: u32, batteries: bool) -> Self {
        let places = most as usize;
        Self {
            robots: vec![0; places],
            charged: vec![false; places],
            ledgers: vec![Ledger::default(); places],
            batteries: vec![Known::Nothing; if batteries { places } else { 0 }],
            place_of: Index::new(most),
            oldest: 0,
            len: 0,
            given_up: 0,
            lost: vec![0; LOST_WORDS],
        }
    }

    /// Stores an account and replaces one of the same robot. If the buffer is full, the oldest one
    /// is dropped. Returns true if none was.
    pub(crate) fn keep(&mut self, account: Account) -> bool {
        let known = self.place(account.robot);
        let room = known.is_some() || self.has_room_for(0);
        if !room {
            let oldest = self.robots[self.oldest];
            self.take(oldest);
            self.given_up += 1;
            self.lose(oldest as u16);
        }
        let place = known.unwrap_or_else(|| {
            let place = self.after(self.len);
            self.place_of.insert(account.robot, place as u32);
            self.len += 1;
            place
        });
        self.robots[place] = account.robot;
        self.charged[place] = account.charged;
        self.ledgers[place] = account.ledger;
        if let Some(battery) = self.batteries.get_mut(place) {
            *battery = account.battery;
        }
        room
    }

    /// True if an account of another robot takes no other's place, also if so many more are kept.
    pub(crate) const fn has_room_for(&self, more: usize) -> bool {
        self.len + more < self.robots.len()
    }

    /// Removes a robot's account. The oldest one moves to its index.
    pub(crate) fn take(&mut self, robot: u32) -> Option<Account> {
        let Self { robots, place_of, .. } = self;
        let place = place_of.remove(robot, |place| robots[place as usize])?;
        let (oldest, first) = (self.oldest, robots[self.oldest]);
        if first != robot {
            place_of.replace(first, place, |place| robots[place as usize]);
        }
        let place = place as usize;
        let account = self.account(place);
        self.robots[place] = first;
        self.charged[place] = self.charged[oldest];
        self.ledgers[place] = self.ledgers[oldest];
        if !self.batteries.is_empty() {
            self.batteries[place] = self.batteries[oldest];
        }
        self.oldest = self.after(1);
        self.len -= 1;
        Some(account)
    }

    /// All accounts, the oldest first.
    pub(crate) fn accounts(&self) -> impl Iterator<Item = Account> + '_ {
        (0..self.len).map(|nth| self.account(self.after(nth)))
    }

    /// Replaces all accounts by `accounts`, the oldest first.
    pub(crate) fn replace(&mut self, accounts: &[Account]) {
        self.place_of.clear();
        (self.oldest, self.len) = (0, 0);
        for account in accounts {
            self.keep(*account);
        }
    }

    pub(crate) fn ledger(&self, robot: u32) -> Option<&Ledger> {
        self.place(robot).map(|place| &self.ledgers[place])
    }

    /// The accounts of robots whose ids end with these bits are lost.
    pub(crate) fn lose(&mut self, ids: u16) {
        self.lost[usize::from(ids / 64)] |= 1 << (ids % 64);
    }

    /// True if a robot without an account may have had one.
    pub(crate) fn is_lost(&self, robot: u32) -> bool {
        let ids = robot as u16;
        self.lost[usize::from(ids / 64)] & (1 << (ids % 64)) != 0
    }

    /// All lost robots, for [`Departed::replace_lost`]. Empty if there is none.
    pub(crate) fn lost(&self) -> &[u64] {
        let any = self.lost.iter().any(|word| *word != 0);
        if any { &self.lost } else { &[] }
    }

    pub(crate) fn replace_lost(&mut self, lost: &[u64]) {
        self.lost.fill(0);
        self.lost[..lost.len()].copy_from_slice(lost);
    }

    /// Number of accounts dropped for others.
    pub(crate) const fn given_up(&self) -> u64 {
        self.given_up
    }

    /// Index of the `nth` account from the oldest one.
    fn after(&self, nth: usize) -> usize {
        let (place, places) = (self.oldest + nth, self.robots.len());
        if place < places { place } else { place - places }
    }

    fn account(&self, place: usize) -> Account {
        Account {
            robot: self.robots[place],
            charged: self.charged[place],
            ledger: self.ledgers[place],
            battery: self.batteries.get(place).copied().unwrap_or_default(),
        }
    }

    fn place(&self, robot: u32) -> Option<usize> {
        self.place_of.find(robot, |place| self.robots[place as usize]).map(|place| place as usize)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeSet, VecDeque};

    use proptest::prelude::*;

    use super::*;

    fn account(robot: u32, stamp_ns: u64) -> Account {
        Account {
            robot,
            charged: stamp_ns.is_multiple_of(3),
            ledger: Ledger::restored((1, 2), 3, 4, 5, stamp_ns),
            battery: Known::Nothing,
        }
    }

    proptest! {
        #[test]
        fn it_keeps_the_same_accounts_as_a_queue_for_any_order_of_departures(
            most in 1u32..20,
            steps in prop::collection::vec((any::<bool>(), 0u32..40), 0..400),
        ) {
            let (mut departed, mut queue) = (Departed::new(most, false), VecDeque::new());
            let (mut given_up, mut lost) = (0, BTreeSet::new());
            for (at, (leaves, robot)) in steps.into_iter().enumerate() {
                let known = queue.iter().position(|account: &Account| account.robot == robot);
                if leaves {
                    let account = account(robot, at as u64);
                    let room = known.is_some() || queue.len() < most as usize;
                    match known {
                        Some(known) => queue[known] = account,
                        None => {
                            given_up += u64::from(!room);
                            lost.extend(queue.drain(..usize::from(!room)).map(|account| account.robot));
                            queue.push_back(account);
                        }
                    }
                    prop_assert_eq!(departed.keep(account), room);
                } else {
                    let taken = departed.take(robot);
                    prop_assert_eq!(taken.map(|account| account.ledger), known.map(|index| queue[index].ledger));
                    if let Some(known) = known {
                        queue.swap(0, known);
                        queue.pop_front();
                    }
                }
                let parts = |account: Account| (account.robot, account.charged, account.ledger);
                let kept: Vec<_> = departed.accounts().map(parts).collect();
                let expected: Vec<_> = queue.iter().copied().map(parts).collect();
                prop_assert_eq!(kept, expected);
                for robot in 0..40 {
                    let found = departed.ledger(robot).copied();
                    let queued = queue.iter().find(|account| account.robot == robot);
                    let queued = queued.map(|account| account.ledger);
                    prop_assert_eq!(found, queued);
                    prop_assert_eq!(departed.is_lost(robot), lost.contains(&robot));
                }
            }
            prop_assert_eq!(departed.given_up(), given_up);
            let accounts: Vec<_> = departed.accounts().collect();
            let mut again = Departed::new(most, false);
            again.replace(&accounts);
            prop_assert_eq!(again.accounts().count(), accounts.len());
            again.lose(77);
            again.replace_lost(departed.lost());
            prop_assert_eq!((again.lost(), again.is_lost(77)), (departed.lost(), false));
        }
    }
}
