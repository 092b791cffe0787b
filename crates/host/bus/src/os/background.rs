//! Work in the background: a thread that repeats a step.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::thread::JoinHandle;
use std::time::Duration;

/// Work that is done step by step.
pub trait Steps {
    /// Does what is due. `last`: this is the last call. Returns the longest pause before the next
    /// step, or `None` if there is nothing more to do.
    fn step(&mut self, last: bool) -> Option<Duration>;
}

/// A running thread that repeats a step; stopped when dropped.
#[derive(Debug)]
pub struct Background {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// The thread has panicked.
#[derive(Debug, thiserror::Error)]
#[error("the thread {name} panicked")]
pub struct Panicked {
    /// Its name.
    pub name: String,
}

impl Background {
    /// Starts a thread named `name`, and waits until `open` has returned in it: ports belong to the
    /// thread that opens them.
    ///
    /// # Errors
    /// That of `open`, or that of the system if the thread could not be started.
    pub fn start<S: Steps, E: From<io::Error> + Send + 'static>(
        name: &str,
        open: impl FnOnce() -> Result<S, E> + Send + 'static,
    ) -> Result<Self, E> {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let (ready, started) = sync_channel(1);
        let builder = std::thread::Builder::new().name(name.to_owned());
        let thread = builder.spawn(move || {
            let (opened, steps) = match open() {
                Ok(steps) => (Ok(()), Some(steps)),
                Err(error) => (Err(error), None),
            };
            // The caller waits for the message.
            let _ = ready.send(opened);
            if let Some(steps) = steps {
                repeat(steps, &stopped);
            }
        })?;
        let died = |_| io::Error::other(format!("the thread {name} died at its start"));
        started.recv().map_err(died)??;
        Ok(Self {
            stop,
            thread: Some(thread),
        })
    }

    /// Ends the pause of the thread: its next step is due.
    pub fn wake(&self) {
        if let Some(thread) = &self.thread {
            thread.thread().unpark();
        }
    }

    /// Lets the thread do its last step, and waits for it.
    ///
    /// # Errors
    /// [`Panicked`].
    pub fn finish(&mut self) -> Result<(), Panicked> {
        self.stop.store(true, Ordering::Relaxed);
        let Some(thread) = self.thread.take() else {
            return Ok(());
        };
        thread.thread().unpark();
        let name = thread.thread().name().unwrap_or_default().to_owned();
        thread.join().map_err(|_| Panicked { name })
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        if let Err(error) = self.finish() {
            tracing::error!("{error}");
        }
    }
}

fn repeat(mut steps: impl Steps, stop: &AtomicBool) {
    loop {
        let last = stop.load(Ordering::Relaxed);
        match steps.step(last) {
            // Even a pause of nothing would last as long as the kernel's timer slack, 50 µs.
            Some(Duration::ZERO) if !last => {}
            Some(pause) if !last => std::thread::park_timeout(pause),
            _ => return,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    struct Counted {
        calls: Arc<Mutex<Vec<bool>>>,
        most: usize,
    }

    impl Steps for Counted {
        fn step(&mut self, last: bool) -> Option<Duration> {
            let mut calls = self.calls.lock().unwrap();
            calls.push(last);
            (calls.len() < self.most).then_some(Duration::from_secs(3_600))
        }
    }

    fn counted(most: usize) -> (Counted, Arc<Mutex<Vec<bool>>>) {
        let calls = Arc::new(Mutex::new(Vec::new()));
        let of_thread = Arc::clone(&calls);
        (
            Counted {
                calls: of_thread,
                most,
            },
            calls,
        )
    }

    #[test]
    fn the_last_step_is_done_without_waiting_for_the_pause_and_once() {
        let (steps, calls) = counted(100);
        let mut background = Background::start("steps", move || io::Result::Ok(steps)).unwrap();
        background.finish().unwrap();
        background.finish().unwrap();
        drop(background);
        let calls = calls.lock().unwrap();
        assert_eq!(calls.iter().filter(|last| **last).count(), 1);
        assert_eq!(calls.last(), Some(&true));
    }

    #[test]
    fn work_that_has_ended_is_not_repeated_and_errors_of_the_start_are_returned() {
        let (steps, calls) = counted(1);
        let mut background = Background::start("steps", move || io::Result::Ok(steps)).unwrap();
        background.finish().unwrap();
        assert_eq!(calls.lock().unwrap().len(), 1);
        let refused = Background::start("refused", || {
            Err::<Counted, _>(io::Error::other("not today"))
        });
        assert_eq!(refused.unwrap_err().to_string(), "not today");
        let died = Background::start("dies", || -> io::Result<Counted> { panic!("at the start") });
        assert!(died.unwrap_err().to_string().contains("thread dies died"));
    }
}
