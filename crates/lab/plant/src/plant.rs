//! A live fleet of simulated GTernal robots, each of which drives the paper's protocols.
//!
//! The robots are those of the trials: the same loads and the same power monitor
//! ([`Parts`], fitted to the figures of arXiv 2603.13908). Each has its own manufacturing
//! variation, and drives in an arena and on a radio channel of its own, as the paper's robot did in
//! the trials.
//!
//! The same seed gives the same bits on every machine: only basic arithmetic, square roots and the
//! portable functions of `libm`.

use crate::arena::{Command, saturated};
use crate::body::Body;
use crate::fault::Fault;
use crate::parts::Parts;
use crate::protocol::{Driver, Protocol, TRIAL_S};
use joulebus_statistics::noise::Noise;
use thiserror::Error;

const MAX_STEP_S: f64 = 1.0;

/// Random streams of one robot: manufacturing variation, state, motion.
const STREAMS: u64 = 3;
/// Random streams of the robots of [`Plant::new`] and of [`Plant::driving`].
const FLEET: u64 = 7 << 32;
const DRIVING: u64 = 8 << 32;

/// A controller's knowledge at one control tick: the latest reading of a robot and the command that
/// it has just issued, which holds until the next tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimReading {
    /// Index of the robot in the fleet.
    pub robot: usize,
    /// Commanded linear velocity, m/s, within ±[`V_MAX_MPS`](crate::arena::V_MAX_MPS).
    pub v_mps: f32,
    /// Commanded angular velocity, rad/s, within
    /// ±[`OMEGA_MAX_RADPS`](crate::arena::OMEGA_MAX_RADPS).
    pub omega_radps: f32,
    /// Power of the latest measurement, W, a multiple of 10 mW.
    pub power_w: f32,
    /// Battery voltage of the latest measurement, V.
    pub voltage_v: f32,
    /// Battery current of the latest measurement, A.
    pub current_a: f32,
    /// True if an earlier tick already returned this measurement.
    pub held: bool,
    /// When it was measured, ns since the plant's start.
    pub measured_ns: u64,
}

/// Errors of configuring a plant.
#[derive(Debug, Error, PartialEq)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum PlantError {
    #[error("fault for robot {robot}, the fleet has {robots}: allowed are 0 to {robots} - 1")]
    UnknownRobot { robot: usize, robots: usize },
}

/// A fleet of simulated robots.
#[derive(Clone, Debug)]
pub struct Plant {
    robots: Vec<Robot>,
    readings: Vec<SimReading>,
    now_ns: u64,
}

impl Plant {
    /// A fleet at time 0, each robot at rest. Robot `i` begins with the protocol of trial
    /// `i % 6 + 1`, at a random segment of it, and continues with the next one after each
    /// [`TRIAL_S`]. Robot `i` of a seed is the same whatever the size of the fleet.
    pub fn new(seed: u64, robots: usize) -> Self {
        let protocols = Protocol::ALL.into_iter().cycle().take(robots);
        Self::of(protocols.enumerate().map(|(robot, protocol)| {
            let stream = FLEET + STREAMS * robot as u64;
            Robot::new(seed, stream, protocol, Turn::EveryProtocol)
        }))
    }

    /// A fleet at time 0 with one robot for each given protocol, which it repeats all the time.
    /// They are other robots than those of [`Plant::new`], also with the same seed.
    pub fn driving(seed: u64, protocols: impl IntoIterator<Item = Protocol>) -> Self {
        let protocols = protocols.into_iter().enumerate();
        Self::of(protocols.map(|(robot, protocol)| {
            let stream = DRIVING + STREAMS * robot as u64;
            Robot::new(seed, stream, protocol, Turn::One)
        }))
    }

    /// The same fleet, whose robots from `robot` on drive their protocols as fast as their wheels
    /// turn: [`V_MAX_MPS`](crate::arena::V_MAX_MPS) forwards and backwards, as fast on the spot.
    #[must_use]
    pub fn at_full_speed_from(mut self, robot: usize) -> Self {
        for robot in self.robots.iter_mut().skip(robot) {
            robot.driver = robot.driver.clone().at_full_speed();
        }
        self
    }

