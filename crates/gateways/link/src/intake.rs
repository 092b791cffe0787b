//! The thread of the worker's host that publishes the samples of other hosts, each source under its
//! own identity.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use joulebus_bus::{Bus, Rounds, SampleWriter, SendError, clock, process_id};
use joulebus_wire::{Sample, SampleHeader, fnv1a};

use crate::config::Take;
use crate::ingress::{self, Ingress};
use crate::network::{Bytes, Event, Inbox};
use crate::protocol::carried::{Carried, Kind, max_message_bytes};
use crate::protocol::receiver::Accepted;
use crate::protocol::selection::Selection;
use crate::protocol::shift::shift;
use crate::report::Done;
use crate::shared::Shared;

/// Maximum sleep: the delay until a stop or a silence is noticed.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Maximum sleep after a message. It exceeds the period of most sources, so that the next message
/// ends the sleep.
const AFTER_MESSAGE: Duration = Duration::from_millis(40);

/// Takes the samples of other hosts.
pub(crate) struct Intake {
    hosts: BTreeMap<String, (Ingress, Selection)>,
    inbox: Inbox,
    writer: SampleWriter,
    bus: Bus,
    /// Hosts whose samples of foreign robots were logged.
    reported: BTreeSet<Arc<str>>,
    wait: Duration,
}

impl Intake {
    /// # Errors
    /// The fleet cannot be joined, or the network is refused.
    pub(crate) fn open(shared: &Shared, takes: Vec<Take>) -> anyhow::Result<Self> {
        let limits = shared.config.limits();
        let bus = shared.join()?;
        let writer = bus.sample_writer(&limits, limits.capacity)?;
        let mut inbox = Inbox::new(max_message_bytes(limits.capacity));
        let mut hosts = BTreeMap::new();
        for Take { from, robots } in takes {
            let selection = Selection::new(Carried::SAMPLES.bit(), 1, robots.ranges().to_vec());
            let of = (Kind::Samples, from.as_str());
            let ingress = Ingress::open(shared, of, limits.capacity, selection, &mut inbox)?;
            hosts.insert(from, (ingress, robots));
        }
        let (reported, wait) = (BTreeSet::new(), POLL_INTERVAL);
        Ok(Self { hosts, inbox, writer, bus, reported, wait })
    }

    /// Handles a message of the link `from`.
    fn message(
        &mut self,
        from: &Arc<str>,
        bytes: &Bytes,
        arrived_ns: u64,
    ) -> Result<(), SendError> {
        let Self { hosts, writer, reported, .. } = self;
        let Some((ingress, robots)) = hosts.get_mut(&**from) else {
            return Ok(());
        };
        let (mut ended, mut foreign) = (Ok(()), None);
        ingress.message(bytes, arrived_ns, |accepted| {
            let has = |robot| {
                let is_taken = robots.has_robot(robot);
                if !is_taken {
                    foreign = Some(robot);
                }
                is_taken
            };
            publish(writer, (from, &accepted), has).map_err(|error| {
                let shown = error.to_string();
                if error.is_final() {
                    ended = Err(error);
                }
                ("not published", shown)
            })
        });
        if let Some(robot) = foreign.filter(|_| reported.insert(Arc::clone(from))) {
            tracing::warn!(
                "{from} sends samples of robot {robot}, which is not among its `robots` in \
                 this link's file: these samples are left out"
            );
        }
        ended
    }
}

impl Rounds<Done, anyhow::Error> for Intake {
    fn round(&mut self) -> anyhow::Result<Duration> {
        self.bus.check()?;
        for (ingress, _) in self.hosts.values_mut() {
            ingress.request_if_due();
            if ingress.receiver().becomes_silent(clock::monotonic_ns()) {
                tracing::warn!("no samples come from {}", ingress.from());
            }
        }
        let event = self.inbox.next(self.wait);
        self.wait = POLL_INTERVAL;
        match event {
            Ok(Event::Message { from, bytes, arrived_ns }) => {
                self.wait = AFTER_MESSAGE;
                self.message(&from, &bytes, arrived_ns)?;
            }
            Ok(Event::Lost { name }) => {
                if let Some((ingress, _)) = self.hosts.get_mut(&*name)
                    && ingress.receiver().lost()
                {
                    tracing::warn!("the link of {name} is gone");
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => anyhow::bail!("the network has ended"),
        }
        Ok(Duration::ZERO)
    }

    fn finish(self) -> anyhow::Result<Done> {
        Ok(ingress::finish(self.hosts.values().map(|(ingress, _)| ingress), &self.inbox))
    }
}

/// Publishes a frame with the times of this host and the source's id on this host. Robots that
/// belong to another host are dropped, because a host may send only its own.
fn publish(
    writer: &mut SampleWriter,
    (from, accepted): (&str, &Accepted<'_>),
    mut has: impl FnMut(u32) -> bool,
) -> Result<(), SendError> {
    let (frame, offset_ns) = (&accepted.frame, accepted.offset_ns);
    let mut header: SampleHeader = frame.header();
    shift(&mut header, offset_ns);
    header.relay(process_id());
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
