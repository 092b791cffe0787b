//! The newest budgets of robots, for verbs that look once.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::time::Duration;

use joulebus_board::{Board, Reading};
use joulebus_bus::clock;
use joulebus_config::Config;
use joulebus_wire::Budget;

/// The newest budgets of these robots, of all if none is named, and whether a worker was seen.
pub(crate) fn budgets(
    config: &Config,
    name: &str,
    robots: &[u32],
    patience: Duration,
) -> anyhow::Result<(Vec<Budget>, bool)> {
    let board = RefCell::new(Board::new(clock::monotonic_ns()));
    let mut reading = Reading::open(config, name, false)?;
    let give_up_ns = clock::monotonic_ns() + patience.as_nanos() as u64;
    let mut found = Vec::new();
    while found.is_empty() && clock::monotonic_ns() < give_up_ns {
        reading.poll(|| board.borrow_mut())?;
        let board = board.borrow();
        let rows = board.rows.values().filter_map(|row| row.budget);
        let is_wanted = |budget: &Budget| robots.is_empty() || robots.contains(&budget.robot);
        found = rows.filter(is_wanted).collect();
    }
    Ok((found, board.into_inner().header().is_some()))
}

/// The robots of which a worker sends forecasts. Empty without a worker.
pub(crate) fn present(
    config: &Config,
    name: &str,
    patience: Duration,
) -> anyhow::Result<BTreeSet<u32>> {
    let board = RefCell::new(Board::new(clock::monotonic_ns()));
    let mut reading = Reading::open(config, name, false)?;
    let give_up_ns = clock::monotonic_ns() + patience.as_nanos() as u64;
    while board.borrow().rows.is_empty() && clock::monotonic_ns() < give_up_ns {
        reading.poll(|| board.borrow_mut())?;
    }
    Ok(board.into_inner().rows.into_keys().collect())
}
