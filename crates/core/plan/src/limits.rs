//! What a question may be.

/// Most steps of a candidate: 9 hours at 30 Hz.
pub const MAX_STEPS: usize = 1_000_000;
/// Longest time that a command may be in force, s.
pub(crate) const LONGEST_PERIOD_S: f32 = 60.0;
/// Coverages that can be asked for.
pub(crate) const COVERAGE: (f32, f32) = (0.5, 0.999);
