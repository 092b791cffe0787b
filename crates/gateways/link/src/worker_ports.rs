//! The ports of a worker, on a host where a link writes in its place.

use joulebus_bus::{Bus, Limits, Waker, Writer};
use joulebus_config::Config;
use joulebus_wire::{Channel, Forecasts, Ticks, WakeEvent};

use crate::output_port::{AnyOutputPort, OutputPort, PassError, Runs, pass_on};
use crate::protocol::carried::{Carried, OfChannel};
use crate::protocol::receiver::Accepted;

/// The worker's ports of this host.
pub(crate) struct WorkerPorts {
    pub(crate) forecasts: OutputPort<Forecasts>,
    /// The channels that a worker writes after its forecasts.
    pub(crate) behind: Vec<Box<dyn AnyOutputPort>>,
    ticks: Writer<Ticks>,
    pub(crate) planners: Waker,
    runs: Runs,
    /// A frame comes every n-th tick, n at least 1.
    every: u32,
}

struct Open<'a>(&'a Bus, &'a Limits);

impl OfChannel for Open<'_> {
    type Made = anyhow::Result<Box<dyn AnyOutputPort>>;

    fn make<C: Channel>(&self, service: Carried) -> Self::Made {
        Ok(Box::new(OutputPort::<C>::open(service, self.0, self.1)?))
    }
}

impl WorkerPorts {
    pub(crate) fn open(bus: &Bus, config: &Config, every: u32) -> anyhow::Result<Self> {
        let limits = config.limits();
        let behind = Carried::behind_forecasts(&Open(bus, &limits));
        Ok(Self {
            forecasts: OutputPort::open(Carried::FORECASTS, bus, &limits)?,
            behind: behind.into_iter().collect::<Result<_, _>>()?,
            ticks: bus.writer(&limits)?,
            planners: bus.planner_waker(&limits)?,
            runs: Runs::default(),
            every,
        })
    }

    /// [`Carried::bit`]s of the services that a worker writes only while somebody here reads them,
    /// and that nobody reads.
    pub(crate) fn unread(&self) -> u32 {
        let unread = self.behind.iter().filter(|port| port.is_unread());
        unread.fold(0, |bits, port| bits | port.service().bit())
    }

    /// After a frame of forecasts. Who is not woken finds it within 100 ms.
    pub(crate) fn wake_planners(&self) {
        if let Err(error) = self.planners.wake(WakeEvent::Frame) {
            tracing::debug!(%error, "planners were not woken");
        }
    }

    /// Writes a frame as the worker of this host would. Services that were not requested are not
    /// accepted, and have no port.
    pub(crate) fn pass_on(&mut self, accepted: &Accepted<'_>) -> Result<(), PassError> {
        let service = accepted.frame.service;
        let Self { forecasts, behind, ticks, runs, every, .. } = self;
        let to = (runs, *every);
        if service == Carried::FORECASTS {
            forecasts.pass_on(accepted, to)?;
            self.wake_planners();
        } else if service == Carried::TICKS {
            pass_on(ticks, accepted, to)?;
        } else if let Some(port) = behind.iter_mut().find(|port| port.service() == service) {
            port.pass_on(accepted, to)?;
        }
        Ok(())
    }
}
