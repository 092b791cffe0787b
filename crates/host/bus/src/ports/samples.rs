//! Frames of samples: a source's port, the worker's port, and the worker's copy. The simulator
//! compiles this file too.

use std::marker::PhantomData;

use joulebus_wire::{Sample, SampleHeader, Samples, Service, WakeEvent};

use super::{Member, Noted, Received, WriterWatch};
use crate::{Bus, Limits, OpenError, Reader, ReceiveError, SendError, Sent, Waker, Writer};

/// The worker's port for samples of all sources.
#[derive(Debug)]
pub struct SampleReader {
    reader: Reader<Samples>,
    noted: Noted,
}

impl SampleReader {
    pub(crate) fn new(reader: Reader<Samples>) -> Self {
        Self { reader, noted: Noted::new() }
    }

    /// Copies the next frame into `frame` and returns true if there was one. Call it until it
    /// returns false: frames of different sources are queued in turn. Each byte is read from shared
    /// memory once, so what is validated afterwards cannot change.
    ///
    /// # Errors
    /// [`ReceiveError`]. The next call may succeed.
    pub fn take(&mut self, frame: &mut FrameBuf) -> Result<bool, ReceiveError> {
        let Some(mut incoming) = self.next(frame.capacity)? else {
            return Ok(false);
        };
        frame.header = *incoming.header();
        frame.truncated = incoming.truncated();
        // The buffer holds the whole frame, or its capacity is 0.
        if incoming.copy_part(&mut frame.samples).is_none() {
            frame.samples.clear();
        }
        Ok(true)
    }

    /// The next frame, to be copied in parts, at most `most` of its samples. `None` if there is
    /// none.
    ///
    /// # Errors
    /// [`ReceiveError`]. The next call may succeed.
    pub fn next(&mut self, most: usize) -> Result<Option<IncomingFrame<'_>>, ReceiveError> {
        let Some(received) = self.reader.receive()? else {
            return Ok(None);
        };
        self.noted.note(&received);
        Ok(Some(IncomingFrame {
            member: self.reader.member().clone(),
            header: *received.user_header(),
            kept: received.payload().len().min(most),
            received,
            copied: 0,
            reader: PhantomData,
        }))
    }

    /// Number of failed or broken connections to sources.
    pub fn degraded(&self) -> u64 {
        self.reader.degraded()
    }
}

/// A frame of samples being received. Each byte is read from shared memory once, into a buffer that
/// may be small enough to stay in the core's cache. What is validated there cannot change.
#[derive(Debug)]
pub struct IncomingFrame<'a> {
    received: Received<Samples>,
    member: Member,
    header: SampleHeader,
    kept: usize,
    copied: usize,
    reader: PhantomData<&'a mut SampleReader>,
}

impl IncomingFrame<'_> {
    /// The header.
    pub const fn header(&self) -> &SampleHeader {
        &self.header
    }

    /// Id of the port that sent it: unique among all ports, also those that are gone.
    pub fn port(&self) -> u128 {
        self.received.writer()
    }

    /// Watches the port that sent it. Allocates.
    pub fn watch_port(&self) -> WriterWatch {
        WriterWatch::new(&self.member, self.port())
    }

    /// Number of samples that will be copied.
    pub const fn len(&self) -> usize {
        self.kept
    }

    /// True if there are none.
    pub const fn is_empty(&self) -> bool {
        self.kept == 0
    }

    /// Number of samples beyond the limit, which are not copied.
    pub fn truncated(&self) -> usize {
        self.received.payload().len() - self.kept
    }

    /// Copies the next samples, at most the capacity of `part`, and returns them. `None` at the
    /// end, or if the capacity is 0.
    pub fn copy_part<'p>(&mut self, part: &'p mut Vec<Sample>) -> Option<&'p [Sample]> {
        let count = part.capacity().min(self.kept - self.copied);
        if count == 0 {
            return None;
        }
        let from = self.copied;
        self.copied += count;
        part.clear();
        part.extend_from_slice(&self.received.payload()[from..self.copied]);
        Some(part)
    }
}

/// A private copy of a frame of samples. Allocates only when created.
#[derive(Debug, Clone)]
pub struct FrameBuf {
    header: SampleHeader,
    samples: Vec<Sample>,
    truncated: usize,
    capacity: usize,
}

impl FrameBuf {
    /// A buffer for frames of up to `capacity` samples.
    #[must_use]
    pub fn new(capacity: usize) -> Self {
        Self { header: SampleHeader::default(), samples: touched(capacity), truncated: 0, capacity }
    }

    /// The header.
    pub const fn header(&self) -> &SampleHeader {
        &self.header
    }

    /// The samples, at most the capacity.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// Number of samples beyond the capacity, which were not copied.
    pub const fn truncated(&self) -> usize {
        self.truncated
    }
}

/// A buffer for `capacity` samples with every page touched: the first long frame causes no page
/// fault.
fn touched(capacity: usize) -> Vec<Sample> {
    let mut samples = vec![Sample::new(0, 0, 0); capacity];
    samples.clear();
    samples
}

/// A source's port: sends frames of samples and wakes the worker.
#[derive(Debug)]
pub struct SampleWriter {
    writer: Writer<Samples>,
    waker: Waker,
}

impl SampleWriter {
    pub(super) fn open(bus: &Bus, limits: &Limits, max_len: usize) -> Result<Self, OpenError> {
        if max_len < 1 || max_len > limits.capacity {
            return Err(OpenError::Length { found: max_len, allowed: limits.capacity });
        }
        Ok(Self {
            writer: Writer::open(bus, limits, max_len)?,
            waker: Waker::open(bus, Service::ARRIVALS, limits, limits.arrivals())?,
        })
    }

    /// Sends a frame of `len` samples, sample `i` being `sample(i)`, written directly to shared
    /// memory, and wakes the worker. [`Sent::readers`] is 0 if no worker runs.
    ///
    /// # Errors
    /// [`SendError`]. Nothing was sent.
    pub fn send(
        &mut self,
        header: SampleHeader,
        len: usize,
        sample: impl FnMut(usize) -> Sample,
    ) -> Result<Sent, SendError> {
        Ok(Sent {
            readers: self.writer.send(header, len, sample)?,
            not_woken: self.waker.wake(WakeEvent::Frame).err(),
        })
    }

    /// Maximum number of samples per frame.
    pub const fn max_len(&self) -> usize {
        self.writer.max_len()
    }

    /// Number of failed or broken connections to readers.
    pub fn degraded(&self) -> u64 {
        self.writer.degraded()
    }
}
