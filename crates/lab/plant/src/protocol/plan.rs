//! The segments of each protocol. Goal navigation has goals instead.

use super::Protocol;
use super::segment::{BACKWARD_MPS, Course, FORWARD_MPS, Segment, TURN_RADPS};
use crate::arena::Command;
use joulebus_statistics::noise::Noise;

/// Segment `number` (from 0) of a protocol. `before` is the last command of the one before.
pub(super) fn segment(
    protocol: Protocol,
    number: usize,
    before: Command,
    noise: &mut Noise,
) -> Segment {
    match protocol {
        Protocol::Structured => STRUCTURED[number % STRUCTURED.len()],
        // Goals are set instead.
        Protocol::GoalNavigation => rest(0, 1.0),
        Protocol::Acceleration => acceleration(number),
        Protocol::Extremes => EXTREMES[number % EXTREMES.len()],
        Protocol::RandomWalk => random_walk(before, noise),
        Protocol::SteadyState => STEADY_STATE[number % STEADY_STATE.len()],
    }
}

/// Number of segments after which a protocol repeats itself. 1 if segments are drawn.
pub(super) const fn segments(protocol: Protocol) -> usize {
    match protocol {
        Protocol::Structured => STRUCTURED.len(),
        Protocol::Acceleration => ACCELERATIONS,
        Protocol::Extremes => EXTREMES.len(),
        Protocol::SteadyState => STEADY_STATE.len(),
        Protocol::GoalNavigation | Protocol::RandomWalk => 1,
    }
}

pub(super) const fn rest(phase: u32, time_s: f64) -> Segment {
    held(phase, 0.0, 0.0, time_s)
}

const fn held(phase: u32, v_mps: f64, omega_radps: f64, time_s: f64) -> Segment {
    let command = Command { v_mps, omega_radps };
    ramp(phase, command, command, time_s)
}

const fn ramp(phase: u32, from: Command, to: Command, time_s: f64) -> Segment {
    Segment { phase, from, to, course: Course::Straight, time_s }
}

/// A ramp of v from one velocity to another.
const fn ramp_v(phase: u32, from_mps: f64, to_mps: f64, time_s: f64) -> Segment {
    let from = Command { v_mps: from_mps, omega_radps: 0.0 };
    let to = Command { v_mps: to_mps, omega_radps: 0.0 };
    ramp(phase, from, to, time_s)
}

/// One period of a sinusoidal path.
const fn sine(phase: u32, v_mps: f64, most_radps: f64, time_s: f64) -> Segment {
    Segment { course: Course::Sine(most_radps), ..held(phase, v_mps, 0.0, time_s) }
}

/// The velocity of a quarter turn in a second, rad/s.
const QUARTER_RADPS: f64 = std::f64::consts::FRAC_PI_2;
/// A circle of this angular velocity takes eight seconds, rad/s.
const CIRCLE_RADPS: f64 = std::f64::consts::FRAC_PI_4;

/// The eight phases in turn, 33 s each. A trial has every one once.
const STRUCTURED: [Segment; 51] = [
    // 0, idle.
    rest(0, 33.0),
    // 1, forward and backward, at two speeds.
    held(1, 0.08, 0.0, 5.0),
    rest(1, 2.0),
    held(1, -0.08, 0.0, 5.0),
    rest(1, 2.0),
    held(1, FORWARD_MPS, 0.0, 6.0),
    rest(1, 2.0),
    held(1, BACKWARD_MPS, 0.0, 6.0),
    rest(1, 5.0),
    // 2, lateral movement: to the left and back, then to the right and back.
    held(2, 0.0, QUARTER_RADPS, 1.0),
    held(2, 0.12, 0.0, 4.0),
    held(2, 0.0, -QUARTER_RADPS, 1.0),
    rest(2, 2.0),
    held(2, 0.0, -QUARTER_RADPS, 1.0),
    held(2, 0.12, 0.0, 4.0),
    held(2, 0.0, QUARTER_RADPS, 1.0),
    rest(2, 2.5),
    held(2, 0.0, -QUARTER_RADPS, 1.0),
    held(2, 0.12, 0.0, 4.0),
    held(2, 0.0, QUARTER_RADPS, 1.0),
    rest(2, 2.0),
    held(2, 0.0, QUARTER_RADPS, 1.0),
    held(2, 0.12, 0.0, 4.0),
    held(2, 0.0, -QUARTER_RADPS, 1.0),
    rest(2, 2.5),
    // 3, circular arcs.
    held(3, 0.1, CIRCLE_RADPS, 8.0),
    held(3, 0.1, -CIRCLE_RADPS, 8.0),
    held(3, 0.11, 2.0 * CIRCLE_RADPS, 8.0),
    held(3, 0.06, -CIRCLE_RADPS, 5.0),
    rest(3, 4.0),
    // 4, sinusoidal paths.
    sine(4, 0.1, 1.5, 6.0),
    sine(4, 0.1, 1.5, 6.0),
    sine(4, 0.1, 1.8, 4.0),
    sine(4, 0.1, 1.8, 4.0),
    sine(4, 0.1, -1.8, 4.0),
    rest(4, 9.0),
    // 5, velocity ramps.
    ramp_v(5, 0.0, FORWARD_MPS, 6.0),
    ramp_v(5, FORWARD_MPS, BACKWARD_MPS, 8.0),
    ramp_v(5, BACKWARD_MPS, FORWARD_MPS, 6.0),
    ramp_v(5, FORWARD_MPS, 0.0, 4.0),
    rest(5, 9.0),
    // 6, step changes.
    held(6, 0.05, 0.0, 4.0),
    held(6, 0.1, 0.0, 4.0),
    held(6, FORWARD_MPS, 0.0, 4.0),
    held(6, -0.1, 0.0, 4.0),
    held(6, 0.0, 2.0, 4.0),
    held(6, 0.0, -2.0, 4.0),
    rest(6, 9.0),
    // 7, figures of eight.
    held(7, 0.12, CIRCLE_RADPS, 8.0),
    held(7, 0.12, -CIRCLE_RADPS, 8.0),
    rest(7, 17.0),
];

