//! A process's membership in a domain, and the ports it opens.

use std::rc::Rc;
use std::time::{Duration, Instant};

use iceoryx2::config::Config;
use iceoryx2::node::{Node, NodeBuilder};
use iceoryx2::prelude::{NodeName, SignalHandlingMode, ipc};
use joulebus_wire::Service;
use rustix::fs::Mode;

use crate::incomplete::{objects, remove_stillborn};
use crate::keeper::Housekeeping;
use crate::membership::Membership;
use crate::open::OpenError;
use crate::stale_cleanup::{SweepReport, remove_dead_nodes};
use crate::wait::{Waiter, Waker};
use crate::{
    BudgetReader, BudgetWriter, DiagnosticReader, DiagnosticWriter, Domain, ForecastReader,
    ForecastWriter, JoinError, Limits, SampleReader, SampleTap, SampleWriter, StateReader,
    StateWriter, TickReader, TickWriter,
};
use crate::{port, reader, writer};

/// For how long a node is tried to be created.
const NODE_LIMIT: Duration = Duration::from_secs(2);
const NODE_AGAIN_AFTER: Duration = Duration::from_millis(10);

/// Membership in a domain. Dropping it and all ports leaves; the last member to leave removes
/// everything.
///
/// Belongs to one thread. iceoryx2's own signal handling is off: signals stay the program's.
pub struct Bus {
    pub(crate) node: Node<ipc::Service>,
    pub(crate) member: Rc<Membership>,
    joined: SweepReport,
}

impl Bus {
    /// Joins `domain` as `name`, for example `worker`. First removes what dead processes have left;
    /// if nobody is alive, everything. Takes 1 ms on a tmpfs, at most 5 s.
    ///
    /// # Errors
    /// [`JoinError`] says what is in the way and what to do.
    pub fn join(domain: &Domain, name: &str) -> Result<Self, JoinError> {
        let node_name = NodeName::new(name)
            .ok()
            .filter(|_| !name.is_empty())
            .ok_or_else(|| JoinError::Name {
                name: name.to_owned(),
            })?;
        for warning in domain.prepare().unwrap_or_default() {
            tracing::warn!("{warning}");
        }
        let (member, mut joined) = Membership::join(domain)?;
        let config = Config::global_config();
        joined.incomplete += remove_stillborn(domain)?;
        remove_dead_nodes(config, &mut joined);
        let node = create_node(domain, &node_name)?;
        make_private(domain)?;
        if !joined.is_clean() {
            let report = joined;
            tracing::info!(?report, "removed what dead processes had left");
        }
        Ok(Self {
            node,
            member: Rc::new(member),
            joined,
        })
    }

    /// The domain.
    #[must_use]
    pub fn domain(&self) -> &Domain {
        &self.member.domain
    }

    /// What was removed while joining.
    #[must_use]
    pub const fn joined(&self) -> SweepReport {
        self.joined
    }

    /// What the keeper has removed since: it looks for unfinished objects four times a second and
    /// for dead nodes once a second.
    #[must_use]
    pub fn housekeeping(&self) -> Housekeeping {
        self.member.keeper.counts()
    }

