//! Commands of each protocol, step by step.

use super::Protocol;
use crate::arena::{Command, HALF_ARENA_M, Pose, STEP_S, V_MAX_MPS, Vector, direction, wrapped};
use joulebus_statistics::noise::Noise;

/// Distance from a wall at which a robot turns back, m.
const MARGIN_M: f64 = 0.2;
/// Distance at which a goal counts as reached, m.
const ARRIVED_M: f64 = 0.04;
/// Minimum distance of goals from the walls, m.
const GOAL_MARGIN_M: f64 = 0.25;
const APPROACH_PER_S: f64 = 1.0;
const TURN_PER_S: f64 = 2.5;
/// Maximum linear velocity of goal navigation, m/s.
const GOAL_MPS: f64 = 0.12;
/// Maximum angular velocity of goal navigation, rad/s.
const TURN_MOST_RADPS: f64 = 2.0;

/// A segment of time with a linearly interpolated command.
#[derive(Clone, Copy, Debug)]
struct Segment {
    phase: u32,
    from: Command,
    to: Command,
    steps: u32,
}

/// State of a protocol.
#[derive(Clone, Debug)]
pub(super) struct Motion {
    protocol: Protocol,
    /// Number of segments, or goals, begun so far.
    begun: u32,
    segment: Segment,
    step: u32,
    turned_back: bool,
    goal_m: Option<Vector>,
}

impl Motion {
    pub(super) fn new(protocol: Protocol) -> Self {
        Self {
            protocol,
            begun: 0,
            segment: held(0, 0.0, 0.0, 1.0),
            step: 0,
            turned_back: false,
            goal_m: None,
        }
    }

    /// Phase and commanded velocities at a pose, one step after the last call.
    pub(super) fn next(&mut self, pose: Pose, noise: &mut Noise) -> (u32, Command) {
        if let Some(goal_m) = self.goal_m {
            if let Some(command) = towards(goal_m, pose) {
                return (self.segment.phase, command);
            }
            self.goal_m = None;
            self.begin(held(0, 0.0, 0.0, noise.between(1.0, 6.0)));
        }
        if self.step >= self.segment.steps {
            if self.protocol == Protocol::GoalNavigation {
                self.set_goal(noise);
                return self.next(pose, noise);
            }
            let segment = self.following(noise);
            self.begin(segment);
        }
        let command = self.in_stretch();
        self.step += 1;
        (self.segment.phase, self.kept_inside(command, pose))
    }

    fn begin(&mut self, segment: Segment) {
        self.segment = segment;
        self.step = 0;
        self.turned_back = false;
    }

    fn set_goal(&mut self, noise: &mut Noise) {
        let (x_m, y_m) = (
            HALF_ARENA_M.0 - GOAL_MARGIN_M,
            HALF_ARENA_M.1 - GOAL_MARGIN_M,
        );
        self.goal_m = Some(Vector::new(
            noise.between(-x_m, x_m),
            noise.between(-y_m, y_m),
        ));
        self.segment.phase = 1;
    }

    fn following(&mut self, noise: &mut Noise) -> Segment {
        let number = self.begun;
        self.begun += 1;
        match self.protocol {
            // `next` sets its goals.
            Protocol::GoalNavigation => self.segment,
            Protocol::Structured => structured(number),
            Protocol::Acceleration => acceleration(number),
            Protocol::Extremes => extremes(number),
            Protocol::RandomWalk => random_walk(noise),
            Protocol::SteadyState => steady_state(number),
        }
    }

    fn in_stretch(&self) -> Command {
        let Segment {
            from, to, steps, ..
        } = self.segment;
        let share = f64::from(self.step + 1) / f64::from(steps);
        let between = |from: f64, to: f64| from + (to - from) * share;
        Command {
            v_mps: between(from.v_mps, to.v_mps),
            omega_radps: between(from.omega_radps, to.omega_radps),
        }
    }

