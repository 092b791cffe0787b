//! What the live examples start before their subject begins: a fleet of its own, in a temporary
//! directory, so that an example neither needs a running worker nor meets one.
#![forbid(unsafe_code)]

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::{self, JoinHandle};

use joulebus_config::Config;
use joulebus_predictor_worker::Worker;
use tempfile::TempDir;

/// The programs in the README are compiled as they stand.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
pub struct Readme;

/// A config file and shared memory that nobody else uses. Ending it stops the worker and removes both.
#[derive(Debug)]
pub struct PrivateFleet {
    config: PathBuf,
    stop: Arc<AtomicBool>,
    worker: Option<JoinHandle<()>>,
    // Last: the worker's files lie in it.
    _directory: TempDir,
}

impl PrivateFleet {
    /// A fleet of `platforms`, the `[[platform]]` tables of its config, without a worker.
    ///
    /// # Errors
    /// `/dev/shm` cannot be written to.
    pub fn new(platforms: &str) -> Result<Self, Box<dyn Error>> {
        let directory = TempDir::with_prefix_in("joulebus-example-", "/dev/shm")?;
        let root = directory.path().join("domain");
        let config = directory.path().join("fleet.toml");
        let fleet = "[fleet]\nname = \"example\"\ncapacity = 100\n";
        let domain = format!("[domain]\nroot = \"{}\"\n", root.display());
        fs::write(&config, [fleet, &domain, platforms].concat())?;
        Ok(Self {
            config,
            stop: Arc::default(),
            worker: None,
            _directory: directory,
        })
    }

    /// As [`PrivateFleet::new`], with a worker in a thread of this process, ready for samples.
    ///
    /// # Errors
    /// The config is refused, or the worker cannot start.
    pub fn with_worker(platforms: &str) -> Result<Self, Box<dyn Error>> {
        let mut fleet = Self::new(platforms)?;
        let config = Config::load(&fleet.config)?;
        let stop = Arc::clone(&fleet.stop);
        let (ready, started) = mpsc::channel();
        // A worker belongs to the thread that opened it.
        fleet.worker = Some(thread::spawn(move || match Worker::open(&config) {
            Ok(worker) => {
                let _ = ready.send(Ok(()));
                if let Err(error) = worker.run(&stop) {
                    eprintln!("the worker has ended: {error}");
                }
            }
            Err(error) => {
                let _ = ready.send(Err(error.to_string()));
            }
        }));
        started.recv()??;
        Ok(fleet)
    }

    /// Its config file, for every process of the fleet.
    #[must_use]
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
