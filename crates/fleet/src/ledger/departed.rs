//! Accounts of robots that are not in the fleet: they have left, or an earlier run wrote them down.

use serde::{Deserialize, Serialize};

use crate::layout::index::Index;
use crate::ledger::energy::Ledger;

/// One robot's account.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct Account {
    pub robot: u32,
    /// Whether it has ever been seen charging.
    pub charged: bool,
    pub ledger: Ledger,
}

/// At most as many accounts as the capacity, in columns.
#[derive(Debug)]
pub(crate) struct Departed {
    robots: Vec<u32>,
    charged: Vec<bool>,
    ledgers: Vec<Ledger>,
    place_of: Index,
    most: usize,
}

impl Departed {
    /// What an account takes beside its [`Ledger`], in bytes.
    pub(crate) const BYTES: usize = size_of::<u32>() + size_of::<bool>();

    pub(crate) fn new(most: u32) -> Self {
        let capacity = most as usize;
        Self {
            robots: Vec::with_capacity(capacity),
            charged: Vec::with_capacity(capacity),
            ledgers: Vec::with_capacity(capacity),
            place_of: Index::new(most),
            most: capacity,
        }
    }

    /// Keeps an account if there is room for it, and says whether there was. An account kept
    /// before for the same robot is replaced.
    pub(crate) fn keep(&mut self, account: Account) -> bool {
        if let Some(place) = self.place(account.robot) {
            self.charged[place] = account.charged;
            self.ledgers[place] = account.ledger;
            return true;
        }
        if self.robots.len() == self.most {
            return false;
        }
        self.place_of
            .insert(account.robot, self.robots.len() as u32);
        self.robots.push(account.robot);
        self.charged.push(account.charged);
        self.ledgers.push(account.ledger);
        true
    }

    /// Gives up a robot's account.
    pub(crate) fn take(&mut self, robot: u32) -> Option<Account> {
        let Self {
            robots, place_of, ..
        } = self;
        let place = place_of.remove(robot, |place| robots[place as usize])?;
        if let Some(last) = robots.last().copied().filter(|last| *last != robot) {
            place_of.replace(last, place, |place| robots[place as usize]);
        }
        let place = place as usize;
        Some(Account {
            robot: robots.swap_remove(place),
            charged: self.charged.swap_remove(place),
            ledger: self.ledgers.swap_remove(place),
        })
    }

    pub(crate) fn accounts(&self) -> impl Iterator<Item = Account> + '_ {
        let columns = self.robots.iter().zip(&self.charged).zip(&self.ledgers);
        columns.map(|((robot, charged), ledger)| Account {
            robot: *robot,
            charged: *charged,
            ledger: *ledger,
        })
    }

    /// Keeps `accounts` instead of those kept so far.
    pub(crate) fn replace(&mut self, accounts: &[Account]) {
        self.robots.clear();
        self.charged.clear();
        self.ledgers.clear();
        self.place_of.clear();
        for account in accounts {
            self.keep(*account);
        }
    }

    pub(crate) fn ledger(&self, robot: u32) -> Option<&Ledger> {
        self.place(robot).map(|place| &self.ledgers[place])
    }

    fn place(&self, robot: u32) -> Option<usize> {
        self.place_of
            .find(robot, |place| self.robots[place as usize])
            .map(|place| place as usize)
    }
}
