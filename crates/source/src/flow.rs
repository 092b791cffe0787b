//! Flow control: follows the worker, so that it does not get more than it can take.

use joulebus_bus::{Bus, Domain, Limits, PeerWatch, Reader, Waiter, WorkerLock, clock};
use joulebus_program::output::log_line;
use joulebus_program::stop::Stop;
use joulebus_wire::{Forecasts, SCHEMA_VERSION, Sample, forecast_flag};

use crate::window::Window;

/// Silence of the worker before a warning, ns.
const PATIENCE_NS: u64 = 2_000_000_000;
/// Maximum sleep while the worker is silent, ns.
const POLL_INTERVAL_NS: u64 = 50_000_000;

/// State of the worker as seen by a source.
#[derive(Debug)]
pub struct Flow {
    window: Window,
    // Drop order: ports before the bus.
    forecasts: Reader<Forecasts>,
    waiter: Waiter,
    _bus: Bus,
    domain: Domain,
    source_epoch: u64,
    worker: Option<HeardWorker>,
    /// Frames lost with a worker.
    pub unanswered: u64,
}

#[derive(Debug)]
struct HeardWorker {
    epoch: u64,
    process: Option<PeerWatch>,
}

/// Readiness of the fleet for a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SendWindow {
    /// The source may send.
    Free,
    /// The worker has ended.
    NoWorker,
    /// A signal arrived.
    Stopped,
}

impl Flow {
    /// Follows the worker of `domain` for the source with `source_epoch`.
    ///
    /// # Errors
    /// The fleet cannot be joined, or its forecasts cannot be opened.
    pub fn open(
        domain: &Domain,
        limits: &Limits,
        window: Window,
        source_epoch: u64,
    ) -> anyhow::Result<Self> {
        let bus = Bus::join(domain, "flow-control")?;
        Ok(Self {
            window,
            forecasts: bus.reader(limits)?,
            waiter: bus.planner_waiter(limits)?,
            _bus: bus,
            domain: domain.clone(),
            source_epoch,
            worker: None,
            unanswered: 0,
        })
    }

    /// The fleet's domain.
    pub const fn domain(&self) -> &Domain {
        &self.domain
    }

    /// Waits until the worker has answered enough for `frame`.
    ///
    /// # Errors
    /// The worker writes another schema, or its state cannot be read.
    pub fn wait_for_capacity(
        &mut self,
        frame: &[Sample],
        stop: &Stop,
    ) -> anyhow::Result<SendWindow> {
        self.wait(stop, None, |window| window.has_capacity(frame))
    }

    /// Waits until everything is answered, at most until `until_ns` (monotonic).
    ///
    /// # Errors
    /// The worker writes another schema, or its state cannot be read.
    pub fn settle(&mut self, stop: &Stop, until_ns: u64) -> anyhow::Result<()> {
        self.wait(stop, Some(until_ns), Window::is_empty)?;
        self.unanswered += self.window.forget();
        Ok(())
    }

    /// Records a frame that was sent.
    pub fn sent(&mut self, frame: &[Sample]) {
        self.window.sent(frame, clock::monotonic_ns());
    }

    /// The source continues as run `source_epoch`, unless it already does. Frames of older runs are
    /// no longer waited for.
    pub fn follow(&mut self, source_epoch: u64) {
        if source_epoch > self.source_epoch {
            self.source_epoch = source_epoch;
            self.window.forget();
        }
    }

    /// True if a worker has been observed, so that it takes samples.
    ///
    /// # Errors
    /// The worker writes another schema, or its state cannot be read.
    pub fn has_seen_worker(&mut self) -> anyhow::Result<bool> {
        self.read_newest()?;
        Ok(self.worker.is_some() && !self.is_gone()?)
    }

    fn wait(
        &mut self,
        stop: &Stop,
        until_ns: Option<u64>,
        enough: impl Fn(&Window) -> bool,
    ) -> anyhow::Result<SendWindow> {
        let mut mention_ns = clock::monotonic_ns() + PATIENCE_NS;
        loop {
            self.read_newest()?;
            if enough(&self.window) {
                return Ok(SendWindow::Free);
            }
            let now_ns = clock::monotonic_ns();
            if stop.is_asked() {
                // Frames in transit arrive nevertheless: none is lost.
                self.window.forget();
                return Ok(SendWindow::Stopped);
            }
            if self.is_gone()? {
                self.unanswered += self.window.forget();
                self.worker = None;
                return Ok(SendWindow::NoWorker);
            }
            if until_ns.is_some_and(|until_ns| now_ns >= until_ns) {
                return Ok(SendWindow::Free);
            }
            if now_ns >= mention_ns {
                log_line("the worker runs, but has not answered for 2 s, waiting for it");
                mention_ns = u64::MAX;
            }
            let process = self.worker.as_ref().and_then(|worker| worker.process.as_ref());
            self.waiter.wait_until(Some(now_ns + POLL_INTERVAL_NS), process)?;
        }
    }

    /// Reads the newest forecasts, if there are new ones.
    fn read_newest(&mut self) -> anyhow::Result<()> {
        let frame = match self.forecasts.take_latest() {
            Ok(Some(frame)) => frame,
            Ok(None) => return Ok(()),
            Err(error) => {
                // The next read may succeed.
                tracing::warn!(%error, "forecasts could not be read");
                return Ok(());
            }
        };
        let header = *frame.header();
        anyhow::ensure!(
            header.schema == SCHEMA_VERSION,
            "the worker writes schema {}, this program reads {SCHEMA_VERSION}: use one version",
            header.schema
        );
        if self.worker.as_ref().is_none_or(|worker| worker.epoch != header.worker_epoch) {
            if self.worker.is_some() {
                self.unanswered += self.window.forget();
            }
            self.worker = Some(HeardWorker {
                epoch: header.worker_epoch,
                process: PeerWatch::open(header.pid),
            });
        }
        let answers = frame.payload().iter().filter(|forecast| {
            forecast.flags & forecast_flag::SAMPLE != 0
                && forecast.source_epoch == self.source_epoch
        });
        let answers = answers.map(|forecast| (forecast.robot, forecast.sample_seq));
        self.window.answered(header.compute_start_ns, answers);
        Ok(())
    }

    fn is_gone(&self) -> anyhow::Result<bool> {
        let process = self.worker.as_ref().and_then(|worker| worker.process.as_ref());
        match process {
            Some(process) => Ok(process.is_gone()),
            None => Ok(WorkerLock::owner(&self.domain)?.is_none()),
        }
    }
}