    /// A source's port. `max_len`: samples that one frame may hold, at most the capacity.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn sample_writer(
        &self,
        limits: &Limits,
        max_len: usize,
    ) -> Result<SampleWriter, OpenError> {
        writer::sample_writer(self, limits, max_len)
    }

    /// The worker's port for samples of all sources.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn sample_reader(&self, limits: &Limits) -> Result<SampleReader, OpenError> {
        reader::reader(self, Service::Samples, limits, limits.samples()).map(SampleReader::new)
    }

    /// The worker's port for forecasts.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn forecast_writer(&self, limits: &Limits) -> Result<ForecastWriter, OpenError> {
        let shape = limits.forecasts();
        writer::writer(self, Service::Forecasts, limits, shape, limits.capacity)
    }

    /// The worker's port for diagnostics.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn diagnostic_writer(&self, limits: &Limits) -> Result<DiagnosticWriter, OpenError> {
        let shape = limits.forecasts();
        writer::writer(self, Service::Diagnostics, limits, shape, limits.capacity)
    }

    /// The worker's port for budgets.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn budget_writer(&self, limits: &Limits) -> Result<BudgetWriter, OpenError> {
        let shape = limits.budgets();
        writer::writer(self, Service::Budgets, limits, shape, limits.capacity)
    }

    /// The worker's port for its journal; frames of up to [`Limits::listed_frames`].
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn tick_writer(&self, limits: &Limits) -> Result<TickWriter, OpenError> {
        let (shape, listed) = (limits.ticks(), limits.listed_frames());
        writer::writer(self, Service::Ticks, limits, shape, listed)
    }

    /// A recorder's port for the worker's journal.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn tick_reader(&self, limits: &Limits) -> Result<TickReader, OpenError> {
        reader::reader(self, Service::Ticks, limits, limits.ticks())
    }

    /// A recorder's port for samples of all sources.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn sample_tap(&self, limits: &Limits) -> Result<SampleTap, OpenError> {
        reader::reader(self, Service::Samples, limits, limits.samples())
    }

    /// A planner's port for forecasts.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn forecast_reader(&self, limits: &Limits) -> Result<ForecastReader, OpenError> {
        reader::reader(self, Service::Forecasts, limits, limits.forecasts())
    }

    /// A planner's port for diagnostics.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn diagnostic_reader(&self, limits: &Limits) -> Result<DiagnosticReader, OpenError> {
        reader::reader(self, Service::Diagnostics, limits, limits.forecasts())
    }

    /// A planner's port for budgets; the newest frame comes at once.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn budget_reader(&self, limits: &Limits) -> Result<BudgetReader, OpenError> {
        reader::reader(self, Service::Budgets, limits, limits.budgets())
    }

    /// The worker's port for keyframes; a piece holds [`Writer::max_len`](crate::Writer::max_len)
    /// bytes.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn state_writer(&self, limits: &Limits) -> Result<StateWriter, OpenError> {
        let shape = limits.state();
        let piece = limits.state_piece_bytes();
        writer::writer(self, Service::State, limits, shape, piece)
    }

    /// A recorder's port for keyframes. While it is open, the worker sends them.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn state_reader(&self, limits: &Limits) -> Result<StateReader, OpenError> {
        reader::reader(self, Service::State, limits, limits.state())
    }

    /// Waits for samples: the worker.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn arrivals_waiter(&self, limits: &Limits) -> Result<Waiter, OpenError> {
        port::waiter(self, Service::Arrivals, limits, limits.arrivals())
    }

    /// Wakes planners: the worker.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn planner_waker(&self, limits: &Limits) -> Result<Waker, OpenError> {
        port::waker(self, Service::Wake, limits, limits.wake())
    }

    /// Waits for forecasts: planners.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn planner_waiter(&self, limits: &Limits) -> Result<Waiter, OpenError> {
        port::waiter(self, Service::Wake, limits, limits.wake())
    }
}

/// Creates the node. About once in 300 starts next to a process killed at its own start, while
/// members clean up, iceoryx2 answers `InternalError`: that passes.
fn create_node(domain: &Domain, name: &NodeName) -> Result<Node<ipc::Service>, JoinError> {
    let begin = Instant::now();
    loop {
        let created = NodeBuilder::new()
            .name(name)
            .config(Config::global_config())
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>();
        let reason = match created {
            Ok(node) => return Ok(node),
            Err(reason) => reason,
        };
        if begin.elapsed() > NODE_LIMIT {
            return Err(JoinError::Node {
                root: domain.directory(),
                reason: reason.to_string(),
            });
        }
        tracing::info!(%reason, "creating a node again");
        std::thread::sleep(NODE_AGAIN_AFTER);
    }
}

/// iceoryx2 makes its node counter writable by everybody; only members need it.
fn make_private(domain: &Domain) -> Result<(), JoinError> {
    for object in objects(domain)? {
        if object.mode & 0o077 != 0
            && let Err(error) = rustix::fs::chmod(&object.path, Mode::RUSR | Mode::WUSR)
        {
            tracing::warn!(path = ?object.path, %error, "an object stays open to other users");
        }
    }
    Ok(())
}
