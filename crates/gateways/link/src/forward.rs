//! The thread of a robots' host: reads the samples that are published here, as a worker does, and
//! sends them to the workers' hosts.

use std::sync::Arc;
use std::time::Duration;

use bytemuck::{bytes_of, cast_slice};
use joulebus_bus::{Bus, FrameBuf, ReceiveError, Rounds, SampleReader, Waiter, clock};

use crate::egress::Egress;
use crate::ingress::ABSENCE_TIMEOUT_NS;
use crate::protocol::carried::{Carried, Kind};
use crate::protocol::stream::LocalFrame;
use crate::report::{Done, EgressRecord};
use crate::shared::Shared;

/// Maximum sleep: the delay until a request or a stop is noticed.
const POLL_INTERVAL_NS: u64 = 20_000_000;

/// Sends the samples published here to the links `to`.
pub(crate) struct Forwarding {
    shared: Arc<Shared>,
    to: Vec<String>,
    egress: Egress,
    samples: SampleReader,
    waiter: Waiter,
    bus: Bus,
    frame: FrameBuf,
    /// When receivers that have not requested are reported, monotonic ns.
    absent_ns: Option<u64>,
}

impl Forwarding {
    /// # Errors
    /// The fleet cannot be joined, or the network is refused.
    pub(crate) fn open(shared: Arc<Shared>, to: Vec<String>) -> anyhow::Result<Self> {
        let limits = shared.config.limits();
        let bus = shared.join()?;
        Ok(Self {
            egress: Egress::open(Arc::clone(&shared), Kind::Samples, Some(to.clone()))?,
            waiter: bus.arrivals_waiter(&limits)?,
            samples: bus.sample_reader(&limits)?,
            bus,
            frame: FrameBuf::new(limits.capacity),
            absent_ns: Some(clock::monotonic_ns().saturating_add(ABSENCE_TIMEOUT_NS)),
            to,
            shared,
        })
    }
}

impl Rounds<Done, anyhow::Error> for Forwarding {
    fn round(&mut self) -> anyhow::Result<Duration> {
        let Self { shared, egress, frame, .. } = self;
        self.bus.check()?;
        while is_taken(&mut self.samples, frame)? {
            let (header, samples) = (frame.header(), frame.samples());
            egress.offer(LocalFrame {
                service: Carried::SAMPLES,
                source: header.source_id,
                tick: 0,
                header: bytes_of(header),
                elements: cast_slice(samples),
            });
        }
        egress.poll()?;
        let now_ns = clock::monotonic_ns();
        if self.absent_ns.take_if(|absent_ns| now_ns > *absent_ns).is_some() {
            log_absent_receivers(&self.to, &egress.records(), &shared.settings.name);
        }
        self.waiter.wait_until(Some(now_ns + POLL_INTERVAL_NS), None)?;
        Ok(Duration::ZERO)
    }

    fn finish(self) -> anyhow::Result<Done> {
        Ok(self.egress.finish())
    }
}

fn log_absent_receivers(to: &[String], asked: &[EgressRecord], own: &str) {
    for name in to {
        if !asked.iter().any(|egress| egress.to == *name) {
            tracing::warn!(
                "{name} has not asked for the samples published here so far. Does its link run? Does its \
                 file have a `[[worker.take]]` with `from = {own:?}`? With TLS, does the certificate \
                 of this link have that name?"
            );
        }
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
