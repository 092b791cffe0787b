//! Motion of the robots: from waypoint to waypoint with pauses, as in a coverage experiment.

use crate::arena::{Command, OMEGA_MAX_RADPS, Pose, V_MAX_MPS, Vector, direction, wrapped};
use joulebus_statistics::noise::Noise;
use std::f64::consts::PI;

const ARENA_M: (f64, f64) = (3.2, 2.0);
const ARRIVED_M: f64 = 0.03;
const PAUSE_MEAN_S: f64 = 5.0;
const SLOWEST_MPS: f64 = 0.05;
const REVERSE_SHARE: f64 = 0.35;
const APPROACH_PER_S: f64 = 1.0;
const TURN_PER_S: f64 = 2.2;
const WANDER_RADPS: f64 = 1.8;
const WANDER_TIME_S: f64 = 1.0;
const V_SLEW_MPS2: f64 = 0.5;
const OMEGA_SLEW_RADPS2: f64 = 12.0;

#[derive(Clone, Copy, Debug)]
enum Leg {
    Pause {
        left_s: f64,
    },
    Drive {
        goal_m: Vector,
        speed_mps: f64,
        reverse: bool,
    },
}

/// A robot's pose, its current leg and command.
#[derive(Clone, Debug)]
pub(super) struct Mission {
    pose: Pose,
    leg: Leg,
    wander_radps: f64,
    command: Command,
}

impl Mission {
    pub(super) fn new(noise: &mut Noise) -> Mission {
        Mission {
            pose: Pose {
                at_m: place(noise),
                theta_rad: noise.between(-PI, PI),
            },
            leg: Leg::Pause {
                left_s: noise.waiting_s(PAUSE_MEAN_S),
            },
            wander_radps: 0.0,
            command: Command::default(),
        }
    }

    pub(super) fn command(&self) -> Command {
        self.command
    }

    /// Moves the robot under the current command.
    pub(super) fn drive(&mut self, dt_s: f64) {
        let Command { v_mps, omega_radps } = self.command;
        let Pose { at_m, theta_rad } = &mut self.pose;
        *at_m += direction(*theta_rad) * (v_mps * dt_s);
        *theta_rad = wrapped(*theta_rad + omega_radps * dt_s);
    }

    /// The controller's decision at a tick, `dt_s` after the one before.
    pub(super) fn issue(&mut self, dt_s: f64, noise: &mut Noise) {
        let wanted = self.wanted(dt_s, noise);
        let v_slew_mps = V_SLEW_MPS2 * dt_s;
        let omega_slew_radps = OMEGA_SLEW_RADPS2 * dt_s;
        let Command { v_mps, omega_radps } = self.command;
        self.command = Command {
            v_mps: wanted.v_mps.clamp(v_mps - v_slew_mps, v_mps + v_slew_mps),
            omega_radps: wanted.omega_radps.clamp(
                omega_radps - omega_slew_radps,
                omega_radps + omega_slew_radps,
            ),
        };
    }

    fn wanted(&mut self, dt_s: f64, noise: &mut Noise) -> Command {
        match self.leg {
            Leg::Pause { left_s } if left_s > dt_s => {
                self.leg = Leg::Pause {
                    left_s: left_s - dt_s,
                };
                Command::default()
            }
            Leg::Pause { .. } => {
                self.leg = Leg::Drive {
                    goal_m: place(noise),
                    speed_mps: noise.between(SLOWEST_MPS, V_MAX_MPS),
                    reverse: noise.uniform() < REVERSE_SHARE,
                };
                Command::default()
            }
            Leg::Drive {
                goal_m,
                speed_mps,
                reverse,
            } => {
                let left_m = goal_m - self.pose.at_m;
                let distance_m = left_m.norm();
                if distance_m < ARRIVED_M {
                    self.leg = Leg::Pause {
                        left_s: noise.waiting_s(PAUSE_MEAN_S),
                    };
                }
                let kept = libm::exp(-dt_s / WANDER_TIME_S);
                self.wander_radps = self.wander_radps * kept
                    + WANDER_RADPS * libm::sqrt(1.0 - kept * kept) * noise.normal();
                let behind = if reverse { PI } else { 0.0 };
                let error_rad =
                    wrapped(libm::atan2(left_m.y, left_m.x) + behind - self.pose.theta_rad);
                let speed_mps = speed_mps.min(APPROACH_PER_S * distance_m);
                let v_mps = speed_mps * libm::cos(error_rad).max(0.0);
                let omega_radps = TURN_PER_S * error_rad + self.wander_radps;
                Command {
                    v_mps: if reverse { -v_mps } else { v_mps },
                    omega_radps: omega_radps.clamp(-OMEGA_MAX_RADPS, OMEGA_MAX_RADPS),
                }
            }
        }
    }
}

/// A random position in the arena.
fn place(noise: &mut Noise) -> Vector {
    Vector::new(noise.between(0.0, ARENA_M.0), noise.between(0.0, ARENA_M.1))
}