    /// The command, with v reversed for the rest of the segment once it leads out of the arena.
    fn kept_inside(&mut self, command: Command, pose: Pose) -> Command {
        let reversed = Command {
            v_mps: -command.v_mps,
            ..command
        };
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

/// A constant command for a time.
fn held(phase: u32, v_mps: f64, omega_radps: f64, time_s: f64) -> Segment {
    let command = Command { v_mps, omega_radps };
    ramp(phase, command, command, time_s)
}

fn ramp(phase: u32, from: Command, to: Command, time_s: f64) -> Segment {
    let steps = (libm::round(time_s / STEP_S) as u32).max(1);
    Segment {
        phase,
        from,
        to,
        steps,
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
    let speed_mps = (APPROACH_PER_S * distance_m).min(GOAL_MPS);
    Some(Command {
        v_mps: speed_mps * libm::cos(off_rad).max(0.0),
        omega_radps: (TURN_PER_S * off_rad).clamp(-TURN_MOST_RADPS, TURN_MOST_RADPS),
    })
}

/// Phases: 0 rest, 1 forward, 2 backward, 3 left, 4 right, 5 arc left, 6 arc right.
fn structured(number: u32) -> Segment {
    const SPEEDS_MPS: [f64; 4] = [0.04, 0.08, 0.12, 0.2];
    const TURNS_RADPS: [f64; 4] = [0.5, 1.0, 2.0, 3.0];
    let level = (number / 10) as usize % 4;
    let (v, omega) = (SPEEDS_MPS[level], TURNS_RADPS[level]);
    match number % 10 {
        0 => held(1, v, 0.0, 5.0),
        2 => held(2, -v, 0.0, 3.0),
        3 => held(3, 0.0, omega, 4.4),
        5 => held(4, 0.0, -omega, 4.0),
        6 => held(5, v, 0.5 * omega, 4.0),
        8 => held(6, v, -0.5 * omega, 4.0),
        _ => held(0, 0.0, 0.0, 2.0),
    }
}

/// Phases: 0 rest, 1 v rises, 2 v holds, 3 v falls; 4 to 6 the same of ω.
fn acceleration(number: u32) -> Segment {
    const TIMES_S: [f64; 5] = [4.0, 2.0, 1.0, 0.5, 0.1];
    let time_s = TIMES_S[(number / 16) as usize % 5];
    let forward = number % 16 < 8;
    let turning = number % 8 >= 4;
    let top = Command {
        v_mps: match (turning, forward) {
            (true, _) => 0.0,
            (false, true) => 0.7 * V_MAX_MPS,
            (false, false) => -0.6 * V_MAX_MPS,
        },
        omega_radps: match (turning, forward) {
            (false, _) => 0.0,
            (true, true) => 3.0,
            (true, false) => -3.0,
        },
    };
    let still = Command::default();
    let phase = if turning { 3 } else { 0 };
    match number % 4 {
        0 => ramp(phase + 1, still, top, time_s),
        1 => ramp(phase + 2, top, top, 1.5),
        2 => ramp(phase + 3, top, still, time_s),
        _ => held(0, 0.0, 0.0, 2.0),
    }
}

/// Phases: 0 rest, 1 full speed, 2 full turn, 3 both.
fn extremes(number: u32) -> Segment {
    match number % 14 {
        0 => held(1, 0.2, 0.0, 4.0),
        1 => held(1, -0.2, 0.0, 3.0),
        3 => held(2, 0.0, 3.6, 2.2),
        4 => held(2, 0.0, -3.6, 2.0),
        6 => held(3, 0.1, 1.8, 3.0),
        7 => held(3, -0.1, -1.8, 2.0),
        9 => held(1, 0.2, 0.0, 1.0),
        10 => held(1, -0.2, 0.0, 0.5),
        11 => held(1, 0.2, 0.0, 1.0),
        12 => held(3, 0.15, -0.9, 3.0),
        _ => held(0, 0.0, 0.0, 6.0),
    }
}

/// Phases: 0 rest, 1 walk.
fn random_walk(noise: &mut Noise) -> Segment {
    let time_s = noise.between(0.5, 4.0);
    if noise.uniform() < 0.2 {
        return held(0, 0.0, 0.0, time_s);
    }
    let v_mps = (0.04 + 0.08 * noise.normal()).clamp(-V_MAX_MPS, V_MAX_MPS);
    held(1, v_mps, 0.15 + 1.2 * noise.normal(), time_s)
}

/// Phases number the segments of a cycle: rests, straights, circles, turns.
fn steady_state(number: u32) -> Segment {
    let place = number % 8;
    let (v_mps, omega_radps) = match place {
        1 => (0.1, 0.5),
        2 => (0.15, -0.75),
        4 => (0.0, 2.0),
        5 => (0.12, 0.6),
        7 => (0.06, -1.0),
        _ => (0.0, 0.0),
    };
    held(place, v_mps, omega_radps, 12.0)
}
