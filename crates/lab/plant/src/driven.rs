//! One simulated robot, driven from outside.

use crate::arena::{Command, Pose, saturated};
use crate::body::Body;
use crate::fault::Fault;
use crate::parts::Parts;
use joulebus_statistics::noise::Noise;

/// A robot whose controller is not part of the simulation: whoever calls [`Driven::drive`].
#[derive(Clone, Debug)]
pub struct Driven {
    body: Body,
    now_ns: u64,
    /// True if the last step brought a new measurement.
    fresh: bool,
    before_j: f64,
}

impl Driven {
    /// A robot at rest at time 0. Streams `stream` and `stream + 1` of the seed draw its
    /// manufacturing variation and its state. `extra_w` is a constant additional load, W.
    pub fn new(parts: Parts, extra_w: f64, pose: Pose, (seed, stream): (u64, u64)) -> Self {
        let mut made = Noise::new(seed, stream);
        let body = Body::new(parts, extra_w, 0, pose, &mut made, Noise::new(seed, stream + 1));
        let before_j = body.drawn_j();
        Self { body, now_ns: 0, fresh: true, before_j }
    }

    /// Adds a fault from a time on, s since the start.
    #[must_use]
    pub fn with_fault(mut self, fault: Fault, from_s: f64) -> Self {
        self.body.fail(fault, from_s);
        self
    }

    /// Drives for `dt_ns` under a command, and returns the command after saturation of the wheels.
    pub fn drive(&mut self, command: Command, dt_ns: u64) -> Command {
        let command = saturated(command);
        let (end_ns, measured_ns) = (self.now_ns + dt_ns, self.body.measured_ns);
        self.body.run(self.now_ns, end_ns, command);
        self.now_ns = end_ns;
        self.fresh = self.body.measured_ns != measured_ns;
        command
    }

    /// Position and heading.
    pub fn pose(&self) -> Pose {
        self.body.pose
    }

    /// Energy that it has really drawn since the start, J. Known to no policy. It advances with the
    /// polls of the power monitor, ten times a second.
    pub fn drawn_j(&self) -> f64 {
        self.body.drawn_j() - self.before_j
    }

    /// Power by the latest measurement, W.
    pub fn power_w(&self) -> f64 {
        self.body.measured.power_w
    }

    /// When it was measured, ns since the start.
    pub fn measured_ns(&self) -> u64 {
        self.body.measured_ns
    }

    /// True if the last step brought a new measurement.
    pub fn is_fresh(&self) -> bool {
        self.fresh
    }
}
