//! The thread of a robots' host: reads the samples that are published here as a worker does, and gives them to the worker's
//! host.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use bytemuck::{bytes_of, cast_slice};
use joulebus_bus::{FrameBuf, ReceiveError, SampleReader, WorkerLock, clock};
use joulebus_config::Config;
use joulebus_connect::join;
use joulebus_wire::{Sample, SampleHeader};

use crate::config::Settings;
use crate::giving::{GivenRecord, Giving};
use crate::network::{Kind, Network};
use crate::protocol::carried::Carried;
use crate::protocol::split::Split;
use crate::protocol::stream::LocalFrame;
use crate::refusals::Refusals;
use crate::taking::ABSENT_AFTER_NS;

/// Longest sleep: how late a request or a stop may be noticed.
const LOOK_EVERY_NS: u64 = 20_000_000;

/// Gives the samples published here to the links `to`, each those of its shard, until `stop`. Calls `ready` when the fleet is joined.
///
/// # Errors
/// The fleet cannot be joined, its files were removed, or the network is refused.
pub(crate) fn run(
    (config, settings, to): (&Config, &Settings, &[String]),
    (network, lock): (&Arc<Network>, &WorkerLock),
    stop: &AtomicBool,
    ready: impl FnOnce(),
) -> anyhow::Result<(Vec<GivenRecord>, Refusals)> {
    let limits = config.limits();
    let mut bus = join(config, "link")?;
    bus.needs_lock(lock);
    let (kind, fleet) = (Kind::Samples, settings.fleet(config));
    let mut giving = Giving::open(network, kind, Some(to.to_vec()), fleet)?;
    let mut split = settings.shards.as_deref().cloned().map(Split::new);
    let mut waiter = bus.arrivals_waiter(&limits)?;
    let mut samples = bus.sample_reader(&limits)?;
    let mut frame = FrameBuf::new(limits.capacity);
    let absent_ns = clock::monotonic_ns().saturating_add(ABSENT_AFTER_NS);
    let mut is_known = false;
    ready();
    while !stop.load(Ordering::Relaxed) {
        bus.check()?;
        while is_taken(&mut samples, &mut frame)? {
            let (header, samples) = (frame.header(), frame.samples());
            match (&mut split, settings.shards.as_deref()) {
                (Some(split), Some(shards)) => {
                    split.split(header, samples, |shard, header, samples| {
                        let workers = &shards.all()[shard].workers;
                        let meant = |name: &str| workers.iter().any(|worker| worker == name);
                        giving.offer_to(meant, local(header, samples));
                    });
                }
                _ => giving.offer(local(header, samples)),
            }
        }
        giving.turn()?;
        let now_ns = clock::monotonic_ns();
        if !is_known && now_ns > absent_ns {
            tell_who_has_not_asked(to, &giving.records(), &settings.name);
            is_known = true;
        }
        let until_ns = now_ns + LOOK_EVERY_NS;
        waiter.wait_until(Some(until_ns), None)?;
    }
    let unassigned = split.map_or(0, |split| split.unassigned);
    if unassigned > 0 {
        tracing::warn!("{unassigned} samples were of robots that no shard has");
    }
    Ok((giving.records(), giving.refused))
}

fn tell_who_has_not_asked(to: &[String], asked: &[GivenRecord], own: &str) {
    for name in to {
        if !asked.iter().any(|it| it.to == *name) {
            tracing::warn!(
                "{name} has not asked for the samples published here so far: does its link run, and does its file have a \
                 `[[worker.take]]` with `from = {own:?}`, which with TLS is the name in the certificate of this one?"
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

/// Takes the next frame, if there is one. A connection to a source that failed is made again.
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
