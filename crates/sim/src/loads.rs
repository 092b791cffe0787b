//! What one robot draws, from poll to poll of its power monitor.
//!
//! Wheels turn in continuous time, under each command. Everything that only the monitor can see is
//! advanced when it is polled, a fixed tenth of a second apart: that is exact for drifts and for
//! thermal memory, and puts the ends of radio bursts on the monitor's grid.

use super::arena::{Command, wheels_mps};
use super::monitor::POLL_S;
use super::parts::Parts;
use joulebus_statistics::noise::Noise;

/// Bursts of one robot at the same time; a further one is not heard.
const MOST_BURSTS: usize = 8;
/// No burst draws more than this many times the mean one.
const MOST_OF_A_BURST: f64 = 4.0;
/// A wheel slower than this is at rest, m/s.
const REST_MPS: f64 = 0.005;
/// A wheel told to turn faster than this starts, m/s.
const START_MPS: f64 = 0.02;
/// Draws from manufacturing are kept within this many standard deviations.
const WIDEST: f64 = 2.5;

/// What is left of a drift, or of thermal memory, after a poll.
#[derive(Clone, Copy, Debug)]
struct Kept {
    drift: f64,
    processor: f64,
    roughness: f64,
    thermal: f64,
    burst: f64,
    no_burst: f64,
}

/// The electrical loads of one robot.
#[derive(Clone, Debug)]
pub(super) struct Loads {
    parts: Parts,
    kept: Kept,
    electronics_w: f64,
    friction: [f64; 2],
    drift: f64,
    processor: f64,
    roughness: f64,
    warm_w: f64,
    wheels_mps: [f64; 2],
    motors_j: f64,
    motors_s: f64,
    bursts_w: [f64; MOST_BURSTS],
    stuck: bool,
}

impl Loads {
    /// The loads of a robot at rest. `made` gives what manufacturing gave the robot, `noise` its
    /// state at the start; `extra_w` is drawn on top indefinitely; `neighbours` share its channel.
    pub(super) fn new(
        parts: Parts,
        extra_w: f64,
        neighbours: usize,
        made: &mut Noise,
        noise: &mut Noise,
    ) -> Self {
        let mut spread = || made.normal().clamp(-WIDEST, WIDEST);
        let busy = 1.0 + parts.burst_cut_per_neighbour * neighbours as f64;
        let bursts_per_s = parts.bursts_per_s + parts.bursts_per_neighbour_s * neighbours as f64;
        Self {
            parts,
            kept: Kept {
                drift: libm::exp(-POLL_S / parts.drift_time_s),
                processor: libm::exp(-POLL_S / parts.processor_time_s),
                roughness: libm::exp(-POLL_S / parts.roughness_time_s),
                thermal: libm::exp(-POLL_S / parts.thermal_time_s),
                burst: libm::exp(-POLL_S * busy / parts.burst_time_s),
                no_burst: libm::exp(-POLL_S * bursts_per_s),
            },
            electronics_w: parts.electronics_w + parts.electronics_spread_w * spread() + extra_w,
            friction: std::array::from_fn(|_| 1.0 + parts.friction_spread * spread()),
            drift: noise.normal(),
            processor: noise.normal(),
            roughness: noise.normal(),
            warm_w: 0.0,
            wheels_mps: [0.0; 2],
            motors_j: 0.0,
            motors_s: 0.0,
            bursts_w: [0.0; MOST_BURSTS],
            stuck: false,
        }
    }

    /// A new command: a wheel that starts from rest may stick.
    pub(super) fn command(&mut self, command: Command, noise: &mut Noise) {
        for (speed_mps, wanted_mps) in self.wheels_mps.into_iter().zip(wheels_mps(command)) {
            if speed_mps.abs() < REST_MPS && wanted_mps.abs() > START_MPS {
                self.stuck |= noise.uniform() < self.parts.stall_chance;
            }
        }
    }

    /// Turns the wheels for `dt_s` seconds, above 0, towards the command.
    pub(super) fn turn(&mut self, dt_s: f64, command: Command) {
        let reached = 1.0 - libm::exp(-dt_s / self.parts.motor_time_s);
        for ((speed_mps, wanted_mps), friction) in self
            .wheels_mps
            .iter_mut()
            .zip(wheels_mps(command))
            .zip(self.friction)
        {
            let before_mps = *speed_mps;
            *speed_mps += (wanted_mps - before_mps) * reached;
            let mean_mps = 0.5 * (before_mps.abs() + speed_mps.abs());
            let rolling_w = self.parts.friction_w_per_mps * mean_mps
                + self.parts.losses_w_per_m2ps2 * mean_mps * mean_mps;
            let gained_m2ps2 = *speed_mps * *speed_mps - before_mps * before_mps;
            self.motors_j += friction * rolling_w * dt_s
                + self.parts.acceleration_w_per_m2ps3 * gained_m2ps2.max(0.0);
        }
        self.motors_s += dt_s;
    }

    /// What is drawn at a poll, a poll after the last one, W. The motors' part is their mean over
    /// that time, as the monitor averages it.
    pub(super) fn poll(&mut self, noise: &mut Noise) -> f64 {
        let Kept {
            drift,
            processor,
            roughness,
            thermal,
            ..
        } = self.kept;
        self.drift = drifted(self.drift, drift, noise);
        self.processor = drifted(self.processor, processor, noise);
        self.roughness = drifted(self.roughness, roughness, noise);
        let smooth_w = if self.motors_s > 0.0 {
            self.motors_j / self.motors_s
        } else {
            0.0
        };
        (self.motors_j, self.motors_s) = (0.0, 0.0);
        let motors_w = smooth_w * (1.0 + self.parts.roughness * self.roughness).max(0.0);
        self.warm_w = motors_w + (self.warm_w - motors_w) * thermal;
        let stuck_w = if self.stuck { self.parts.stall_w } else { 0.0 };
        self.stuck = false;
        self.electronics_w
            + self.parts.drift_w * self.drift
            + self.parts.processor_w * self.processor * self.processor
            + motors_w
            + self.parts.thermal_share * self.warm_w
            + self.radio_w(noise)
            + stuck_w
    }

    /// Ends and begins bursts; what those that continue draw, W.
    fn radio_w(&mut self, noise: &mut Noise) -> f64 {
        let mut radio_w = 0.0;
        let mut begins = noise.uniform() >= self.kept.no_burst;
        for burst_w in &mut self.bursts_w {
            if *burst_w > 0.0 && noise.uniform() >= self.kept.burst {
                *burst_w = 0.0;
            } else if *burst_w == 0.0 && begins {
                let mean_w = self.parts.burst_w;
                *burst_w = noise.waiting_s(mean_w).min(MOST_OF_A_BURST * mean_w);
                begins = false;
            }
            radio_w += *burst_w;
        }
        radio_w
    }
}

/// A step of a mean-reverting drift of mean 0 and deviation 1 of which `kept` stays.
pub(super) fn drifted(value: f64, kept: f64, noise: &mut Noise) -> f64 {
    value * kept + libm::sqrt(1.0 - kept * kept) * noise.normal()
}
