//! A computation on a thread of its own, in a pool of its own, that Ctrl-C ends.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread;

use pyo3::exceptions::{PyOSError, PyRuntimeError};
use pyo3::prelude::*;

use crate::planner::SLICE;

/// Reports the progress of a computation.
pub(super) struct Reporter<P> {
    messages: Sender<Message<P>>,
    is_ended: Arc<AtomicBool>,
}

enum Message<P> {
    Progress(P),
    Done,
}

impl<P> Reporter<P> {
    /// Reports `progress`. `Break` when nobody waits for the result any more.
    pub(super) fn report(&self, progress: P) -> ControlFlow<()> {
        let sent = self.messages.send(Message::Progress(progress));
        match sent.is_err() || self.is_ended.load(Ordering::Relaxed) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    }
}

/// Runs `work` while other Python threads run. `each` is called in this thread with its progress.
/// An exception of a signal or of `each` is raised within [`SLICE`]. The computation then ends at
/// its next progress, and its result is dropped.
pub(super) fn run<T, P>(
    py: Python<'_>,
    work: impl FnOnce(&Reporter<P>) -> PyResult<T> + Send + 'static,
    mut each: impl FnMut(P) -> PyResult<()>,
) -> PyResult<T>
where
    T: Send + 'static,
    P: Send + 'static,
{
    let (sender, mut messages) = channel();
    let (give, mut result) = channel();
    let is_ended = Arc::new(AtomicBool::new(false));
    let reporter = Reporter { messages: sender.clone(), is_ended: Arc::clone(&is_ended) };
    let compute = move || {
        let found = match rayon::ThreadPoolBuilder::new().build() {
            Ok(pool) => pool.install(|| work(&reporter)),
            Err(error) => Err(PyOSError::new_err(format!("cannot start threads: {error}"))),
        };
        let _ = give.send(found);
        let _ = sender.send(Message::Done);
    };
    thread::Builder::new()
        .name("joulebus-lab".to_owned())
        .spawn(compute)
        .map_err(|error| PyOSError::new_err(format!("cannot start a thread: {error}")))?;
    let ended = loop {
        let messages = &mut messages;
        let message = py.detach(move || messages.recv_timeout(SLICE));
        let looked = match message {
            Ok(Message::Progress(progress)) => each(progress),
            Ok(Message::Done) | Err(RecvTimeoutError::Disconnected) => break Ok(()),
            Err(RecvTimeoutError::Timeout) => Ok(()),
        };
        if let Err(error) = looked.and_then(|()| py.check_signals()) {
            break Err(error);
        }
    };
    is_ended.store(true, Ordering::Relaxed);
    ended?;
    let result = &mut result;
    // A thread that panicked has sent nothing.
    py.detach(move || result.recv())
        .map_err(|_| PyRuntimeError::new_err("the computation has panicked: please report it"))?
}
