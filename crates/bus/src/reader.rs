//! Reading frames in place, or into a process's own memory.

use std::fmt::Debug;
use std::marker::PhantomData;
use std::ops::Deref;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{ZeroCopySend, ipc};
use iceoryx2::sample::Sample as Borrowed;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use joulebus_wire::{Sample, SampleHeader, Service};

use crate::limits::Shape;
use crate::membership::Membership;
use crate::memory;
use crate::open::{OpenError, open};
use crate::port::count_degradation;
use crate::repair::{Look, Repair};
use crate::{Bus, Limits, clock};

/// Reads frames in place.
pub struct Reader<H: Debug + ZeroCopySend + 'static, T: Debug + ZeroCopySend + 'static> {
    // Before the port, it before the factory, and all before the membership: the order in which
    // they must go.
    held: Option<Borrowed<ipc::Service, [T], H>>,
    subscriber: Option<Subscriber<ipc::Service, [T], H>>,
    factory: PortFactory<ipc::Service, [T], H>,
    buffer: usize,
    degraded: Arc<AtomicU64>,
    repair: Repair,
    _member: Rc<Membership>,
}

impl<H, T> Reader<H, T>
where
    H: Debug + ZeroCopySend + 'static,
    T: Debug + ZeroCopySend + 'static,
{
    /// The oldest frame that waits, in order; `None` when there is none. Frames that were
    /// overwritten before are known by the numbers in the headers.
    ///
    /// # Errors
    /// [`ReceiveError`]; the next call may succeed.
    pub fn take_next(&mut self) -> Result<Option<Frame<'_, H, T>>, ReceiveError> {
        Ok(self.receive()?.map(Frame::new))
    }

    /// Hands all frames that wait to `each`, in order.
    ///
    /// # Errors
    /// [`ReceiveError`]; the next call may succeed.
    pub fn take_all(&mut self, mut each: impl FnMut(&H, &[T])) -> Result<(), ReceiveError> {
        while let Some(frame) = self.receive()? {
            each(frame.user_header(), frame.payload());
        }
        Ok(())
    }

    /// The newest frame, older ones passed over; `None` when none has come since the last call.
    ///
    /// # Errors
    /// [`ReceiveError`]; the next call may succeed.
    pub fn take_latest(&mut self) -> Result<Option<Frame<'_, H, T>>, ReceiveError> {
        let mut latest = None;
        while let Some(newer) = self.receive()? {
            latest = Some(newer);
        }
        Ok(latest.map(Frame::new))
    }

    /// Takes all frames that wait and keeps the last that is `newer` than the one kept before;
    /// returns whether there was one. The frame is held in shared memory until a newer one is kept
    /// or the reader goes: [`Reader::held`]. Not to be mixed with the other ways to take.
    ///
    /// # Errors
    /// [`ReceiveError`] when nothing newer was found; the next call may succeed.
    pub fn hold_latest(&mut self, mut newer: impl FnMut(&H) -> bool) -> Result<bool, ReceiveError> {
        let mut found = false;
        loop {
            match self.receive() {
                Ok(Some(frame)) if newer(frame.user_header()) => {
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

    /// The frame that [`Reader::hold_latest`] keeps: its header and its slice. Its writer could
    /// still change it (it does not): who must be sure copies first.
    #[must_use]
    pub fn held(&self) -> Option<(&H, &[T])> {
        let held = self.held.as_ref()?;
        Some((held.user_header(), held.payload()))
    }

    /// Connections to writers that could not be made, or broke.
    #[must_use]
    pub fn degraded(&self) -> u64 {
        self.degraded.load(Ordering::Relaxed)
    }

    /// A writer that dies while it is connected to leaves a connection that fails, and one that
    /// waits for nobody: the port is made anew, quietly. Only what fails again a second later is
    /// an error.
    fn receive(&mut self) -> Result<Option<Borrowed<ipc::Service, [T], H>>, ReceiveError> {
        loop {
            if self.repair.is_due(clock::monotonic_ns) {
                self.renew()?;
            }
            let Some(subscriber) = &self.subscriber else {
                return Ok(None);
            };
            let received = subscriber
                .receive()
                .map_err(|reason| ReceiveError::Receive {
                    reason: reason.to_string(),
                })?;
            if received.is_some() {
                return Ok(received);
            }
            match self.repair.look(self.degraded(), clock::monotonic_ns) {
                Look::Whole => return Ok(None),
                Look::Renew => {}
                Look::Failing { connections } => {
                    return Err(ReceiveError::Degraded { connections });
                }
            }
        }
    }

    /// iceoryx2 does not try a failed connection again: only a new port does. What waits in the old
    /// one has been read by then, and the old one goes first: the service may have no room for both.
    fn renew(&mut self) -> Result<(), ReceiveError> {
        self.subscriber = None;
        match subscribe(&self.factory, self.buffer, &self.degraded) {
            Ok(subscriber) => {
                self.subscriber = Some(subscriber);
                Ok(())
            }
            Err(error) if self.repair.failed(clock::monotonic_ns()) => Err(error),
            Err(error) => {
                tracing::debug!(%error, "a port could not be made anew yet");
                Ok(())
            }
        }
    }
}

fn subscribe<H, T>(
    factory: &PortFactory<ipc::Service, [T], H>,
    buffer: usize,
    degraded: &Arc<AtomicU64>,
) -> Result<Subscriber<ipc::Service, [T], H>, ReceiveError>
where
    H: Debug + ZeroCopySend + 'static,
    T: Debug + ZeroCopySend + 'static,
{
    let counted = Arc::clone(degraded);
    factory
        .subscriber_builder()
        .buffer_size(buffer)
        .set_degradation_handler(move |_, _| count_degradation(&counted))
        .create()
        .map_err(|reason| ReceiveError::Receive {
            reason: reason.to_string(),
        })
}

/// A frame in shared memory, held for as long as this lives: the slice by dereferencing.
///
/// Its writer could still change it (it does not): who must be sure copies first.
pub struct Frame<'a, H: Debug + ZeroCopySend + 'static, T: Debug + ZeroCopySend + 'static> {
    sample: Borrowed<ipc::Service, [T], H>,
    reader: PhantomData<&'a mut Reader<H, T>>,
}

impl<H, T> Frame<'_, H, T>
where
    H: Debug + ZeroCopySend + 'static,
    T: Debug + ZeroCopySend + 'static,
{
    const fn new(sample: Borrowed<ipc::Service, [T], H>) -> Self {
        Self {
            sample,
            reader: PhantomData,
        }
    }

    /// The frame's header.
    #[must_use]
    pub fn header(&self) -> &H {
        self.sample.user_header()
    }
}

impl<H, T> Deref for Frame<'_, H, T>
where
    H: Debug + ZeroCopySend + 'static,
    T: Debug + ZeroCopySend + 'static,
{
    type Target = [T];

    fn deref(&self) -> &[T] {
        self.sample.payload()
    }
}

/// Sources whose memory a [`SampleReader`] remembers to have mapped.
const MAPPED: usize = 256;

/// The worker's port for samples of all sources.
pub struct SampleReader {
    reader: Reader<SampleHeader, Sample>,
    /// Ports of sources whose memory has been mapped whole.
    mapped: Vec<u128>,
}

impl SampleReader {
    pub(crate) fn new(reader: Reader<SampleHeader, Sample>) -> Self {
        Self {
            reader,
            mapped: Vec::with_capacity(MAPPED),
        }
    }

    /// Copies the next frame into `frame`; whether there was one. Take until there is none: the
    /// sources come one after the other. Each byte is read from shared memory once, so what is
    /// checked afterwards cannot change any more.
    ///
    /// # Errors
    /// [`ReceiveError`]; the next call may succeed.
    pub fn take(&mut self, frame: &mut FrameBuf) -> Result<bool, ReceiveError> {
        let Some(mut incoming) = self.next(frame.capacity)? else {
            return Ok(false);
        };
        frame.header = *incoming.header();
        frame.truncated = incoming.truncated();
        // The buffer has room for all of it, or for none.
        if incoming.copy_part(&mut frame.samples).is_none() {
            frame.samples.clear();
        }
        Ok(true)
    }

    /// The next frame, to be copied part by part, at most `most` samples of it; `None` when there
    /// is none.
    ///
    /// # Errors
    /// [`ReceiveError`]; the next call may succeed.
    pub fn next(&mut self, most: usize) -> Result<Option<IncomingFrame<'_>>, ReceiveError> {
        let Some(received) = self.reader.receive()? else {
            return Ok(None);
        };
        let source = received.header().publisher_id().value();
        if !self.mapped.contains(&source) {
            // Sources come and go for months: forgetting costs one more look.
            if self.mapped.len() == MAPPED {
                self.mapped.clear();
            }
            self.mapped.push(source);
            memory::map(&source.to_string());
        }
        Ok(Some(IncomingFrame {
            header: *received.user_header(),
            kept: received.payload().len().min(most),
            received,
            copied: 0,
            reader: PhantomData,
        }))
    }

    /// Connections to sources that could not be made, or broke.
    #[must_use]
    pub fn degraded(&self) -> u64 {
        self.reader.degraded()
    }
}

/// A frame of samples on its way in. Each byte is read from shared memory once, into a buffer that
/// may be small enough to stay in the core's own cache; what is checked there cannot change any
/// more.
pub struct IncomingFrame<'a> {
    received: Borrowed<ipc::Service, [Sample], SampleHeader>,
    header: SampleHeader,
    kept: usize,
    copied: usize,
    reader: PhantomData<&'a mut SampleReader>,
}

