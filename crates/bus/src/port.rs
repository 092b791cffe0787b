//! Ports: what the services carry, and how all ports are made.

use std::rc::Rc;
use std::sync::atomic::{AtomicU64, Ordering};

use iceoryx2::port::DegradationAction;
use iceoryx2::prelude::EventId;
use joulebus_wire::{
    Budget, BudgetHeader, Diagnostic, DiagnosticHeader, Forecast, ForecastHeader, Sample,
    SampleHeader, Service, StateHeader, TakenFrame, TickHeader, WakeEvent,
};

use crate::open::{OpenError, open_event};
use crate::reader::Reader;
use crate::wait::{Waiter, Waker};
use crate::writer::Writer;
use crate::{Bus, Limits};

/// The worker's port for forecasts.
pub type ForecastWriter = Writer<ForecastHeader, Forecast>;
/// The worker's port for diagnostics.
pub type DiagnosticWriter = Writer<DiagnosticHeader, Diagnostic>;
/// The worker's port for budgets.
pub type BudgetWriter = Writer<BudgetHeader, Budget>;
/// The worker's port for its journal.
pub type TickWriter = Writer<TickHeader, TakenFrame>;
/// A planner's port for forecasts.
pub type ForecastReader = Reader<ForecastHeader, Forecast>;
/// A planner's port for diagnostics.
pub type DiagnosticReader = Reader<DiagnosticHeader, Diagnostic>;
/// A planner's port for budgets.
pub type BudgetReader = Reader<BudgetHeader, Budget>;
/// The worker's port for keyframes.
pub type StateWriter = Writer<StateHeader, u8>;
/// A recorder's port for keyframes.
pub type StateReader = Reader<StateHeader, u8>;
/// A recorder's port for samples: reads what the worker reads, without being it.
pub type SampleTap = Reader<SampleHeader, Sample>;
/// A recorder's port for the worker's journal.
pub type TickReader = Reader<TickHeader, TakenFrame>;

/// Counts instead of failing at once: failing would leave the ports after this one unconnected
/// too, and nothing would try them again. The reader turns the count into an error.
pub(crate) fn count_degradation(counted: &AtomicU64) -> DegradationAction {
    counted.fetch_add(1, Ordering::Relaxed);
    DegradationAction::Ignore
}

pub(crate) fn waker(
    bus: &Bus,
    service: Service,
    limits: &Limits,
    ports: (usize, usize),
) -> Result<Waker, OpenError> {
    let notifier = open_event(bus, service, limits, ports)?
        .notifier_builder()
        .default_event_id(EventId::new(WakeEvent::Frame.id()))
        .create()
        .map_err(|reason| OpenError::port(service, reason))?;
    Ok(Waker::new(notifier, Rc::clone(&bus.member)))
}

pub(crate) fn waiter(
    bus: &Bus,
    service: Service,
    limits: &Limits,
    ports: (usize, usize),
) -> Result<Waiter, OpenError> {
    let listener = open_event(bus, service, limits, ports)?
        .listener_builder()
        .create()
        .map_err(|reason| OpenError::port(service, reason))?;
    Ok(Waiter::new(listener, Rc::clone(&bus.member)))
}
