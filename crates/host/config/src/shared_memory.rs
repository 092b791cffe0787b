//! Location and size of the fleet's shared memory.

use joulebus_settings::{Domain, DomainError, Limits};

use crate::Config;

/// Minimum and maximum number of forecast frames buffered for a reader. A planner reads the newest,
/// plus a few to distinguish a gap from a late read. A recorder reads all, and may be late by half
/// a second in fleets small enough for that to need little memory.
const FORECAST_FRAMES: (usize, usize) = (4, 16);
/// Buffered rows that determine the number of frames between these bounds.
const FORECAST_ROWS: usize = 4_000;

impl Config {
    /// The fleet's domain in shared memory.
    ///
    /// # Errors
    /// The root is too long or not absolute, or the prefix or the name has characters that are not
    /// allowed in shared memory names.
    pub fn domain(&self) -> Result<Domain, DomainError> {
        Domain::new(self.fleet(), self.root(), self.prefix())
    }

    /// The limits that all processes of the fleet must share.
    pub fn limits(&self) -> Limits {
        let (least, most) = FORECAST_FRAMES;
        let capacity = self.settings().capacity as usize;
        Limits {
            capacity,
            max_sources: self.settings().intake.max_sources.into(),
            max_planners: self.max_planners(),
            sample_frames: self.buffer_frames(),
            forecast_frames: (FORECAST_ROWS / capacity.max(1)).clamp(least, most),
        }
    }
}
