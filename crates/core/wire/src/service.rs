//! Names of the services in shared memory.

/// A service of a fleet: that of a [`crate::Channel`], of questions, or of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Service(&'static str);

impl Service {
    /// Request-response, slices of `f64` with header [`crate::QueryHeader`], words of 8 bytes with
    /// header [`crate::AnswerHeader`]: questions about plans.
    pub const ASK: Self = Self("ask");
    /// Event: clients wake the thread that answers.
    pub const ASKED: Self = Self("asked");
    /// Event: the thread that answers wakes a client.
    pub const ANSWERED: Self = Self("answered");
    /// Event: sources wake the worker.
    pub const ARRIVALS: Self = Self("arrivals");
    /// Event: the worker wakes planners.
    pub const WAKE: Self = Self("wake");

    /// The service whose name ends so: `a–z` and `_`.
    #[must_use]
    pub const fn named(name: &'static str) -> Self {
        Self(name)
    }

    /// The last component of the service's name.
    pub const fn name(self) -> &'static str {
        self.0
    }
}

/// The service's full name: `joulebus/<fleet>/<service>`.
#[must_use]
pub fn service_name(fleet: &str, service: Service) -> String {
    format!("joulebus/{fleet}/{}", service.name())
}

/// Ids of the events on [`Service::WAKE`] and [`Service::ARRIVALS`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WakeEvent {
    /// A new frame is available.
    Frame,
    /// The peer process died.
    Died,
    /// The peer process ended normally.
    Ended,
    /// The worker is on another host, and nothing comes from there.
    Unreachable,
}

impl WakeEvent {
    /// The event id.
    pub const fn id(self) -> usize {
        self as usize
    }
}
