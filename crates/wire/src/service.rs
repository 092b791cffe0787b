//! Names of the services in shared memory.

/// A service of a fleet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Service {
    /// Publish-subscribe, slices of [`crate::Sample`], header [`crate::SampleHeader`].
    Samples,
    /// Publish-subscribe, slices of [`crate::Forecast`], header [`crate::ForecastHeader`].
    Forecasts,
    /// Publish-subscribe, slices of [`crate::Diagnostic`], header [`crate::DiagnosticHeader`].
    Diagnostics,
    /// Publish-subscribe with history, slices of [`crate::Budget`], header [`crate::BudgetHeader`].
    Budgets,
    /// Publish-subscribe with history, slices of [`crate::PlanState`], header
    /// [`crate::PlanStateHeader`]: sent while somebody reads it.
    PlanStates,
    /// Publish-subscribe, slices of [`crate::TakenFrame`], header [`crate::TickHeader`]: the
    /// worker's journal.
    Ticks,
    /// Publish-subscribe, slices of bytes, header [`crate::StateHeader`]: keyframes.
    State,
    /// Publish-subscribe with history, words of 8 bytes, header [`crate::QueriesHeader`]: records of
    /// questions and answers.
    Queries,
    /// Request-response, slices of `f64` with header [`crate::QueryHeader`], words of 8 bytes with
    /// header [`crate::AnswerHeader`]: questions about plans.
    Ask,
    /// Event: clients wake the thread that answers.
    Asked,
    /// Event: the thread that answers wakes a client.
    Answered,
    /// Event: sources wake the worker.
    Arrivals,
    /// Event: the worker wakes planners.
    Wake,
}

impl Service {
    /// All services.
    pub const ALL: [Self; 13] = [
        Self::Samples,
        Self::Forecasts,
        Self::Diagnostics,
        Self::Budgets,
        Self::PlanStates,
        Self::Ticks,
        Self::State,
        Self::Queries,
        Self::Ask,
        Self::Asked,
        Self::Answered,
        Self::Arrivals,
        Self::Wake,
    ];

    /// The last component of the service's name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Samples => "samples",
            Self::Forecasts => "forecasts",
            Self::Diagnostics => "diagnostics",
            Self::Budgets => "budgets",
            Self::PlanStates => "plan_states",
            Self::Ticks => "ticks",
            Self::State => "state",
            Self::Queries => "queries",
            Self::Ask => "ask",
            Self::Asked => "asked",
            Self::Answered => "answered",
            Self::Arrivals => "arrivals",
            Self::Wake => "wake",
        }
    }
}

/// The service's full name: `joulebus/<fleet>/<service>`.
#[must_use]
pub fn service_name(fleet: &str, service: Service) -> String {
    format!("joulebus/{fleet}/{}", service.name())
}

/// Ids of the events on [`Service::Wake`] and [`Service::Arrivals`].
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
    #[must_use]
    pub const fn id(self) -> usize {
        self as usize
    }
}