impl IncomingFrame<'_> {
    /// The header.
    #[must_use]
    pub const fn header(&self) -> &SampleHeader {
        &self.header
    }

    /// Samples that will be copied.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.kept
    }

    /// Whether there is none.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.kept == 0
    }

    /// Samples of the frame past those, which will not be.
    #[must_use]
    pub fn truncated(&self) -> usize {
        self.received.payload().len() - self.kept
    }

    /// Copies the next samples, as many as `part` has room for without growing, and gives them;
    /// `None` at the end, or if there is no room.
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

/// A process's own copy of a frame of samples. Allocates when made, then never.
#[derive(Debug, Clone)]
pub struct FrameBuf {
    header: SampleHeader,
    samples: Vec<Sample>,
    truncated: usize,
    capacity: usize,
}

impl FrameBuf {
    /// Room for frames of up to `capacity` samples.
    #[must_use]
    pub fn new(capacity: usize) -> Self {
        Self {
            header: SampleHeader::default(),
            samples: touched(capacity),
            truncated: 0,
            capacity,
        }
    }

    /// The header.
    #[must_use]
    pub const fn header(&self) -> &SampleHeader {
        &self.header
    }

    /// The samples, at most the capacity.
    #[must_use]
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// Samples of the frame past the capacity, which were not copied.
    #[must_use]
    pub const fn truncated(&self) -> usize {
        self.truncated
    }
}

