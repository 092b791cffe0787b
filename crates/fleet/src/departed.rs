//! Accounts of robots that are not in the fleet: they have left, or an earlier run wrote them down.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};

use crate::Ledger;

/// One robot's account.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct Account {
    pub robot: u32,
    /// Whether it has ever been seen charging.
    pub charged: bool,
    pub ledger: Ledger,
}

/// As many accounts as there is room for robots.
#[derive(Debug)]
pub(crate) struct Departed {
    accounts: Vec<Account>,
    place_of: HashMap<u32, u32>,
    most: usize,
}

impl Departed {
    pub(crate) fn new(most: u32) -> Self {
        let most = most as usize;
        Self {
            accounts: Vec::with_capacity(most),
            // Twice what it holds: the map then never grows, however often robots come and go.
            place_of: HashMap::with_capacity(2 * most),
            most,
        }
    }

    /// Keeps an account if there is room for it, and says whether there was. An account kept
    /// before for the same robot is replaced.
    pub(crate) fn keep(&mut self, account: Account) -> bool {
        if let Some(place) = self.place_of.get(&account.robot) {
            self.accounts[*place as usize] = account;
            return true;
        }
        if self.accounts.len() == self.most {
            return false;
        }
        self.place_of
            .insert(account.robot, self.accounts.len() as u32);
        self.accounts.push(account);
        true
    }

    /// Gives up a robot's account.
    pub(crate) fn take(&mut self, robot: u32) -> Option<Account> {
        let place = self.place_of.remove(&robot)?;
        let account = self.accounts.swap_remove(place as usize);
        if let Some(moved) = self.accounts.get(place as usize) {
            self.place_of.insert(moved.robot, place);
        }
        Some(account)
    }

    pub(crate) fn accounts(&self) -> &[Account] {
        &self.accounts
    }

    /// Keeps `accounts` instead of those kept so far.
    pub(crate) fn replace(&mut self, accounts: &[Account]) {
        self.accounts.clear();
        self.place_of.clear();
        for account in accounts {
            self.keep(*account);
        }
    }

    pub(crate) fn ledger(&self, robot: u32) -> Option<&Ledger> {
        let place = self.place_of.get(&robot)?;
        Some(&self.accounts[*place as usize].ledger)
    }
}
