//! The thread of the worker's host that publishes the samples of other hosts, each source under its own identity.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use joulebus_bus::{SampleWriter, SendError, clock, process_id};
use joulebus_config::Config;
use joulebus_wire::{Sample, SampleHeader};

use crate::config::{Settings, Take};
use crate::network::{Event, Inbox, Kind, Network, longest_bytes};
use crate::protocol::carried::Carried;
use crate::protocol::receiver::Accepted;
use crate::protocol::selection::Selection;
use crate::protocol::shift::Instants;
use crate::taking::{TakenRecord, Taking};

/// Longest sleep: how late a stop or a silence may be noticed.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Takes until `stop`. Calls `ready` when the fleet is joined.
///
/// # Errors
/// The fleet cannot be joined, its files were removed, or the network is refused.
pub(crate) fn run(
    (config, settings, takes): (&Config, &Settings, &[Take]),
    network: &Arc<Network>,
    stop: &AtomicBool,
    ready: impl FnOnce(),
) -> anyhow::Result<Vec<TakenRecord>> {
    let limits = config.limits();
    let bus = config.join("link")?;
    let mut writer = bus.sample_writer(&limits, limits.capacity)?;
    let mut inbox = Inbox::new(longest_bytes(limits.capacity));
    let mut hosts = BTreeMap::new();
    for take in takes {
        let selection = Selection::new(Carried::Samples.bit(), 1, take.robots.ranges().to_vec());
        let of_fleet = (settings.fleet(config), limits.capacity);
        let from = (Kind::Samples, take.from.as_str());
        let taking = Taking::open(network, from, of_fleet, selection, &mut inbox)?;
        hosts.insert(take.from.as_str(), (taking, &take.robots));
    }
    ready();
    while !stop.load(Ordering::Relaxed) {
        bus.check()?;
        for (taking, _) in hosts.values_mut() {
            taking.ask();
            if taking.receiver().falls_silent(clock::monotonic_ns()) {
                tracing::warn!("no samples come from {}", taking.from());
            }
        }
        match inbox.next(LOOK_EVERY) {
            Ok(Event::Message {
                from,
                bytes,
                arrived_ns,
            }) => {
                let Some((taking, robots)) = hosts.get_mut(&*from) else {
                    continue;
                };
                let mut ended = Ok(());
                taking.message(&bytes, arrived_ns, |accepted| {
                    let has = |robot| robots.has_robot(robot) && settings.has_robot(robot);
                    publish(&mut writer, &accepted, has).map_err(|error| {
                        let shown = error.to_string();
                        if error.is_final() {
                            ended = Err(error);
                        }
                        ("not published", shown)
                    })
                });
                ended?;
            }
            Ok(Event::Lost { name }) => {
                if let Some((taking, _)) = hosts.get_mut(&*name)
                    && taking.receiver().lost()
                {
                    tracing::warn!("the link of {name} is gone");
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => anyhow::bail!("the network has ended"),
        }
    }
    let mut records: Vec<TakenRecord> = hosts.values().map(|(taking, _)| taking.record()).collect();
    if let Some(first) = records.first_mut() {
        first.received.lost += inbox.overflowed();
    }
    Ok(records)
}

/// Publishes a frame as its source did, with the times of this host. Robots that are not that host's, or not of this shard, are
/// left out: a host speaks for its own.
fn publish(
    writer: &mut SampleWriter,
    accepted: &Accepted<'_>,
    has: impl Fn(u32) -> bool,
) -> Result<(), SendError> {
    let (frame, offset_ns) = (&accepted.frame, accepted.offset_ns);
    let mut header: SampleHeader = frame.header();
    header.shift(offset_ns);
    header.pid = process_id();
    let samples = (0..frame.len()).map(|at| frame.element::<Sample>(at));
    let mut kept: Vec<Sample> = samples.filter(|sample| has(sample.robot)).collect();
    for sample in &mut kept {
        sample.shift(offset_ns);
    }
    writer.send(header, kept.len(), |at| kept[at]).map(drop)
}
