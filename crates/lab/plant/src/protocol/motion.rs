//! Commands of each protocol, one control step after the other.

use super::segment::{BACKWARD_MPS, FORWARD_MPS, Segment};
use super::{Protocol, plan};
use crate::arena::{Command, HALF_ARENA_M, Pose, Vector, direction, wrapped};
use joulebus_statistics::noise::Noise;

/// Distance from a wall at which a robot turns back, m.
const MARGIN_M: f64 = 0.2;
/// Distance at which a goal counts as reached, m.
const ARRIVED_M: f64 = 0.04;
/// Minimum distance of goals from the walls, m.
const GOAL_MARGIN_M: f64 = 0.25;
const APPROACH_PER_S: f64 = 1.0;
const TURN_PER_S: f64 = 2.5;
/// Maximum angular velocity of goal navigation, rad/s.
const MAX_TURN_RADPS: f64 = 2.0;
/// Time at a goal before the next one, s.
const AT_GOAL_S: (f64, f64) = (1.0, 6.0);

/// State of a protocol.
#[derive(Clone, Debug)]
pub(super) struct Motion {
    protocol: Protocol,
    /// Number of segments begun so far.
    begun: usize,
    segment: Segment,
    /// Time of the segment that is over, s.
    over_s: f64,
    turned_back: bool,
    goal_m: Option<Vector>,
}

impl Motion {
    /// A protocol from a segment on, counted from 0.
    pub(super) fn new(protocol: Protocol, segment: usize) -> Self {
        Self {
            protocol,
            begun: segment,
            segment: plan::rest(0, 0.0),
            over_s: 0.0,
            turned_back: false,
            goal_m: None,
        }
    }

    /// Phase and commanded velocities at a pose, for the next `dt_s` seconds, above 0.
    pub(super) fn next(&mut self, dt_s: f64, pose: Pose, noise: &mut Noise) -> (u32, Command) {
        if let Some(goal_m) = self.goal_m {
            if let Some(command) = towards(goal_m, pose) {
                return (self.segment.phase, command);
            }
            self.goal_m = None;
            self.begin(plan::rest(0, noise.between(AT_GOAL_S.0, AT_GOAL_S.1)));
        }
        // Half a step: which of two steps ends a segment does not depend on rounding.
        if self.over_s + 0.5 * dt_s >= self.segment.time_s {
            if self.protocol == Protocol::GoalNavigation {
                self.set_goal(noise);
                return self.next(dt_s, pose, noise);
            }
            let segment = plan::segment(self.protocol, self.begun, self.segment.to, noise);
            self.begun += 1;
            // Timing errors of steps do not accumulate.
            let rest_s = self.over_s - self.segment.time_s;
            self.begin(segment);
            self.over_s = rest_s;
        }
        self.over_s += dt_s;
        let command = self.segment.command(self.over_s / self.segment.time_s);
        (self.segment.phase, self.kept_inside(command, pose))
    }

    fn begin(&mut self, segment: Segment) {
        self.segment = segment;
        self.over_s = 0.0;
        self.turned_back = false;
    }

    fn set_goal(&mut self, noise: &mut Noise) {
        let (x_m, y_m) = (HALF_ARENA_M.0 - GOAL_MARGIN_M, HALF_ARENA_M.1 - GOAL_MARGIN_M);
        self.goal_m = Some(Vector::new(noise.between(-x_m, x_m), noise.between(-y_m, y_m)));
        self.segment.phase = 1;
    }

    /// The command, with v reversed for the rest of the segment once it leads out of the arena.
    fn kept_inside(&mut self, command: Command, pose: Pose) -> Command {
        let reversed = Command { v_mps: (-command.v_mps).max(BACKWARD_MPS), ..command };
        let wanted = if self.turned_back { reversed } else { command };
        let velocity = direction(pose.theta_rad) * wanted.v_mps;
        let leads_out = |at_m: f64, half_m: f64, speed_mps: f64| {
            at_m.abs() > half_m - MARGIN_M && at_m * speed_mps > 0.0
        };
        if leads_out(pose.at_m.x, HALF_ARENA_M.0, velocity.x)
            || leads_out(pose.at_m.y, HALF_ARENA_M.1, velocity.y)
        {
            self.turned_back = !self.turned_back;
            return if self.turned_back { reversed } else { command };
        }
        wanted
    }
}

/// The command towards a goal, `None` once it is reached.
fn towards(goal_m: Vector, pose: Pose) -> Option<Command> {
    let left_m = goal_m - pose.at_m;
    let distance_m = left_m.norm();
    if distance_m < ARRIVED_M {
        return None;
    }
    let off_rad = wrapped(libm::atan2(left_m.y, left_m.x) - pose.theta_rad);
    let speed_mps = (APPROACH_PER_S * distance_m).min(FORWARD_MPS);
    Some(Command {
        v_mps: speed_mps * libm::cos(off_rad).max(0.0),
        omega_radps: (TURN_PER_S * off_rad).clamp(-MAX_TURN_RADPS, MAX_TURN_RADPS),
    })
}
