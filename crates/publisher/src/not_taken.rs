//! What a source learns of its refusals with each frame.

use std::fmt;

use joulebus_connect::refusals::Refused;
use joulebus_wire::DropReason;

/// Samples of a source that its worker refuses, for the most frequent reason.
///
/// [`crate::Publisher`] has an example.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct NotTaken {
    /// The reason. [`DropReason::remedy`] states the remedy.
    pub reason: DropReason,
    /// How many.
    pub count: u64,
    /// The robot of the last one.
    pub robot: u32,
}

impl NotTaken {
    /// `None` if no sample is refused any more.
    pub(crate) fn of(source: &[Refused]) -> Option<Self> {
        let first = source.iter().find(|refused| refused.is_recent())?;
        Some(Self { reason: first.reason, count: first.count, robot: first.robot })
    }
}

impl fmt::Display for NotTaken {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (count, name, robot) = (self.count, self.reason.name(), self.robot);
        let remedy = self.reason.remedy();
        write!(
            out,
            "the worker has refused {count} samples ({name}), the last of robot {robot}: {remedy}"
        )
    }
}
