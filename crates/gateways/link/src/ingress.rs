//! The receiving side of this host: frames from one link, and the requests for them.

use joulebus_bus::clock;

use crate::config::Settings;
use crate::network::{Bytes, Inbox, NetworkError, Outlet};
use crate::protocol::carried::Kind;
use crate::protocol::message::{FleetId, Sender, read};
use crate::protocol::receiver::{Accepted, Receiver, Unused};
use crate::protocol::selection::Selection;
use crate::refusals::Refusals;
use crate::report::{Done, IngressRecord};
use crate::shared::Shared;

/// Time without any message after which a link is reported as absent.
pub(crate) const ABSENCE_TIMEOUT_NS: u64 = 5_000_000_000;

/// The stream from one link.
#[derive(Debug)]
pub(crate) struct Ingress {
    from: String,
    fleet: FleetId,
    /// Maximum number of elements of a frame.
    most: usize,
    receiver: Receiver,
    outlet: Outlet,
    opened_ns: u64,
    /// The link has sent something, or its absence was logged.
    is_known: bool,
    before_clock: u64,
    pub(crate) fenced: u64,
    pub(crate) refused: Refusals,
}

impl Ingress {
    /// Subscribes the inbox to frames of the link `from`.
    pub(crate) fn open(
        shared: &Shared,
        (kind, from): (Kind, &str),
        most: usize,
        selection: Selection,
        inbox: &mut Inbox,
    ) -> Result<Self, NetworkError> {
        let network = &shared.network;
        network.take_frames(kind, from, inbox)?;
        let fleet = Settings::fleet(&shared.config);
        let run = clock::monotonic_ns();
        Ok(Self {
            from: from.to_owned(),
            fleet,
            most,
            receiver: Receiver::new(Sender { fleet, run }, selection),
            outlet: network.requests_to(kind, from)?,
            opened_ns: run,
            is_known: false,
            before_clock: 0,
            fenced: 0,
            refused: Refusals::default(),
        })
    }

    /// Name of the sending link.
    pub(crate) fn from(&self) -> &str {
        &self.from
    }

    /// Takes a message and passes its frame, if it has one, to `each`. An error of `each` is
    /// counted as a refusal.
    pub(crate) fn message(
        &mut self,
        bytes: &Bytes,
        arrived_ns: u64,
        each: impl FnOnce(Accepted<'_>) -> Result<(), (&'static str, String)>,
    ) {
        let bytes = bytes.get();
        let message = match read(&bytes, self.fleet, self.most) {
            Ok(message) => message,
            Err(error) => {
                self.refused.count(error.name(), &self.from, &error);
                return;
            }
        };
        let (number, before) = (message.number, self.receiver.received());
        let taken = self.receiver.take(&message, bytes.len(), arrived_ns);
        let after = self.receiver.received();
        if before.contested == 0 && after.contested > 0 {
            tracing::warn!(
                "a second link sends as {from}, and is ignored: the files of two hosts have this name, or a \
                 stranger uses it. Give each link a name of its own",
                from = self.from
            );
        }
        let lost = after.lost - before.lost;
        if lost > 0 {
            tracing::debug!(from = self.from, number, lost, "messages are missing");
        }
        match taken {
            Ok(accepted) => {
                if let Err((reason, error)) = each(accepted) {
                    self.refused.count(reason, &self.from, &error);
                }
            }
            Err(Unused::NoClock) => self.before_clock += 1,
            Err(_) => {}
        }
    }

    /// Sends a request if one is due, and logs once that the link is absent.
    pub(crate) fn request_if_due(&mut self) {
        let now_ns = clock::monotonic_ns();
        if let Some(request) = self.receiver.request_if_due(now_ns) {
            self.outlet.send(request);
        }
        if !self.is_known {
            let is_sending = self.receiver.is_sending();
            let is_absent = now_ns.saturating_sub(self.opened_ns) > ABSENCE_TIMEOUT_NS;
            if is_absent && !is_sending {
                tracing::warn!(
                    "nothing has come from {from} so far. Does its link run? Can the two hosts reach each \
                     other? Is {from} the name in its file and, with TLS, in its certificate? Does one of \
                     the files name the other's address?",
                    from = self.from
                );
            }
            self.is_known = is_sending || is_absent;
        }
    }

    pub(crate) const fn receiver(&mut self) -> &mut Receiver {
        &mut self.receiver
    }

    fn record(&self) -> IngressRecord {
        let offset = self.receiver.offset();
        let uncertainty_ns = offset.uncertainty_ns(clock::monotonic_ns());
        IngressRecord {
            from: self.from.clone(),
            received: self.receiver.received(),
            before_clock: self.before_clock,
            fenced: self.fenced,
            clock_uncertainty_s: uncertainty_ns.map(|ns| ns as f64 * 1e-9),
            clock_refits: offset.refits,
            clock_steps: offset.steps,
            refused: self.refused.clone(),
        }
    }
}

/// Contribution of an inbox's streams to the report.
pub(crate) fn finish<'a>(all: impl Iterator<Item = &'a Ingress>, inbox: &Inbox) -> Done {
    let mut taken: Vec<IngressRecord> = all.map(Ingress::record).collect();
    if let Some(first) = taken.first_mut() {
        first.received.lost += inbox.overflowed();
    }
    Done { taken, ..Done::default() }
}
