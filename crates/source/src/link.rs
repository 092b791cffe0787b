//! Connection to a worker: publishing, and detecting a reader.

use joulebus_bus::{Domain, NoWorker, WorkerLock, clock};
use joulebus_config::Config;
use joulebus_program::output::log_line;
use joulebus_program::stop::Stop;
use joulebus_publisher::{PublishError, Publisher};
use joulebus_wire::Sample;

use crate::report::PublishReport;

/// Interval of asking what the worker refuses, ns.
const LOOK_EVERY_NS: u64 = 1_000_000_000;

/// Interval of checks for a worker, ns.
const POLL_INTERVAL_NS: u64 = 100_000_000;

/// A source of the fleet.
#[derive(Debug)]
pub struct Link {
    publisher: Publisher,
    domain: Domain,
    look_ns: u64,
}

/// Result of sending a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// A worker can read it.
    Sent,
    /// There was no reader.
    NoReader,
    /// The frame could not be sent.
    Failed,
}

impl Link {
    /// Opens the source `name` of the config's fleet.
    ///
    /// # Errors
    /// The fleet cannot be joined.
    pub fn open(config: &Config, name: &str) -> anyhow::Result<Self> {
        Ok(Self {
            publisher: Publisher::without_judgement(config, name)?,
            domain: config.domain()?,
            look_ns: 0,
        })
    }

    /// The fleet's domain.
    pub const fn domain(&self) -> &Domain {
        &self.domain
    }

    /// Maximum number of samples per frame.
    pub const fn capacity(&self) -> usize {
        self.publisher.capacity()
    }

    /// When this run of the source began, monotonic ns.
    pub const fn epoch(&self) -> u64 {
        self.publisher.source_epoch()
    }

    /// Sends a frame and counts it. A frame that the bus refuses does not end the program, like a
    /// controller.
    ///
    /// # Errors
    /// The frame is invalid.
    pub fn send(
        &mut self,
        intended_ns: u64,
        frame: &[Sample],
        report: &mut PublishReport,
    ) -> Result<Fate, PublishError> {
        self.look(report);
        match self.publisher.publish_samples(intended_ns, frame) {
            Ok(sent) => {
                report.frames_sent += 1;
                report.samples_sent += frame.len() as u64;
                if let Some(error) = &sent.not_woken {
                    tracing::warn!(%error, "the worker was not woken");
                }
                if sent.readers > 0 {
                    return Ok(Fate::Sent);
                }
                report.frames_unheard += 1;
                Ok(Fate::NoReader)
            }
            Err(PublishError::Send(error)) if !error.is_final() => {
                report.frames_failed += 1;
                tracing::warn!(%error, "a frame was not sent");
                Ok(Fate::Failed)
            }
            Err(error) => Err(error),
        }
    }

    /// Logs each reason for which the worker refuses samples, once.
    fn look(&mut self, report: &mut PublishReport) {
        let now_ns = clock::monotonic_ns();
        if now_ns < self.look_ns {
            return;
        }
        self.look_ns = now_ns + LOOK_EVERY_NS;
        for refused in self.publisher.refusals() {
            let known = report.samples_refused.insert(refused.reason.name(), refused.count);
            if known.is_none() {
                log_line(&format!("warning: {refused}"));
            }
        }
    }

    /// True if a worker runs and reads, checked by a frame without samples.
    ///
    /// # Errors
    /// The lock or the service cannot be used.
    pub fn has_worker(&mut self) -> anyhow::Result<bool> {
        if WorkerLock::owner(&self.domain)?.is_none() {
            return Ok(false);
        }
        match self.publisher.publish_samples(clock::monotonic_ns(), &[]) {
            Ok(sent) => Ok(sent.readers > 0),
            Err(PublishError::Send(error)) if !error.is_final() => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    /// Warns if there is no worker: nobody reads the frames.
    ///
    /// # Errors
    /// Same as [`Link::has_worker`].
    pub fn warn_without_worker(&mut self) -> anyhow::Result<()> {
        if !self.has_worker()? {
            let no_worker = NoWorker::seen_nowhere(&self.domain);
            log_line(&format!("{no_worker}. Samples sent before one starts are lost"));
        }
        Ok(())
    }

    /// Waits for a worker. Returns `false` at a signal.
    ///
    /// # Errors
    /// Same as [`Link::has_worker`].
    pub fn wait_for_worker(&mut self, stop: &Stop) -> anyhow::Result<bool> {
        if self.has_worker()? {
            return Ok(true);
        }
        let no_worker = NoWorker::seen_nowhere(&self.domain);
        log_line(&format!("{no_worker}. Waiting for one"));
        while !self.has_worker()? {
            if !stop.sleep_until(clock::monotonic_ns() + POLL_INTERVAL_NS) {
                return Ok(false);
            }
        }
        Ok(true)
    }
}
