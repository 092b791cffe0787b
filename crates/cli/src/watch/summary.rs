//! Summary of a planner.

use std::cell::RefCell;
use std::fmt;

use joulebus_board::{Board, Latency, Reading};
use joulebus_bus::{clock, set_timer_slack};
use joulebus_config::Config;
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;
use joulebus_program::stop::Stop;
use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct PlannerReport {
    pub(crate) frames: u64,
    /// Frames overwritten before it read them.
    pub(crate) frames_missed: u64,
    pub(crate) workers: usize,
    /// Latency from a sample sent to its forecast readable.
    pub(crate) latency: Latency,
}

/// Reads until the end and reports.
pub(super) fn run(
    config: &Config,
    output: Output,
    stop: &Stop,
    end_ns: u64,
) -> anyhow::Result<Outcome> {
    if let Err(error) = set_timer_slack() {
        tracing::warn!(%error, "waking may take 50 µs longer");
    }
    let board = RefCell::new(Board::new(clock::monotonic_ns()));
    let mut reading = Reading::open(config, "planner", false)?;
    while !stop.is_asked() && clock::monotonic_ns() < end_ns {
        reading.poll(|| board.borrow_mut())?;
    }
    let board = board.borrow();
    output.report(&PlannerReport {
        frames: board.frames,
        frames_missed: board.frames_missed,
        workers: board.workers(),
        latency: board.stages.latency(),
    })?;
    Ok(Outcome::Done)
}

impl fmt::Display for PlannerReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (frames, missed, workers) = (self.frames, self.frames_missed, self.workers);
        writeln!(out, "frames: {frames} read, {missed} missed, of {workers} workers")?;
        write!(out, "{}", self.latency)
    }
}
