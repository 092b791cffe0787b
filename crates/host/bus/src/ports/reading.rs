//! Handling of received frames by a reader. The simulator compiles this file too.

use std::marker::PhantomData;

use joulebus_wire::Channel;

use super::Received;
use crate::liveness::worker_ports::WorkerPorts;
use crate::{Reader, ReceiveError};

impl<C: Channel> Reader<C> {
    /// The oldest queued frame. `None` if the queue is empty. Overwritten frames are detected by
    /// the numbers in the headers.
    ///
    /// # Errors
    /// [`ReceiveError`]. The next call may succeed.
    pub fn take_next(&mut self) -> Result<Option<Frame<'_, C>>, ReceiveError> {
        Ok(self.receive()?.map(Frame::new))
    }

    /// Calls `each` for all queued frames, in order: as many as can be queued at once, so that
    /// faster writers do not keep the caller for ever.
    ///
    /// # Errors
    /// [`ReceiveError`]. The next call may succeed.
    pub fn take_all(
        &mut self,
        mut each: impl FnMut(&C::Header, &[C::Row]),
    ) -> Result<(), ReceiveError> {
        for _ in 0..self.queued() {
            let Some(frame) = self.receive()? else {
                break;
            };
            each(frame.user_header(), frame.payload());
        }
        Ok(())
    }

    /// The newest frame, skipping older ones. `None` if there is no new one since the last call.
    ///
    /// # Errors
    /// [`ReceiveError`]. The next call may succeed.
    pub fn take_latest(&mut self) -> Result<Option<Frame<'_, C>>, ReceiveError> {
        let mut latest = None;
        while let Some(newer) = self.receive()? {
            latest = Some(newer);
        }
        Ok(latest.map(Frame::new))
    }

    /// Receives all queued frames and holds the last one that is `newer` than the held one. Returns
    /// whether there was one. `newer` is also passed the number of the worker's run of the frame,
    /// which increases whenever another process has become the worker. The frame is held in shared
    /// memory until a newer one is held or the reader is dropped: [`Reader::held`]. Must not be
    /// combined with the other methods of receiving.
    ///
    /// # Errors
    /// [`ReceiveError`] if nothing newer was found. The next call may succeed.
    pub fn hold_latest(
        &mut self,
        mut newer: impl FnMut(&C::Header, &[C::Row], u64) -> bool,
    ) -> Result<bool, ReceiveError> {
        let mut found = false;
        loop {
            match self.receive() {
                Ok(Some(frame))
                    if newer(frame.user_header(), frame.payload(), self.worker_runs()) =>
                {
                    self.held = Some(frame);
                    found = true;
                }
                Ok(Some(_)) => {}
                Ok(None) => return Ok(found),
                Err(_) if found => return Ok(true),
                Err(error) => return Err(error),
            }
        }
    }

    /// The frame held by [`Reader::hold_latest`]: its header and its slice. Its writer could still
    /// change it (it does not): copy it where that matters.
    pub fn held(&self) -> Option<(&C::Header, &[C::Row])> {
        let held = self.held.as_ref()?;
        Some((held.user_header(), held.payload()))
    }

    /// Moves the frame of [`Reader::held`] out of the reader, to keep it for longer, also after the
    /// reader. A process can keep two frames of forecasts beside the newest. With more, receiving
    /// is an error. The frame keeps the reader's port, its place in the service and this process's
    /// membership until it is dropped. Belongs to the reader's thread.
    #[must_use]
    pub fn take_held(&mut self) -> Option<Frame<'static, C>> {
        self.held.take().map(Frame::new)
    }

    /// Number of skipped frames on a service of the worker that another process has sent.
    pub fn foreign(&self) -> u64 {
        self.worker().map_or(0, WorkerPorts::foreign)
    }

    fn worker_runs(&self) -> u64 {
        self.worker().map_or(0, WorkerPorts::runs)
    }
}

/// A frame in shared memory, held while this value lives.
///
/// Its writer could still change it (it does not): copy it where that matters.
#[derive(Debug)]
pub struct Frame<'a, C: Channel> {
    frame: Received<C>,
    reader: PhantomData<&'a mut Reader<C>>,
}

impl<C: Channel> Frame<'_, C> {
    const fn new(frame: Received<C>) -> Self {
        Self { frame, reader: PhantomData }
    }

    /// The frame's header.
    pub fn header(&self) -> &C::Header {
        self.frame.user_header()
    }

    /// The frame's slice.
    pub fn payload(&self) -> &[C::Row] {
        self.frame.payload()
    }
}
