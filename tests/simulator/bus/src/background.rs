//! Threads of a process, driven by the simulator.

use std::cell::RefCell;
use std::io;
use std::rc::Rc;

use joulebus_simulated_host as host;

use crate::Panicked;
pub use joulebus_bus::{Rounds, Steps};

/// A thread that the simulator drives; stopped when dropped. It ends with a `T`.
#[derive(Debug)]
pub struct Background<T = ()> {
    number: u64,
    ended: Rc<RefCell<Option<T>>>,
}

impl Background {
    pub fn start<S: Steps + 'static, E: From<io::Error> + Send + 'static>(
        _name: &str,
        open: impl FnOnce() -> Result<S, E> + Send + 'static,
    ) -> Result<Self, E> {
        host::operation();
        let mut steps = open()?;
        let number = host::start_thread(Box::new(move |last| steps.step(last)));
        Ok(Self { number, ended: Rc::default() })
    }
}

impl<T: 'static, E: From<io::Error> + 'static> Background<Result<T, E>> {
    /// Starts a thread that repeats its rounds.
    pub fn repeat<W: Rounds<T, E> + 'static, J>(
        _name: &str,
        open: impl FnOnce() -> Result<(W, J), E>,
    ) -> Result<(Self, J), E> {
        host::operation();
        let number = host::number();
        let (work, joined) = host::as_thread(number, open)?;
        let ended = Rc::new(RefCell::new(None));
        let (mut work, result) = (Some(work), Rc::clone(&ended));
        let round = move |last: bool| {
            let failed = match work.as_mut().filter(|_| !last).map(W::round) {
                Some(Ok(pause)) => return Some(pause),
                Some(Err(error)) => Some(error),
                None => None,
            };
            let work = work.take()?;
            *result.borrow_mut() = Some(failed.map_or_else(|| work.finish(), Err));
            None
        };
        host::start_numbered(number, Box::new(round));
        Ok((Self { number, ended }, joined))
    }

    /// Stops the thread, and returns what it ended with.
    pub fn join(mut self) -> Result<T, E> {
        let _ = self.finish();
        let ended = self.ended.take();
        ended.unwrap_or_else(|| Err(io::Error::other("the process was killed").into()))
    }
}

/// Threads end only while somebody waits for them.
#[derive(Debug, Clone)]
pub struct ThreadWatch;

impl ThreadWatch {
    /// None is reported.
    pub const fn name(&self) -> &str {
        ""
    }

    pub const fn has_ended(&self) -> bool {
        false
    }
}

impl<T> Background<T> {
    /// Tells others whether the thread has ended.
    pub const fn watch(&self) -> ThreadWatch {
        ThreadWatch
    }

    /// True if the thread has ended by itself.
    pub fn has_ended(&self) -> bool {
        self.ended.borrow().is_some()
    }

    /// Ends the pause of the thread.
    pub fn wake(&self) {
        host::wake_thread(self.number);
    }

    /// The simulator lets a thread end only while somebody waits for it.
    pub const fn stop(&self) {}

    /// Lets the thread do its last step.
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

impl<T> Drop for Background<T> {
    fn drop(&mut self) {
        // No thread is left that could panic.
        let _ = self.finish();
    }
}
