//! Where the robots go: from waypoint to waypoint with pauses, as in a coverage experiment.

use crate::arena::{OMEGA_MAX_RADPS, V_MAX_MPS};
use joulebus_statistics::noise::Noise;
use std::f64::consts::{PI, TAU};

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

/// Velocities in force.
#[derive(Clone, Copy, Debug)]
pub(super) struct Command {
    pub(super) v_mps: f64,
    pub(super) omega_radps: f64,
}

#[derive(Clone, Copy, Debug)]
enum Leg {
    Pause {
        left_s: f64,
    },
    Drive {
        x_m: f64,
        y_m: f64,
        speed_mps: f64,
        reverse: bool,
    },
}

/// A robot's pose, its current leg and the command in force.
#[derive(Clone, Debug)]
pub(super) struct Mission {
    x_m: f64,
    y_m: f64,
    heading_rad: f64,
    leg: Leg,
    wander_radps: f64,
    command: Command,
}

impl Mission {
    pub(super) fn new(noise: &mut Noise) -> Mission {
        Mission {
            x_m: noise.between(0.0, ARENA_M.0),
            y_m: noise.between(0.0, ARENA_M.1),
            heading_rad: noise.between(-PI, PI),
            leg: Leg::Pause {
                left_s: noise.waiting_s(PAUSE_MEAN_S),
            },
            wander_radps: 0.0,
            command: Command {
                v_mps: 0.0,
                omega_radps: 0.0,
            },
        }
    }

    pub(super) fn command(&self) -> Command {
        self.command
    }

    /// QuantileStep the robot under the command in force.
    pub(super) fn drive(&mut self, dt_s: f64) {
        let Command { v_mps, omega_radps } = self.command;
        self.x_m += v_mps * dt_s * libm::cos(self.heading_rad);
        self.y_m += v_mps * dt_s * libm::sin(self.heading_rad);
        self.heading_rad = wrapped(self.heading_rad + omega_radps * dt_s);
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
                Command {
                    v_mps: 0.0,
                    omega_radps: 0.0,
                }
            }
            Leg::Pause { .. } => {
                self.leg = Leg::Drive {
                    x_m: noise.between(0.0, ARENA_M.0),
                    y_m: noise.between(0.0, ARENA_M.1),
                    speed_mps: noise.between(SLOWEST_MPS, V_MAX_MPS),
                    reverse: noise.uniform() < REVERSE_SHARE,
                };
                Command {
                    v_mps: 0.0,
                    omega_radps: 0.0,
                }
            }
            Leg::Drive {
                x_m,
                y_m,
                speed_mps,
                reverse,
            } => {
                let (dx_m, dy_m) = (x_m - self.x_m, y_m - self.y_m);
                let distance_m = libm::sqrt(dx_m * dx_m + dy_m * dy_m);
                if distance_m < ARRIVED_M {
                    self.leg = Leg::Pause {
                        left_s: noise.waiting_s(PAUSE_MEAN_S),
                    };
                }
                let kept = libm::exp(-dt_s / WANDER_TIME_S);
                self.wander_radps = self.wander_radps * kept
                    + WANDER_RADPS * libm::sqrt(1.0 - kept * kept) * noise.normal();
                let behind = if reverse { PI } else { 0.0 };
                let error_rad = wrapped(libm::atan2(dy_m, dx_m) + behind - self.heading_rad);
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

/// The same angle within ±π, for angles that are at most a few turns off.
fn wrapped(angle_rad: f64) -> f64 {
    angle_rad - TAU * libm::round(angle_rad / TAU)
}
