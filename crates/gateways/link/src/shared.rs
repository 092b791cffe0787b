//! State that the threads of a link share.

use std::sync::Arc;

use joulebus_bus::{Bus, WorkerLock};
use joulebus_config::Config;
use joulebus_connect::ConnectError;

use crate::config::Settings;
use crate::leadership::Leadership;
use crate::network::Network;

/// State that the threads share.
#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) config: Config,
    pub(crate) settings: Settings,
    pub(crate) network: Network,
    /// Set if this host's worker is one of several candidates.
    pub(crate) leadership: Option<Arc<Leadership>>,
    /// The worker lock of a host without a worker. Released after the threads that need it have
    /// ended.
    pub(crate) lock: Option<WorkerLock>,
}

impl Shared {
    /// Joins the fleet of this host.
    pub(crate) fn join(&self) -> Result<Bus, ConnectError> {
        let mut bus = joulebus_connect::join(&self.config, "link")?;
        if let Some(lock) = &self.lock {
            bus.needs_lock(lock);
        }
        Ok(bus)
    }
}
