//! The thread of a robots' host: reads the samples that are published here, as a worker does, and
//! sends them to the workers' hosts.

use std::sync::Arc;

use bytemuck::{bytes_of, cast_slice};
use joulebus_bus::{FrameBuf, ReceiveError, Running, SampleReader, WorkerLock, clock};
use joulebus_config::Config;
use joulebus_connect::join;
use joulebus_wire::{Sample, SampleHeader};

use crate::config::Settings;
use crate::egress::{Egress, EgressRecord};
use crate::ingress::ABSENCE_TIMEOUT_NS;
use crate::network::{Kind, Network};
use crate::protocol::carried::Carried;
use crate::protocol::split::Split;
use crate::protocol::stream::LocalFrame;
use crate::refusals::Refusals;

/// Maximum sleep: the delay until a request or a stop is noticed.
const POLL_INTERVAL_NS: u64 = 20_000_000;

/// Sends the samples published here to the links `to`, to each those of its shard, until it is told
/// to end. Says when the fleet is joined.
///
/// # Errors
/// The fleet cannot be joined, its files were removed, or the network is refused.
pub(crate) fn run(
    (config, settings, to): (&Config, &Settings, &[String]),
    (network, lock): (&Arc<Network>, &WorkerLock),
    thread: &Running,
) -> anyhow::Result<(Vec<EgressRecord>, Refusals)> {
    let limits = config.limits();
    let mut bus = join(config, "link")?;
    bus.needs_lock(lock);
    let (kind, fleet) = (Kind::Samples, settings.fleet(config));
    let mut egress = Egress::open(network, kind, Some(to.to_vec()), fleet)?;
    let mut split = settings.shards.as_deref().cloned().map(Split::new);
    let mut waiter = bus.arrivals_waiter(&limits)?;
    let mut samples = bus.sample_reader(&limits)?;
    let mut frame = FrameBuf::new(limits.capacity);
    let absent_ns = clock::monotonic_ns().saturating_add(ABSENCE_TIMEOUT_NS);
    let mut is_known = false;
    thread.joined(());
    while !thread.is_stopping() {
        bus.check()?;
        while is_taken(&mut samples, &mut frame)? {
            let (header, samples) = (frame.header(), frame.samples());
            match (&mut split, settings.shards.as_deref()) {
                (Some(split), Some(shards)) => {
                    split.split(header, samples, |shard, header, samples| {
                        let workers = &shards.all()[shard].workers;
                        let meant = |name: &str| workers.iter().any(|worker| worker == name);
                        egress.offer_to(meant, local(header, samples));
                    });
                }
                _ => egress.offer(local(header, samples)),
            }
        }
        egress.poll()?;
        let now_ns = clock::monotonic_ns();
        if !is_known && now_ns > absent_ns {
            log_absent_receivers(to, &egress.records(), &settings.name);
            is_known = true;
        }
        let until_ns = now_ns + POLL_INTERVAL_NS;
        waiter.wait_until(Some(until_ns), None)?;
    }
    let unassigned = split.map_or(0, |split| split.unassigned);
    if unassigned > 0 {
        tracing::warn!("{unassigned} samples were of robots that no shard has");
    }
    Ok((egress.records(), egress.refused))
}

fn log_absent_receivers(to: &[String], asked: &[EgressRecord], own: &str) {
    for name in to {
        if !asked.iter().any(|it| it.to == *name) {
            tracing::warn!(
                "{name} has not asked for the samples published here so far. Does its link run? Does its \
                 file have a `[[worker.take]]` with `from = {own:?}`? With TLS, does the certificate \
                 of this link have that name?"
            );
        }
    }
}

fn local<'a>(header: &'a SampleHeader, samples: &'a [Sample]) -> LocalFrame<'a> {
    LocalFrame {
        service: Carried::SAMPLES,
        source: header.source_id,
        tick: 0,
        header: bytes_of(header),
        elements: cast_slice(samples),
    }
}

/// Takes the next frame, if there is one. A failed connection to a source is made again.
fn is_taken(samples: &mut SampleReader, frame: &mut FrameBuf) -> Result<bool, ReceiveError> {
    match samples.take(frame) {
        Err(ReceiveError::Removed(removed)) => Err(removed.into()),
        Err(error) => {
            tracing::debug!(%error, "samples cannot be read");
            Ok(false)
        }
        taken => taken,
    }
}
