//! The sending side of this host: frames for every link that requests them.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use joulebus_bus::clock;

use crate::config::Settings;
use crate::network::{Event, Inbox, NetworkError, Outlet};
use crate::protocol::carried::{Carried, Kind};
use crate::protocol::message::{Body, FleetId, LeaderStatus, MAX_REQUEST_BYTES, Request, read};
use crate::protocol::stream::{LocalFrame, Sent, Stream};
use crate::refusals::Refusals;
use crate::report::{Done, EgressRecord};
use crate::shared::Shared;

/// Maximum number of receivers at a time.
const MAX_RECEIVERS: usize = 64;

/// Maximum number of past receivers with a record of their own. Further ones share one record,
/// because a client may request under any number of names.
const MAX_PAST_RECEIVERS: usize = 256;
const OTHERS: &str = "others";

/// The streams of one kind of frames to all their receivers.
#[derive(Debug)]
pub(crate) struct Egress {
    shared: Arc<Shared>,
    kind: Kind,
    /// The links that may request. Without it all links may.
    only: Option<Vec<String>>,
    fleet: FleetId,
    inbox: Inbox,
    streams: BTreeMap<Arc<str>, (Stream, Outlet)>,
    /// Totals of receivers that have left.
    past: BTreeMap<Arc<str>, Sent>,
    pub(crate) leader: LeaderStatus,
    pub(crate) refused: Refusals,
}

impl Egress {
    pub(crate) fn open(
        shared: Arc<Shared>,
        kind: Kind,
        only: Option<Vec<String>>,
    ) -> Result<Self, NetworkError> {
        let mut inbox = Inbox::new(MAX_REQUEST_BYTES);
        shared.network.take_requests(kind, &mut inbox)?;
        Ok(Self {
            kind,
            only,
            fleet: Settings::fleet(&shared.config),
            shared,
            inbox,
            streams: BTreeMap::new(),
            past: BTreeMap::new(),
            leader: LeaderStatus::default(),
            refused: Refusals::default(),
        })
    }

    /// Processes the requests in the inbox.
    pub(crate) fn take(&mut self) -> Result<(), NetworkError> {
        while let Ok(event) = self.inbox.next(Duration::ZERO) {
            let (from, bytes, arrived_ns) = match event {
                Event::Message { from, bytes, arrived_ns } => (from, bytes, arrived_ns),
                Event::Lost { name } => {
                    self.forget(&name);
                    continue;
                }
            };
            match self.inbox.verify(&from, &bytes, arrived_ns) {
                Ok(true) => {}
                // Its signature has not arrived yet.
                Ok(false) => continue,
                Err(error) => {
                    self.refused.count("not the link in its certificate", &from, &error);
                    continue;
                }
            }
            match read(&bytes.get(), self.fleet, 0) {
                Ok(message) => {
                    let Body::Request(request) = message.body else {
                        continue;
                    };
                    self.request(&from, request, arrived_ns)?;
                }
                Err(error) => self.refused.count(error.name(), &from, &error),
            }
        }
        Ok(())
    }

    /// Processes requests, drops silent receivers, and sends frames that waited.
    pub(crate) fn poll(&mut self) -> Result<(), NetworkError> {
        self.take()?;
        let now_ns = clock::monotonic_ns();
        let silent = |(name, (stream, _)): (&Arc<str>, &(Stream, Outlet))| {
            stream.is_over(now_ns).then(|| Arc::clone(name))
        };
        let silent: Vec<Arc<str>> = self.streams.iter().filter_map(silent).collect();
        for name in silent {
            self.forget(&name);
        }
        let leader = self.leader;
        for (stream, outlet) in self.streams.values_mut() {
            let mut out = Vec::new();
            while stream.due(leader, now_ns, &mut out) {
                outlet.send(std::mem::take(&mut out));
            }
        }
        Ok(())
    }

    /// Ends the stream to a link that has left.
    fn forget(&mut self, name: &Arc<str>) {
        if let Some((stream, _)) = self.streams.remove(name) {
            tracing::info!("link {name} no longer asks");
            let is_logged = self.past.len() < MAX_PAST_RECEIVERS || self.past.contains_key(name);
            let name = if is_logged { Arc::clone(name) } else { OTHERS.into() };
            add(self.past.entry(name).or_default(), stream.sent());
        }
    }

    fn request(
        &mut self,
        from: &Arc<str>,
        request: Request,
        now_ns: u64,
    ) -> Result<(), NetworkError> {
        if let Some((stream, _)) = self.streams.get_mut(from) {
            stream.request(request, now_ns);
            return Ok(());
        }
        let only = self.only.as_deref();
        let is_allowed = only.is_none_or(|only| only.iter().any(|name| **name == **from));
        if !is_allowed || self.streams.len() == MAX_RECEIVERS {
            let why = if is_allowed {
                format!("{MAX_RECEIVERS} links ask already")
            } else {
                "the file of this link names another".to_owned()
            };
            self.refused.count("not a link that may ask", from, &why);
            return Ok(());
        }
        tracing::info!("link {from} asks for {}", self.kind_name());
        let outlet = self.shared.network.frames_to(self.kind, from)?;
        let stream = Stream::new(self.fleet, request, now_ns);
        self.streams.insert(Arc::clone(from), (stream, outlet));
        Ok(())
    }

    const fn kind_name(&self) -> &'static str {
        match self.kind {
            Kind::Outputs => "what the worker writes",
            Kind::Samples => "the samples published here",
        }
    }

    /// True if any receiver selects the service.
    pub(crate) fn wants(&self, service: Carried) -> bool {
        let mut streams = self.streams.values();
        streams.any(|(stream, _)| stream.request_of().selection.wants(service))
    }

    /// True if a frame waits for the acknowledgement of an earlier one.
    pub(crate) fn waits(&self) -> bool {
        self.streams.values().any(|(stream, _)| stream.waits())
    }

    /// Sends a frame to every receiver that selects it, or holds it back for receivers with too
    /// many in flight.
    pub(crate) fn offer(&mut self, frame: LocalFrame<'_>) {
        let (leader, now_ns) = (self.leader, clock::monotonic_ns());
        for (stream, outlet) in self.streams.values_mut() {
            let mut out = Vec::new();
            if stream.offer(frame, leader, now_ns, &mut out) {
                outlet.send(out);
            }
        }
    }

    /// Sends the worker's current state to all receivers.
    pub(crate) fn send_status(&mut self) {
        let (leader, now_ns) = (self.leader, clock::monotonic_ns());
        for (stream, outlet) in self.streams.values_mut() {
            let mut out = Vec::new();
            stream.write_status(leader, now_ns, &mut out);
            outlet.send(out);
        }
    }

    /// Contribution of this side to the report.
    pub(crate) fn finish(self) -> Done {
        Done { given: self.records(), refused: self.refused, ..Done::default() }
    }

    /// The totals sent, by link.
    pub(crate) fn records(&self) -> Vec<EgressRecord> {
        let mut all = self.past.clone();
        for (name, (stream, _)) in &self.streams {
            add(all.entry(Arc::clone(name)).or_default(), stream.sent());
        }
        let record = |(name, sent): (Arc<str>, Sent)| EgressRecord { to: name.to_string(), sent };
        all.into_iter().map(record).collect()
    }
}

fn add(total: &mut Sent, sent: Sent) {
    total.frames += sent.frames;
    total.bytes += sent.bytes;
    total.dropped += sent.dropped;
    total.unheard += sent.unheard;
}
