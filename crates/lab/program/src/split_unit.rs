//! `--split`: the unit that is not divided when recordings are split.

use joulebus_dataset::split::By;

/// Unit of a split.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub(crate) enum SplitUnit {
    /// Each trial
    Trial,
    /// All trials of a robot
    Robot,
    /// All trials whose file names differ only in a number
    Group,
    /// None: the end of every trial is held out
    Time,
}

impl From<SplitUnit> for By {
    fn from(together: SplitUnit) -> Self {
        match together {
            SplitUnit::Trial => Self::Trial,
            SplitUnit::Robot => Self::Robot,
            SplitUnit::Group => Self::Group,
            SplitUnit::Time => Self::Time,
        }
    }
}
