//! `joulebus link FILE --take-over`: requests that this host's worker leads its shard.

use std::fs::File;
use std::time::Duration;

use anyhow::{Context as _, bail};
use joulebus_bus::{WorkerLock, clock};
use joulebus_config::Config;
use joulebus_program::output::log_line;
use joulebus_program::stop::Stop;
use joulebus_standby::{Permit, Places};

use crate::config::Settings;
use crate::etcd::Etcd;

/// Timeout of the answer by this host's link. With a lease twice its time to live is added.
const ANSWER_TIMEOUT_NS: u64 = 5_000_000_000;
const NANOSECONDS: u64 = 1_000_000_000;
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Requests leadership and waits until this host leads.
///
/// # Errors
/// This host has no standby worker, etcd does not answer, or the timeout has passed.
pub(crate) fn run(config: &Config, settings: &Settings, stop: &Stop) -> anyhow::Result<()> {
    let Some(standby) = &settings.standby else {
        bail!(
            "link {} is not one of several that may serve: name it and another in `workers` of a shard",
            settings.name
        );
    };
    let places = Places::new(config);
    if WorkerLock::owner(&config.domain()?)?.is_none() {
        bail!("this host has no worker: start `joulebus run --standby` first");
    }
    let shard = &standby.shard;
    let serves = || -> anyhow::Result<Option<Permit>> {
        let now_ns = clock::boot_ns();
        let permit = Permit::read(&places.permit)?.filter(|permit| permit.holds(now_ns));
        Ok(permit.filter(|_| !places.request.exists()))
    };
    let within_ns = match &standby.lease {
        _ if serves()?.is_some() => ANSWER_TIMEOUT_NS,
        Some(lease) => {
            let mut etcd = Etcd::new(lease, (config.fleet(), shard, &settings.name))?;
            etcd.request_leader().context("etcd does not answer")?;
            ANSWER_TIMEOUT_NS + 2 * u64::from(lease.ttl_s) * NANOSECONDS
        }
        None => {
            File::create(&places.request).with_context(|| format!("{:?}", places.request))?;
            ANSWER_TIMEOUT_NS
        }
    };
    let until_ns = clock::monotonic_ns() + within_ns;
    loop {
        if let Some(permit) = serves()? {
            log_line(&format!("this host serves shard {shard}, term {}", permit.term));
            return Ok(());
        }
        if stop.is_asked() || clock::monotonic_ns() >= until_ns {
            // A link that starts later must not act on this request.
            let _ = std::fs::remove_file(&places.request);
            bail!("this host does not serve shard {shard} yet: does its link run?");
        }
        std::thread::sleep(POLL_INTERVAL);
    }
}
