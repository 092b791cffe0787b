//! Limits of questions.

/// Maximum number of steps of a candidate: 9 hours at 30 Hz.
pub const MAX_STEPS: usize = 1_000_000;
/// Maximum time for which a command may be in force, s.
pub(crate) const MAX_PERIOD_S: f32 = 60.0;
/// Coverages that can be asked for.
pub(crate) const COVERAGE: (f32, f32) = (0.5, 0.999);
