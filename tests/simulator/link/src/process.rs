//! A link, without its process.

use std::path::Path;

use joulebus_config::Config;

use crate::network::Network;
use crate::{config, threads};

/// The checked file of a link.
#[derive(Debug, Clone)]
pub struct LinkFile(config::Settings);

impl LinkFile {
    /// Reads and checks the file.
    ///
    /// # Errors
    /// The problems of the file.
    pub fn load(path: &Path, config: &Config) -> anyhow::Result<Self> {
        Ok(Self(config::Settings::load(path, config)?))
    }
}

#[allow(missing_debug_implementations, reason = "its ports have none")]
pub struct Link(threads::Threads);

impl Link {
    /// Starts a link.
    ///
    /// # Errors
    /// Those of the program.
    pub fn start(config: &Config, LinkFile(settings): &LinkFile) -> anyhow::Result<Self> {
        let claim = threads::HostClaim::take(config, settings)?;
        let network = Network::new(&settings.name);
        Ok(Self(threads::Threads::start(config, settings, claim, network)?))
    }

    /// True if a thread has ended by itself.
    pub fn has_ended(&self) -> bool {
        self.0.have_ended()
    }

    /// Ends the link; the reason if a thread has failed.
    ///
    /// # Errors
    /// A thread's error.
    pub fn finish(self) -> anyhow::Result<()> {
        self.0.finish().map(drop)
    }
}