/// Times of the ramps of v and ω, s, and segments of one time: forward, left, backward, right.
const TIMES_S: [f64; 5] = [4.0, 2.0, 1.0, 0.5, 0.1];
const ACCELERATIONS: usize = 16 * TIMES_S.len();

/// Phases: 0 rest, 1 v rises, 2 v holds, 3 v falls. 4 to 6 the same of ω.
fn acceleration(number: usize) -> Segment {
    let time_s = TIMES_S[number / 16 % TIMES_S.len()];
    let forward = number % 16 < 8;
    let turning = number % 8 >= 4;
    let top = Command {
        v_mps: match (turning, forward) {
            (true, _) => 0.0,
            (false, true) => FORWARD_MPS,
            (false, false) => BACKWARD_MPS,
        },
        omega_radps: match (turning, forward) {
            (false, _) => 0.0,
            (true, true) => TURN_RADPS,
            (true, false) => -TURN_RADPS,
        },
    };
    let still = Command::default();
    let phase = if turning { 3 } else { 0 };
    match number % 4 {
        0 => ramp(phase + 1, still, top, time_s),
        1 => ramp(phase + 2, top, top, 1.5),
        2 => ramp(phase + 3, top, still, time_s),
        _ => rest(0, 2.0),
    }
}

/// Phases: 0 rest, 1 greatest and least v, 2 greatest and least ω, 3 rapid reversals of v, 4 of ω,
/// 5 both together.
const EXTREMES: [Segment; 24] = [
    held(1, FORWARD_MPS, 0.0, 4.0),
    held(1, BACKWARD_MPS, 0.0, 3.0),
    rest(0, 6.0),
    held(2, 0.0, TURN_RADPS, 2.2),
    held(2, 0.0, -TURN_RADPS, 2.0),
    rest(0, 6.0),
    held(3, FORWARD_MPS, 0.0, 0.5),
    held(3, BACKWARD_MPS, 0.0, 0.5),
    held(3, FORWARD_MPS, 0.0, 0.5),
    held(3, BACKWARD_MPS, 0.0, 0.5),
    held(3, FORWARD_MPS, 0.0, 0.5),
    held(3, BACKWARD_MPS, 0.0, 0.5),
    rest(0, 5.0),
    held(4, 0.0, TURN_RADPS, 0.5),
    held(4, 0.0, -TURN_RADPS, 0.5),
    held(4, 0.0, TURN_RADPS, 0.5),
    held(4, 0.0, -TURN_RADPS, 0.5),
    rest(0, 5.0),
    held(5, 0.1, 1.8, 3.0),
    held(5, -0.1, -1.8, 2.0),
    rest(0, 5.0),
    held(1, FORWARD_MPS, 0.0, 3.0),
    held(5, FORWARD_MPS, -0.7, 3.0),
    rest(0, 6.0),
];

/// Phases: 0 rest, 1 walk. Velocities are drawn uniformly, and reached smoothly.
fn random_walk(before: Command, noise: &mut Noise) -> Segment {
    const REST_SHARE: f64 = 0.25;
    /// Maximum |ω| of the walk, rad/s.
    const MAX_WALK_RADPS: f64 = 2.0;
    let time_s = noise.between(0.5, 4.0);
    let rests = noise.uniform() < REST_SHARE;
    let v_mps = noise.between(BACKWARD_MPS, FORWARD_MPS);
    let omega_radps = noise.between(-MAX_WALK_RADPS, MAX_WALK_RADPS);
    let to = match rests {
        true => Command::default(),
        false => Command { v_mps, omega_radps },
    };
    Segment { course: Course::Smooth, ..ramp(u32::from(!rests), before, to, time_s) }
}

/// Phases number the segments: rests, circles, turns on the spot. Each lasts about a thermal time
/// constant.
const STEADY_STATE: [Segment; 8] = [
    rest(0, 33.0),
    held(1, 0.1, 0.5, 33.0),
    held(2, 0.15, -0.75, 33.0),
    rest(3, 33.0),
    held(4, 0.0, 2.0, 33.0),
    held(5, 0.12, 0.6, 33.0),
    rest(6, 33.0),
    held(7, 0.06, -1.0, 33.0),
];
