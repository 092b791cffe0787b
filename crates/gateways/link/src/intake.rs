//! The thread of the worker's host that publishes the samples of other hosts, each source under its
//! own identity.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use joulebus_bus::{Running, SampleWriter, SendError, clock, process_id};
use joulebus_config::Config;
use joulebus_connect::join;
use joulebus_wire::{Sample, SampleHeader, fnv1a};

use crate::config::{Settings, Take};
use crate::ingress::{Ingress, IngressRecord};
use crate::network::{Event, Inbox, Kind, Network, max_message_bytes};
use crate::protocol::carried::Carried;
use crate::protocol::receiver::Accepted;
use crate::protocol::selection::Selection;
use crate::protocol::shift::shift;

/// Maximum sleep: the delay until a stop or a silence is noticed.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Maximum sleep after a message. It exceeds the period of most sources, so that the next message
/// ends the sleep.
const AFTER_MESSAGE: Duration = Duration::from_millis(40);

/// Takes samples until it is told to end. Says when the fleet is joined.
///
/// # Errors
/// The fleet cannot be joined, its files were removed, or the network is refused.
pub(crate) fn run(
    (config, settings, takes): (&Config, &Settings, &[Take]),
    network: &Arc<Network>,
    thread: &Running,
) -> anyhow::Result<Vec<IngressRecord>> {
    let limits = config.limits();
    let bus = join(config, "link")?;
    let mut writer = bus.sample_writer(&limits, limits.capacity)?;
    let mut inbox = Inbox::new(max_message_bytes(limits.capacity));
    let (mut hosts, mut reported) = (BTreeMap::new(), BTreeSet::new());
    for take in takes {
        let selection = Selection::new(Carried::SAMPLES.bit(), 1, take.robots.ranges().to_vec());
        let of_fleet = (settings.fleet(config), limits.capacity);
        let from = (Kind::Samples, take.from.as_str());
        let ingress = Ingress::open(network, from, of_fleet, selection, &mut inbox)?;
        hosts.insert(take.from.as_str(), (ingress, &take.robots));
    }
    thread.joined(());
    let mut wait = POLL_INTERVAL;
    while !thread.is_stopping() {
        bus.check()?;
        for (ingress, _) in hosts.values_mut() {
            ingress.request_if_due();
            if ingress.receiver().becomes_silent(clock::monotonic_ns()) {
                tracing::warn!("no samples come from {}", ingress.from());
            }
        }
        let event = inbox.next(wait);
        wait = match event {
            Ok(Event::Message { .. }) => AFTER_MESSAGE,
            _ => POLL_INTERVAL,
        };
        match event {
            Ok(Event::Message { from, bytes, arrived_ns }) => {
                let Some((ingress, robots)) = hosts.get_mut(&*from) else {
                    continue;
                };
                let (mut ended, mut foreign) = (Ok(()), None);
                ingress.message(&bytes, arrived_ns, |accepted| {
                    let has = |robot| {
                        let (is_taken, is_here) =
                            (robots.has_robot(robot), settings.has_robot(robot));
                        if is_here && !is_taken {
                            foreign = Some(robot);
                        }
                        is_here && is_taken
                    };
                    publish(&mut writer, (&*from, &accepted), has).map_err(|error| {
                        let shown = error.to_string();
                        if error.is_final() {
                            ended = Err(error);
                        }
                        ("not published", shown)
                    })
                });
                ended?;
                if let Some(robot) = foreign.filter(|_| reported.insert(from.clone())) {
                    tracing::warn!(
                        "{from} sends samples of robot {robot}, which is not among its `robots` in \
                            this link's file: these samples are left out"
                    );
                }
            }
            Ok(Event::Lost { name }) => {
                if let Some((ingress, _)) = hosts.get_mut(&*name)
                    && ingress.receiver().lost()
                {
                    tracing::warn!("the link of {name} is gone");
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => anyhow::bail!("the network has ended"),
        }
    }
    let mut records: Vec<IngressRecord> =
        hosts.values().map(|(ingress, _)| ingress.record()).collect();
    if let Some(first) = records.first_mut() {
        first.received.lost += inbox.overflowed();
    }
    Ok(records)
}

/// Publishes a frame with the times of this host and the source's id on this host. Robots that
/// belong to another host or shard are dropped, because a host may send only its own.
fn publish(
    writer: &mut SampleWriter,
    (from, accepted): (&str, &Accepted<'_>),
    mut has: impl FnMut(u32) -> bool,
) -> Result<(), SendError> {
    let (frame, offset_ns) = (&accepted.frame, accepted.offset_ns);
    let mut header: SampleHeader = frame.header();
    shift(&mut header, offset_ns);
    header.pid = process_id();
    header.source_id = source_here(from, header.source_id);
    let samples = (0..frame.len()).map(|at| frame.element::<Sample>(at));
    let mut kept: Vec<Sample> = samples.filter(|sample| has(sample.robot)).collect();
    for sample in &mut kept {
        shift(sample, offset_ns);
    }
    writer.send(header, kept.len(), |at| kept[at]).map(drop)
}

/// The id on this host of a source of the link `from`. Two sources of one name on two hosts
/// therefore do not replace each other, and no host can publish as another's source.
fn source_here(from: &str, source: u64) -> u64 {
    fnv1a(from.bytes().chain(source.to_le_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_of_one_name_on_two_hosts_are_two_and_stay_the_same_over_restarts() {
        let bridge = fnv1a("bridge".bytes());
        let [one, other] = ["edge-1", "edge-2"].map(|from| source_here(from, bridge));
        assert!(one != other && one != bridge);
        assert_eq!(one, source_here("edge-1", bridge));
        assert_ne!(one, source_here("edge-1", fnv1a("sim".bytes())));
    }
}
