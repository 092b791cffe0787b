//! Time constants of a robot's levels, and horizons of its shadow forecasts.

/// Number of levels of a robot.
pub const LEVELS: usize = 4;

/// Time constants of the levels, s, ascending.
pub const LEVELS_S: [f32; LEVELS] = [0.5, 2.0, 12.0, 600.0];

/// Number of the shortest levels, with which longer ones are compared.
pub(crate) const NEWEST: usize = 2;

/// Number of horizons at which a robot's own errors are watched.
pub const SHADOWS: usize = 3;

/// Horizons at which a robot's own errors are watched, s, ascending.
pub const SHADOWS_S: [f32; SHADOWS] = [1.0, 10.0, 100.0];

/// A factor and an addend that turn the power of commands into a plan's power.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Level {
    pub factor: f32,
    pub added_w: f32,
}

impl Level {
    /// Energy of a plan, J, given the command model's energy `command_j`.
    pub(crate) fn energy_j(&self, command_j: f32, duration_s: f32) -> f32 {
        self.factor * command_j + self.added_w * duration_s
    }
}

/// A level if commands are trusted, and the power that is expected if they are not.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Parts {
    pub factor: f32,
    pub added_w: f32,
    /// The mean power of the levels.
    pub mean_w: f32,
    /// Power without commands: the outlook's parts that do not need the last reading.
    pub without_w: f32,
}

impl Parts {
    /// `trust`: 0 to 1.
    pub(crate) fn level(&self, trust: f32) -> Level {
        Level {
            factor: trust * self.factor,
            added_w: trust * self.added_w + (1.0 - trust) * self.without_w,
        }
    }
}
