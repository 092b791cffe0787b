//! Segments: a command for a time.

use crate::arena::Command;

/// Greatest and least velocities that are commanded, m/s and rad/s: the paper's.
pub(super) const FORWARD_MPS: f64 = 0.16;
pub(super) const BACKWARD_MPS: f64 = -0.15;
#[allow(clippy::approx_constant, reason = "the paper states 3.14, not π")]
pub(super) const TURN_RADPS: f64 = 3.14;

/// Course of a segment's command from its first to its last value.
#[derive(Clone, Copy, Debug)]
pub(super) enum Course {
    /// Along a straight line.
    Straight,
    /// Smoothly: without a change of slope at either end.
    Smooth,
    /// Along a straight line, and ω about it in one period of a sine of this amplitude, rad/s.
    Sine(f64),
}

/// A segment of time and its command.
#[derive(Clone, Copy, Debug)]
pub(super) struct Segment {
    pub(super) phase: u32,
    pub(super) from: Command,
    pub(super) to: Command,
    pub(super) course: Course,
    pub(super) time_s: f64,
}

impl Segment {
    /// The command at a share of the segment's time.
    pub(super) fn command(&self, share: f64) -> Command {
        let share = share.min(1.0);
        let (way, swing_radps) = match self.course {
            Course::Straight => (share, 0.0),
            Course::Smooth => (share * share * (3.0 - 2.0 * share), 0.0),
            Course::Sine(most_radps) => {
                let angle_rad = std::f64::consts::TAU * share;
                (share, most_radps * libm::sin(angle_rad))
            }
        };
        let between = |from: f64, to: f64| from + (to - from) * way;
        Command {
            v_mps: between(self.from.v_mps, self.to.v_mps),
            omega_radps: between(self.from.omega_radps, self.to.omega_radps) + swing_radps,
        }
    }
}
