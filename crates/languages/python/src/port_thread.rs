//! A thread that owns ports of shared memory. Ports belong to the thread that opened them, but
//! Python's objects may be used and destroyed in any thread.

use std::fmt;
use std::process;
use std::sync::mpsc::{Sender, channel, sync_channel};

use joulebus_bus::{Background, make_calls};
use pyo3::exceptions::PyRuntimeError;
use pyo3::{PyErr, PyResult};

use crate::error::ConnectError;

/// A call that the thread makes with its ports.
type Call<S> = Box<dyn FnOnce(&mut S) + Send>;

/// A handle of the thread. It ends, and drops its ports, when the last handle is dropped.
///
/// Belongs to the process that started it: a child made by `fork` has no such thread, and the ports
/// are the parent's. Every use there is refused, and dropping a handle there does nothing.
pub(crate) struct PortThread<S> {
    calls: Option<Sender<Call<S>>>,
    pid: u32,
}

impl<S: 'static> PortThread<S> {
    /// Starts the thread, which opens its ports first. Blocks until it has.
    pub(crate) fn start(
        open: impl FnOnce() -> Result<S, String> + Send + 'static,
    ) -> PyResult<Self> {
        let (calls, queue) = channel::<Call<S>>();
        let (thread, ()) = Background::run("joulebus-ports", move |thread| {
            let ports = open().map_err(ConnectError::new_err)?;
            thread.joined(());
            // Arrays refer to frames of the ports: after a panic these stay until the process ends.
            make_calls(ports, queue);
            PyResult::Ok(())
        })?;
        // It ends with the last handle.
        thread.detach();
        Ok(Self { calls: Some(calls), pid: process::id() })
    }

    /// Has the thread run `call`, and waits for its result. Python's interpreter must be released.
    pub(crate) fn ask<R: Send + 'static>(
        &self,
        call: impl FnOnce(&mut S) -> R + Send + 'static,
    ) -> PyResult<R> {
        self.check_process()?;
        let (answer, result) = sync_channel(1);
        // The asking thread waits for it.
        let call: Call<S> = Box::new(move |ports| answer.send(call(ports)).unwrap_or(()));
        self.send(call)?;
        result.recv().map_err(|_| ended())
    }

    /// Has the thread run `call` later, without waiting.
    pub(crate) fn post(&self, call: impl FnOnce(&mut S) + Send + 'static) {
        if self.pid == process::id() {
            // A thread that has ended needs nothing more.
            let _ = self.send(Box::new(call));
        }
    }

    /// Another handle of the same thread.
    pub(crate) fn share(&self) -> Self {
        Self { calls: self.calls.clone(), pid: self.pid }
    }

    pub(crate) fn check_process(&self) -> PyResult<()> {
        let (found, allowed) = (process::id(), self.pid);
        if found == allowed {
            return Ok(());
        }
        Err(PyRuntimeError::new_err(format!(
            "used in process {found}, which was forked from {allowed}: its ports belong to \
             process {allowed}. Connect anew after a fork, or start processes by `spawn`"
        )))
    }

    fn send(&self, call: Call<S>) -> PyResult<()> {
        let sent = self.calls.as_ref().is_some_and(|calls| calls.send(call).is_ok());
        sent.then_some(()).ok_or_else(ended)
    }
}

fn ended() -> PyErr {
    PyRuntimeError::new_err(
        "the thread of the ports has ended, which is a defect of joulebus: please report it. \
         Arrays of frames stay valid. Connect anew",
    )
}

impl<S> fmt::Debug for PortThread<S> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let pid = self.pid;
        out.debug_struct("PortThread").field("pid", &pid).finish_non_exhaustive()
    }
}

impl<S> Drop for PortThread<S> {
    fn drop(&mut self) {
        if self.pid != process::id() {
            // The queue may have been in use when the process forked.
            std::mem::forget(self.calls.take());
        }
    }
}
