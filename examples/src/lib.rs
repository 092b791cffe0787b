//! Setup of the live examples: a private fleet in a temporary directory, so that an example neither
//! needs a running worker nor interferes with one.
#![forbid(unsafe_code)]

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use joulebus_capture_recorder::{Options, Recorder, Target, attach, host_clock};
use joulebus_config::Config;
use joulebus_predictor_worker::Worker;
use joulebus_publisher::{Pace, Publisher, RobotState};
use tempfile::TempDir;

/// The programs in these pages are compiled unchanged. READMEs that are a crate's documentation are
/// tested there.
#[cfg(doctest)]
mod readme {
    macro_rules! compile {
        ($($name:ident = $file:literal),* $(,)?) => { $(#[doc = include_str!($file)] pub struct $name;)* };
    }
    compile! {
        Joulebus = "../../README.md",
        Planning = "../../docs/how-to/ask.md",
        Queries = "../../docs/how-to/ask-the-worker.md",
    }
}

/// A private config file and shared memory. Dropping it stops the worker and removes both.
#[derive(Debug)]
pub struct PrivateFleet {
    config: PathBuf,
    stop: Arc<AtomicBool>,
    worker: Option<JoinHandle<()>>,
    // Last: it contains the worker's files.
    _directory: TempDir,
}

impl PrivateFleet {
    /// A fleet of `platforms`, the `[[platform]]` tables of its config, without a worker.
    ///
    /// # Errors
    /// `/dev/shm` cannot be written to.
    pub fn new(platforms: &str) -> anyhow::Result<Self> {
        let directory = TempDir::with_prefix_in("joulebus-example-", "/dev/shm")?;
        let root = directory.path().join("domain");
        let config = directory.path().join("fleet.toml");
        let fleet = "[fleet]\nname = \"example\"\ncapacity = 100\n";
        let domain = format!("[domain]\nroot = \"{}\"\n", root.display());
        let ledger = "[ledger]\ncheckpoint = \"ledger.json\"\n";
        fs::write(&config, [fleet, &domain, ledger, platforms].concat())?;
        Ok(Self { config, stop: Arc::default(), worker: None, _directory: directory })
    }

    /// Same as [`PrivateFleet::new`], with a worker in a thread of this process, ready for samples.
    ///
    /// # Errors
    /// The config is refused, or the worker cannot start.
    pub fn with_worker(platforms: &str) -> anyhow::Result<Self> {
        let mut fleet = Self::new(platforms)?;
        fleet.start_worker()?;
        Ok(fleet)
    }

    /// Starts the worker in a thread of this process, once.
    ///
    /// # Errors
    /// The config is refused, or the worker cannot start.
    pub fn start_worker(&mut self) -> anyhow::Result<()> {
        let config = Config::load(&self.config)?;
        let stop = Arc::clone(&self.stop);
        let (ready, started) = mpsc::channel();
        // A worker must stay on the thread that opened it.
        self.worker = Some(thread::spawn(move || match Worker::open(&config) {
            Ok(mut worker) => {
                let _ = ready.send(Ok(()));
                if let Err(error) = worker.run(&stop) {
                    eprintln!("the worker has ended: {error}");
                }
                let _ = worker.finish();
            }
            Err(error) => {
                let _ = ready.send(Err(error.to_string()));
            }
        }));
        started.recv()?.map_err(anyhow::Error::msg)?;
        Ok(())
    }

    /// Its config file, for every process of the fleet.
    pub fn config(&self) -> &Path {
        &self.config
    }
}

impl Drop for PrivateFleet {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(worker) = self.worker.take() {
            let _ = worker.join();
        }
    }
}

/// Records a fleet of ten robots for two seconds, as `joulebus record` does, into `file`.
///
/// # Errors
/// The fleet cannot start, the file cannot be written, or the recorder got no processor in time and
/// lost messages.
pub fn record(file: &Path) -> anyhow::Result<()> {
    let mut fleet =
        PrivateFleet::new("[[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-9\"]\n")?;
    let config = Config::load(fleet.config())?;
    let clock = host_clock();
    // The capture contains config, models and build: it can be replayed on its own.
    let attachments = attach(std::slice::from_ref(&config), clock)?;
    let target = Target::File(file.to_owned());
    // Started before the worker, so that its first tick is in the capture.
    let recorder =
        Recorder::start(&config, Vec::new(), clock, attachments, target, &Options::default())?;
    fleet.start_worker()?;
    let mut publisher = Publisher::with_config(&config, "controller")?;
    let mut pace = Pace::every(Duration::from_nanos(33_333_333));
    for tick in 0..60 {
        pace.wait();
        let robots = (0..10).map(|robot| {
            let v_mps = 0.1 + 0.05 * (0.1 * tick as f32 + robot as f32).sin();
            RobotState::new(robot).command(v_mps, 0.0).reading(2.8 + 9.0 * v_mps)
        });
        publisher.publish(robots)?;
    }
    let summary = recorder.finish();
    match (&summary.failure, summary.messages_lost()) {
        (Some(failure), _) => Err(anyhow::Error::msg(failure.clone())),
        (None, 0) => Ok(()),
        (None, lost) => {
            anyhow::bail!("the recorder lost {lost} messages: is the machine busy?")
        }
    }
}
