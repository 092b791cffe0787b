//! `--split`: what stays together when recordings are split.

use joulebus_lab::split::By;

/// What stays together.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub(crate) enum Together {
    /// Each trial
    Trial,
    /// All trials of a robot
    Robot,
    /// All trials whose file names differ only in their number
    Group,
    /// Nothing: the end of every trial is held out
    Time,
}

impl From<Together> for By {
    fn from(together: Together) -> Self {
        match together {
            Together::Trial => Self::Trial,
            Together::Robot => Self::Robot,
            Together::Group => Self::Group,
            Together::Time => Self::Time,
        }
    }
}
