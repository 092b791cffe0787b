//! Time constants of a robot's levels.

/// Number of levels of a robot.
pub const LEVELS: usize = 4;

/// Time constants of the levels, s, ascending.
pub const LEVELS_S: [f32; LEVELS] = [0.5, 2.0, 12.0, 600.0];

/// A plan's power follows from that of its commands by a factor and an addition.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Level {
    pub factor: f32,
    pub added_w: f32,
}