    fn of(robots: impl Iterator<Item = Robot>) -> Self {
        let robots: Vec<Robot> = robots.collect();
        let readings = robots.iter().enumerate();
        let readings = readings.map(|(i, robot)| robot.reading(i, true)).collect();
        Self { robots, readings, now_ns: 0 }
    }

    /// Adds a fault to a robot from a time on, s since the plant's start. A robot can have several.
    ///
    /// # Errors
    /// [`PlantError::UnknownRobot`].
    pub fn with_fault(
        mut self,
        robot: usize,
        fault: Fault,
        from_s: f64,
    ) -> Result<Self, PlantError> {
        let robots = self.robots.len();
        let Some(faulty) = self.robots.get_mut(robot) else {
            return Err(PlantError::UnknownRobot { robot, robots });
        };
        faulty.body.fail(fault, from_s);
        Ok(self)
    }

    /// Advances time by `dt_s` seconds and returns, per robot in order, the reading that the
    /// controller has just received and the command that it has then issued. A step that is not
    /// positive has no effect, a step beyond one second is clamped to one second.
    pub fn step(&mut self, dt_s: f64) -> &[SimReading] {
        if dt_s > 0.0 {
            let dt_s = dt_s.min(MAX_STEP_S);
            let end_ns = self.now_ns + libm::round(dt_s * 1e9) as u64;
            for (i, (robot, reading)) in self.robots.iter_mut().zip(&mut self.readings).enumerate()
            {
                let measured_ns = robot.body.measured_ns;
                robot.body.run(self.now_ns, end_ns, robot.command);
                robot.issue(dt_s);
                *reading = robot.reading(i, robot.body.measured_ns == measured_ns);
            }
            self.now_ns = end_ns;
        }
        &self.readings
    }

    /// Same as [`Plant::step`], up to a time since the plant's start, ns, in steps of at most one
    /// second. The steps are part of what determines the readings, like the seed.
    pub fn advance(&mut self, until_ns: u64) -> &[SimReading] {
        while self.now_ns < until_ns {
            self.step((until_ns - self.now_ns) as f64 / 1e9);
        }
        &self.readings
    }

    /// Energy that each robot has really drawn from its battery, in order, J, also before the
    /// start. It advances with the polls of the power monitor, ten times a second.
    pub fn drawn_j(&self) -> impl Iterator<Item = f64> {
        self.robots.iter().map(|robot| robot.body.drawn_j())
    }

    /// Nanoseconds since the plant's start.
    pub fn now_ns(&self) -> u64 {
        self.now_ns
    }
}

/// The protocols of a robot.
#[derive(Clone, Copy, Debug)]
enum Turn {
    One,
    EveryProtocol,
}

#[derive(Clone, Debug)]
struct Robot {
    body: Body,
    driver: Driver,
    command: Command,
    turn: Turn,
    /// Time until the next protocol, s.
    left_s: f64,
}

impl Robot {
    fn new(seed: u64, stream: u64, protocol: Protocol, turn: Turn) -> Self {
        let mut made = Noise::new(seed, stream);
        let state = Noise::new(seed, stream + 1);
        let (mut driver, pose) = Driver::new(protocol, Noise::new(seed, stream + 2));
        if let Turn::EveryProtocol = turn {
            driver.begin_anywhere();
        }
        let body = Body::new(Parts::default(), 0.0, 0, pose, &mut made, state);
        Self { body, driver, command: Command::default(), turn, left_s: TRIAL_S }
    }

    /// The controller's decision at a tick, `dt_s` before the next one.
    fn issue(&mut self, dt_s: f64) {
        self.left_s -= dt_s;
        if self.left_s <= 0.0 {
            self.left_s += TRIAL_S;
            if let Turn::EveryProtocol = self.turn {
                self.driver.begin_next();
            }
        }
        let (_, command) = self.driver.next(dt_s, self.body.pose);
        self.command = saturated(command);
    }

    fn reading(&self, robot: usize, held: bool) -> SimReading {
        let (command, measured) = (self.command, self.body.measured);
        SimReading {
            robot,
            v_mps: command.v_mps as f32,
            omega_radps: command.omega_radps as f32,
            power_w: measured.power_w as f32,
            voltage_v: measured.voltage_v as f32,
            current_a: measured.current_a as f32,
            held,
            measured_ns: self.body.measured_ns,
        }
    }
}
