//! The ports of a channel: bytes of shared memory as its headers and rows. Everything here is
//! compiled for each channel, so it is short.
#![allow(unsafe_code)] // The user header of a frame is read as the header of its channel.

use std::marker::PhantomData;

use joulebus_wire::Channel;

use super::inlet::{InFrame, Inlet, Member};
use super::outlet::{OutFrame, Outlet};
use super::service::{FrameTypes, OpenError};
use super::{ReceiveError, SendError};
use crate::liveness::worker_ports::WorkerPorts;
use crate::{Bus, Limits};

/// Reads frames in place. On the worker's channels, only those of the holder of the worker's lock.
#[derive(Debug)]
pub struct Reader<C: Channel> {
    pub(super) held: Option<Received<C>>,
    inlet: Inlet,
}

impl<C: Channel> Reader<C> {
    pub(super) fn open(bus: &Bus, limits: &Limits) -> Result<Self, OpenError> {
        let inlet = Inlet::open(bus, limits, &FrameTypes::of::<C>())?;
        Ok(Self { held: None, inlet })
    }

    /// Number of failed or broken connections to writers.
    pub fn degraded(&self) -> u64 {
        self.inlet.degraded()
    }

    pub(super) fn receive(&mut self) -> Result<Option<Received<C>>, ReceiveError> {
        let received = self.inlet.receive()?;
        Ok(received.map(|frame| Received { frame, channel: PhantomData }))
    }

    /// Frames that can be queued at once, of all writers.
    pub(super) const fn queued(&self) -> usize {
        self.inlet.queued()
    }

    /// None for services on which every process may send.
    pub(super) const fn worker(&self) -> Option<&WorkerPorts> {
        self.inlet.worker()
    }

    pub(super) const fn member(&self) -> &Member {
        self.inlet.member()
    }
}

/// A frame that was received from a port of its channel.
#[derive(Debug)]
pub(super) struct Received<C: Channel> {
    frame: InFrame,
    channel: PhantomData<C>,
}

impl<C: Channel> Received<C> {
    pub(super) fn user_header(&self) -> &C::Header {
        // SAFETY: only a port that was opened with the types of `C` makes this value. So there is a
        // header of `C` at this address, aligned, of which every bit pattern is valid. It stays
        // mapped as long as the frame lives, and its sender writes to it again only when the frame
        // or the port that received it is dropped. The frame owns that port.
        unsafe { &*self.frame.header().cast() }
    }

    pub(super) fn payload(&self) -> &[C::Row] {
        // SAFETY: a marker is a byte, and every bit pattern of it is valid. The memory stays as it
        // is for as long as that of the header.
        let bytes = unsafe { &*(self.frame.bytes() as *const [u8]) };
        bytemuck::pod_align_to(bytes).1
    }

    /// The port that sent it.
    pub(super) fn writer(&self) -> u128 {
        self.frame.writer()
    }
}

/// Sends frames of a channel, written in place in shared memory.
#[derive(Debug)]
pub struct Writer<C: Channel> {
    outlet: Outlet,
    channel: PhantomData<C>,
}

impl<C: Channel> Writer<C> {
    pub(super) fn open(bus: &Bus, limits: &Limits, max_len: usize) -> Result<Self, OpenError> {
        let outlet = Outlet::open(bus, limits, &FrameTypes::of::<C>(), max_len)?;
        Ok(Self { outlet, channel: PhantomData })
    }

    /// Sends a frame of `len` elements, element `i` being `element(i)`, written directly to shared
    /// memory. Returns the number of readers reached. iceoryx2 allocates once.
    ///
    /// # Errors
    /// [`SendError`]. Nothing was sent.
    pub fn send(
        &mut self,
        header: C::Header,
        len: usize,
        mut element: impl FnMut(usize) -> C::Row,
    ) -> Result<usize, SendError> {
        let mut loan = self.loan_to_fill(len)?;
        *loan.header_mut() = header;
        for (at, row) in loan.payload_mut().iter_mut().enumerate() {
            *row = element(at);
        }
        loan.send()
    }

    /// Borrows memory for a frame of `len` elements, all default, to compute into. [`Loan::send`]
    /// sends the frame, dropping it discards it. iceoryx2 allocates once.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn loan(&mut self, len: usize) -> Result<Loan<'_, C>, SendError> {
        let mut loan = self.loan_to_fill(len)?;
        loan.payload_mut().fill(C::Row::default());
        Ok(loan)
    }

    /// As [`Writer::loan`], for a caller that writes every element: until then they contain those
    /// of an earlier frame, or zeros. Saves a pass over memory that fits into no cache.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn loan_to_fill(&mut self, len: usize) -> Result<Loan<'_, C>, SendError> {
        let mut loan = Loan { frame: self.outlet.lend(len)?, writer: PhantomData };
        *loan.header_mut() = C::Header::default();
        Ok(loan)
    }

    /// Connects to readers that have joined since the last frame: they receive the history. Cheap
    /// if there are none.
    pub fn update(&mut self) {
        self.outlet.update();
    }

    /// Number of readers of the service. A killed one counts until the cleanup.
    pub fn readers(&self) -> usize {
        self.outlet.readers()
    }

    /// Maximum number of elements per frame.
    pub const fn max_len(&self) -> usize {
        self.outlet.max_len()
    }

    /// Number of failed or broken connections to readers: these miss frames.
    pub fn degraded(&self) -> u64 {
        self.outlet.degraded()
    }
}

/// Memory of a frame to send.
#[derive(Debug)]
pub struct Loan<'a, C: Channel> {
    frame: OutFrame,
    writer: PhantomData<&'a mut Writer<C>>,
}

impl<C: Channel> Loan<'_, C> {
    /// The frame's header.
    pub fn header_mut(&mut self) -> &mut C::Header {
        // SAFETY: as of `Received::user_header`. Nobody else has the memory until it is sent.
        unsafe { &mut *self.frame.header_mut().cast() }
    }

    /// The frame's slice.
    pub fn payload_mut(&mut self) -> &mut [C::Row] {
        // SAFETY: a marker is a byte, and every bit pattern of it is valid.
        let bytes = unsafe { &mut *(self.frame.bytes_mut() as *mut [u8]) };
        bytemuck::pod_align_to_mut(bytes).1
    }

    /// Sends the frame. Returns the number of readers reached.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn send(self) -> Result<usize, SendError> {
        self.frame.send()
    }
}
