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
pub(super) struct Teller<P> {
    tell: Sender<Message<P>>,
    is_ended: Arc<AtomicBool>,
}

enum Message<P> {
    Progress(P),
    Done,
}

impl<P> Teller<P> {
    /// Tells `progress`. `Break` when nobody waits for the result any more.
    pub(super) fn tell(&self, progress: P) -> ControlFlow<()> {
        let sent = self.tell.send(Message::Progress(progress));
        match sent.is_err() || self.is_ended.load(Ordering::Relaxed) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    }
}

/// Runs `work` while other Python threads run. `told` is called in this thread with its progress.
/// An exception of a signal or of `told` is raised within [`SLICE`]. The computation then ends at
/// its next progress, and its result is dropped.
pub(super) fn run<T, P>(
    py: Python<'_>,
    work: impl FnOnce(&Teller<P>) -> PyResult<T> + Send + 'static,
    mut told: impl FnMut(P) -> PyResult<()>,
) -> PyResult<T>
where
    T: Send + 'static,
    P: Send + 'static,
{
    let (tell, mut messages) = channel();
    let (give, mut result) = channel();
    let is_ended = Arc::new(AtomicBool::new(false));
    let teller = Teller { tell: tell.clone(), is_ended: Arc::clone(&is_ended) };
    let compute = move || {
        let found = match rayon::ThreadPoolBuilder::new().build() {
            Ok(pool) => pool.install(|| work(&teller)),
            Err(error) => Err(PyOSError::new_err(format!("cannot start threads: {error}"))),
        };
        let _ = give.send(found);
        let _ = tell.send(Message::Done);
    };
    thread::Builder::new()
        .name("joulebus-lab".to_owned())
        .spawn(compute)
        .map_err(|error| PyOSError::new_err(format!("cannot start a thread: {error}")))?;
    let ended = loop {
        let messages = &mut messages;
        let message = py.detach(move || messages.recv_timeout(SLICE));
        let looked = match message {
            Ok(Message::Progress(progress)) => told(progress),
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
