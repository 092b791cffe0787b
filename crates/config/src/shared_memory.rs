//! Where the fleet's shared memory lies and how much of it there is, for the bus.

use joulebus_bus::{Bus, Domain, DomainError, JoinError, Limits, OpenError};

use crate::{Config, ConfigError};

/// Frames of forecasts that wait for a reader, at least and at most. A planner wants the newest, and
/// a few to tell a gap from a late look; a recorder wants all, and may be late by half a second where
/// the fleet is small enough for that to cost little memory.
const FORECAST_FRAMES: (usize, usize) = (4, 16);
/// Rows in the frames that wait, where that gives a number between the two.
const FORECAST_ROWS: usize = 4_000;

impl Config {
    /// The fleet's domain in shared memory.
    ///
    /// # Errors
    /// The root is too long or not absolute, or the prefix or the name has letters that shared
    /// memory cannot take.
    pub fn domain(&self) -> Result<Domain, DomainError> {
        Domain::new(self.fleet(), self.root(), self.prefix())
    }

    /// Joins the fleet as `name`, 1 to 128 bytes.
    ///
    /// # Errors
    /// [`ConnectError`] says what is in the way and what to do.
    pub fn join(&self, name: &str) -> Result<Bus, ConnectError> {
        Ok(Bus::join(&self.domain()?, name)?)
    }

    /// What every process of the fleet must agree on.
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

/// Why a process could not join the fleet of a config, or open a port of it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConnectError {
    /// The config was not read, or refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The config names a domain that shared memory cannot hold.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// The fleet could not be joined.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// A port could not be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
}
