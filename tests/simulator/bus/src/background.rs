//! Threads of a process, driven by the simulator.

use std::io;
use std::time::Duration;

use joulebus_simulated_host as host;

use crate::Panicked;

/// Work that is done step by step.
pub trait Steps {
    /// Does what is due; see `joulebus-bus`.
    fn step(&mut self, last: bool) -> Option<Duration>;
}

/// A thread that the simulator drives; stopped when dropped.
#[derive(Debug)]
pub struct Background {
    number: u64,
}

impl Background {
    /// Starts a thread.
    ///
    /// # Errors
    /// That of `open`.
    pub fn start<S: Steps + 'static, E: From<io::Error> + Send + 'static>(
        _name: &str,
        open: impl FnOnce() -> Result<S, E> + Send + 'static,
    ) -> Result<Self, E> {
        host::operation();
        let mut steps = open()?;
        let number = host::start_thread(Box::new(move |last| steps.step(last)));
        Ok(Self { number })
    }

    /// Ends the pause of the thread.
    pub fn wake(&self) {
        host::wake_thread(self.number);
    }

    /// Lets the thread do its last step.
    ///
    /// # Errors
    /// None: a panic ends the simulation.
    pub fn finish(&mut self) -> Result<(), Panicked> {
        host::operation();
        if let Some(mut work) = host::take_thread(self.number)
            && !host::is_dead()
        {
            work(true);
        }
        Ok(())
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        // No thread is left that could panic.
        let _ = self.finish();
    }
}