/// Room for `capacity` samples, every page of it touched: the first long frame takes no page fault.
fn touched(capacity: usize) -> Vec<Sample> {
    let mut samples = vec![Sample::new(0, 0, 0); capacity];
    samples.clear();
    samples
}

pub(crate) fn reader<H, T>(
    bus: &Bus,
    service: Service,
    limits: &Limits,
    shape: Shape,
) -> Result<Reader<H, T>, OpenError>
where
    H: Debug + ZeroCopySend + 'static,
    T: Debug + ZeroCopySend + 'static,
{
    let factory = open::<H, T>(bus, service, limits, shape)?;
    let degraded = Arc::new(AtomicU64::new(0));
    let subscriber = subscribe(&factory, shape.buffer, &degraded)
        .map_err(|reason| OpenError::port(service, reason))?;
    Ok(Reader {
        held: None,
        subscriber: Some(subscriber),
        factory,
        buffer: shape.buffer,
        degraded,
        repair: Repair::default(),
        _member: Rc::clone(&bus.member),
    })
}

/// Why no frame could be read.
#[derive(Debug, thiserror::Error)]
pub enum ReceiveError {
    /// A writer could not be connected to for a second and more; its frames are missing. The port
    /// is made anew each second. A writer that died meanwhile is no error.
    #[error(
        "{connections} connections to writers failed so far; are there file descriptors left \
         (`ulimit -n`), and shared memory? `joulebus doctor` tells"
    )]
    Degraded {
        /// Connections failed since the port was opened.
        connections: u64,
    },
    /// iceoryx2 refused.
    #[error("cannot receive: {reason}")]
    Receive {
        /// What iceoryx2 said.
        reason: String,
    },
}
