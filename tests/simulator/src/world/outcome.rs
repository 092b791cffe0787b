//! Results of a simulation.

use crate::check::Failure;
use crate::grown::Grown;

/// Results of a simulation.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub struct Outcome {
    /// Simulated time, ns.
    pub simulated_ns: u64,
    /// Ticks of all workers.
    pub ticks: u64,
    pub faults: u64,
    pub processes: u64,
    /// Captures read and computed again, and their ticks.
    pub captures: u64,
    pub verified_ticks: u64,
    /// Questions that clients were answered.
    pub questions: u64,
    /// Boards that displays and bridges have shown.
    pub boards: u64,
    /// Answers compared with those of an undisturbed run.
    pub answers: u64,
    /// By how much processes have grown at most.
    pub grown: Grown,
    /// The first invariant that did not hold.
    pub failure: Option<Failure>,
    /// The run was stopped before its end, so it has no verdict.
    pub is_stopped: bool,
}
