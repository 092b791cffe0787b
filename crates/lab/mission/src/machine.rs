//! A robot with its true battery.

use joulebus_plan::Point;
use joulebus_plan::follow::{Follower, Pose};
use joulebus_plant::arena::Command;
use joulebus_plant::driven::Driven;
use joulebus_wire::{Sample, sample_flag};

use crate::scenario::{Made, SPEED_MPS};

/// Distance at which a point is reached, m: as in plans.
const REACH_M: f64 = 0.05;
/// Maximum time for which a path is simulated ahead, ns.
const MAX_AHEAD_NS: u64 = 600_000_000_000;

/// True if a robot has reached its goal.
pub(crate) fn is_reached(at: Point, goal: Point) -> bool {
    (at.x_m - goal.x_m).hypot(at.y_m - goal.y_m) <= REACH_M
}

/// Power supplied to a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Fed {
    Nothing,
    /// Its own load, at a waiting place.
    Load,
    /// Its own load and this much more.
    Charge {
        power_w: f64,
    },
}

/// A robot with its true battery, which no policy sees.
#[derive(Clone, Debug)]
pub(crate) struct Machine {
    driven: Driven,
    gain: f64,
    capacity_j: f64,
    stored_j: f64,
    drawn_j: f64,
    charged_j: f64,
    /// When it is switched on, ns.
    on_ns: u64,
    command: Command,
    samples: u64,
    is_empty: bool,
}

impl Machine {
    /// Full, switched on at a time, ns.
    pub(crate) fn new(made: Made, on_ns: u64) -> Self {
        Self {
            driven: made.driven,
            gain: made.gain,
            capacity_j: made.capacity_j,
            stored_j: made.capacity_j,
            drawn_j: 0.0,
            charged_j: 0.0,
            on_ns,
            command: Command::default(),
            samples: 0,
            is_empty: false,
        }
    }

    pub(crate) fn is_on(&self, now_ns: u64) -> bool {
        now_ns >= self.on_ns && !self.is_empty
    }

    /// True if its battery ran empty.
    pub(crate) fn is_empty(&self) -> bool {
        self.is_empty
    }

    pub(crate) fn is_full(&self) -> bool {
        self.stored_j >= self.capacity_j
    }

    pub(crate) fn pose(&self) -> Pose {
        let pose = self.driven.pose();
        Pose { at: Point::new(pose.at_m.x, pose.at_m.y), heading_rad: pose.theta_rad }
    }

    /// Drives and discharges for `dt_ns`, with the power supplied in that time.
    pub(crate) fn step(&mut self, command: Command, dt_ns: u64, fed: Fed) {
        self.command = self.driven.drive(command, dt_ns);
        let drawn_j = self.driven.drawn_j();
        let load_j = drawn_j - self.drawn_j;
        self.stored_j -= load_j;
        self.drawn_j = drawn_j;
        let offered_j = match fed {
            Fed::Nothing => 0.0,
            Fed::Load => load_j,
            Fed::Charge { power_w } => load_j + power_w * dt_ns as f64 * 1e-9,
        };
        let added_j = offered_j.min((self.capacity_j - self.stored_j).max(0.0));
        self.stored_j += added_j;
        self.charged_j += added_j;
        self.is_empty = self.stored_j <= 0.0;
    }

    /// The sample that its controller publishes: command, reading, and whether it charges.
    pub(crate) fn sample(&mut self, robot: u32, now_ns: u64, is_charging: bool) -> Sample {
        let (v_mps, omega_radps) = (self.command.v_mps as f32, self.command.omega_radps as f32);
        let measured_ns = self.on_ns + self.driven.measured_ns();
        let shown_w = self.gain * self.driven.power_w();
        let sample = Sample::new(robot, self.samples, now_ns)
            .command(v_mps, omega_radps)
            .reading(shown_w as f32, measured_ns);
        self.samples += 1;
        let when = |holds: bool, flag: u32| if holds { flag } else { 0 };
        sample
            .with(when(!self.driven.is_fresh(), sample_flag::HELD))
            .with(when(is_charging, sample_flag::CHARGING))
            .with(when(is_charging && self.is_full(), sample_flag::FULL))
    }

    /// Energy that is in the battery without being accounted for, J.
    pub(crate) fn unaccounted_j(&self) -> f64 {
        self.stored_j - (self.capacity_j + self.charged_j - self.drawn_j)
    }

    /// Energy drawn so far according to the robot's own monitor, J.
    pub(crate) fn shown_j(&self) -> f64 {
        self.gain * self.drawn_j
    }

    /// Energy that is really in its battery, J.
    pub(crate) const fn stored_j(&self) -> f64 {
        self.stored_j
    }

    /// Energy that it will really draw on a path and then at rest for a time, J, including any drag
    /// that starts meanwhile. It drives a copy of the robot ahead. Infinite if the end is not
    /// reached within ten minutes.
    pub(crate) fn draws_j(
        &self,
        way: &[Point],
        then_ns: u64,
        follower: &Follower,
        dt_ns: u64,
    ) -> f64 {
        let mut ahead = self.clone();
        let (mut next, mut driven_ns) = (0, 0);
        while driven_ns < MAX_AHEAD_NS {
            let pose = ahead.pose();
            if way.get(next).is_some_and(|goal| is_reached(pose.at, *goal)) {
                next += 1;
            }
            let Some(goal) = way.get(next) else {
                ahead.driven.drive(Command::default(), then_ns);
                return ahead.driven.drawn_j() - self.driven.drawn_j();
            };
            let (v_mps, omega_radps) = follower.command(&pose, *goal, SPEED_MPS);
            let command = Command { v_mps: v_mps.into(), omega_radps: omega_radps.into() };
            ahead.driven.drive(command, dt_ns);
            driven_ns += dt_ns;
        }
        f64::INFINITY
    }

    pub(crate) fn soc(&self) -> f64 {
        (self.stored_j / self.capacity_j).max(0.0)
    }
}
