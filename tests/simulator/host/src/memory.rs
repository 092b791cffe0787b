//! Memory of the simulated processes: what each has allocated and not freed.
//!
//! An allocator asks here for the account of an allocation, keeps the answer with it, and returns
//! it when the allocation is freed, by whomever.

use std::cell::Cell;

use crate::current::{FIRST_PID, current};

/// Accounts: one per pid, for pids of a small range, and the first one for all else.
const ACCOUNTS: usize = 64;

/// The account of an allocation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Account(u8);

impl Account {
    pub const fn byte(self) -> u8 {
        self.0
    }

    /// The account of [`Account::byte`].
    pub const fn of_byte(byte: u8) -> Self {
        Self(byte % ACCOUNTS as u8)
    }

    const fn new(pid: u32) -> Self {
        let first = FIRST_PID;
        match pid.checked_sub(first) {
            Some(place) if place + 1 < ACCOUNTS as u32 => Self(place as u8 + 1),
            _ => Self(0),
        }
    }
}

thread_local! {
    static LIVE: [Cell<i64>; ACCOUNTS] = const { [const { Cell::new(0) }; ACCOUNTS] };
    /// Allocations of now lie on the disk, or in shared memory.
    static IS_OUTSIDE: Cell<bool> = const { Cell::new(false) };
}

/// Records an allocation of the current process. Allocates nothing.
pub fn allocated(bytes: usize) -> Account {
    // Locals are gone while a thread ends.
    let is_outside = IS_OUTSIDE.try_with(Cell::get).unwrap_or(true);
    let account = if is_outside { Account(0) } else { Account::new(current()) };
    add(account, bytes as i64);
    account
}

/// Records the end of an allocation. Allocates nothing.
pub fn freed(account: Account, bytes: usize) {
    add(account, -(bytes as i64));
}

fn add(account: Account, bytes: i64) {
    let _ = LIVE.try_with(|live| {
        let live = &live[usize::from(account.0)];
        live.set(live.get() + bytes);
    });
}

/// Bytes that the process `pid`, and earlier ones with its pid, have allocated and not freed.
pub fn live(pid: u32) -> i64 {
    LIVE.with(|live| live[usize::from(Account::new(pid).0)].get())
}

/// Runs `work`, whose allocations are not the process's, but the disk's or shared memory's.
pub fn outside<T>(work: impl FnOnce() -> T) -> T {
    /// Also when the process is killed in between.
    struct Back(bool);
    impl Drop for Back {
        fn drop(&mut self) {
            IS_OUTSIDE.set(self.0);
        }
    }
    let _back = Back(IS_OUTSIDE.replace(true));
    work()
}
