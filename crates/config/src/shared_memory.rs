//! Location and size of the fleet's shared memory, for the bus.

use joulebus_bus::{Bus, Domain, DomainError, JoinError, Limits, OpenError};

use crate::{Config, ConfigError};

/// Minimum and maximum number of forecast frames buffered for a reader. A planner reads the newest,
/// plus a few to distinguish a gap from a late read; a recorder reads all, and may be late by half
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

    /// Joins the fleet as `name`, 1 to 128 bytes.
    ///
    /// # Errors
    /// [`ConnectError`] with the cause and the remedy.
    pub fn join(&self, name: &str) -> Result<Bus, ConnectError> {
        Ok(Bus::join(&self.domain()?, name)?)
    }

    /// The limits that all processes of the fleet must share.
    #[must_use]
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

/// Errors of joining the fleet of a config, or of opening one of its ports.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConnectError {
    /// The config could not be read, or is refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The config names an invalid domain.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// The fleet could not be joined.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// A port could not be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
}
