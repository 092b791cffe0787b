//! Opening of a service by a member. The simulator compiles this file too.

use joulebus_wire::{Channel, Forecasts, Service};

use super::OpenPlaces;
use crate::{
    Bus, Limits, OpenError, Poller, QueryClient, QueryServer, Reader, SampleReader, SampleWriter,
    Waiter, Waker, Writer,
};

impl Bus {
    /// A source's port. `max_len`: maximum number of samples per frame, at most the capacity.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn sample_writer(
        &self,
        limits: &Limits,
        max_len: usize,
    ) -> Result<SampleWriter, OpenError> {
        SampleWriter::open(self, limits, max_len)
    }

    /// The worker's port for samples of all sources.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn sample_reader(&self, limits: &Limits) -> Result<SampleReader, OpenError> {
        self.reader(limits).map(SampleReader::new)
    }

    /// Reads a channel. Of the worker's channels it reads only frames of the process that holds the
    /// worker's lock. While a reader of plan states, keyframes or records of questions is open, the
    /// worker sends them. The worker's own readers, recorders and links have places that planners
    /// and views cannot take.
    ///
    /// # Errors
    /// [`OpenError`]. [`OpenError::Places`] names who has the places.
    pub fn reader<C: Channel>(&self, limits: &Limits) -> Result<Reader<C>, OpenError> {
        Reader::open(self, limits)
    }

    /// Writes a channel, in frames of up to [`Limits::rows`]. For samples, see
    /// [`Bus::sample_writer`].
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn writer<C: Channel>(&self, limits: &Limits) -> Result<Writer<C>, OpenError> {
        Writer::open(self, limits, limits.rows(C::ROWS))
    }

    /// The worker's port for questions.
    ///
    /// # Errors
    /// [`OpenError`]: among others, there is one already.
    pub fn query_server(&self, limits: &Limits) -> Result<QueryServer, OpenError> {
        QueryServer::open(self, limits)
    }

    /// A client's port for questions.
    ///
    /// # Errors
    /// [`OpenError`]: among others, there are as many as planners are allowed, or 16.
    pub fn query_client(&self, limits: &Limits) -> Result<QueryClient, OpenError> {
        QueryClient::open(self, limits)
    }

    /// Waits for samples: the worker.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn arrivals_waiter(&self, limits: &Limits) -> Result<Waiter, OpenError> {
        Waiter::open(self, Service::ARRIVALS, limits, limits.arrivals(), None)
    }

    /// Wakes planners: the worker.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn planner_waker(&self, limits: &Limits) -> Result<Waker, OpenError> {
        Waker::open(self, Service::WAKE, limits, limits.wake())
    }

    /// Waits for forecasts: planners.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn planner_waiter(&self, limits: &Limits) -> Result<Waiter, OpenError> {
        let open = OpenPlaces::new(limits, Forecasts::FLOW);
        Waiter::open(self, Service::WAKE, limits, limits.wake(), Some(open))
    }

    /// Waits for times instead: readers that look now and then.
    pub fn planner_poller(&self) -> Poller {
        Poller::new(self)
    }
}
