//! Encoding of link messages: little-endian, checked once on arrival.
//!
//! One side of a stream sends frames, the other requests them. A request selects frames,
//! acknowledges those that have arrived, and measures the clock offset. Requests are repeated, so
//! the loss of one does no harm.

use bytemuck::{Pod, Zeroable, bytes_of, pod_read_unaligned};
use joulebus_wire::SCHEMA_VERSION;

use crate::protocol::carried::{Carried, FrameError, RawFrame};
use crate::protocol::selection::{MAX_RANGES, Selection};

/// Version of the message format.
const PROTOCOL: u32 = 6;
const MAGIC: [u8; 8] = *b"joulelnk";
const RELEASE_BYTES: usize = 16;
const FRAME: u32 = 1;
const REQUEST: u32 = 2;

/// Header of every message.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct Prelude {
    magic: [u8; 8],
    protocol: u32,
    kind: u32,
    /// Release of the sender, padded with zeros.
    release: [u8; RELEASE_BYTES],
    schema: u32,
    reserved: u32,
    fleet: FleetId,
    /// Run of the sending link. It grows with each restart.
    run: u64,
    /// Number of the message in its stream and run, from 1.
    number: u64,
}

/// Header of a frame, after the prelude.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct FrameHead {
    service: u32,
    elements: u32,
    worker: u32,
    reserved: u32,
    asked_ns: u64,
    received_ns: u64,
    sent_ns: u64,
    dropped: u64,
    term: u64,
    highest_term: u64,
}

/// A request without its ranges.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct RequestHead {
    run: u64,
    number: u64,
    asked_ns: u64,
    services: u32,
    every: u32,
    ranges: u32,
    reserved: u32,
}

const _: () = assert!(size_of::<Prelude>() == 64 && size_of::<FrameHead>() == 64);

/// Maximum size of a request with the proof of its sender, bytes.
pub(crate) const MAX_REQUEST_BYTES: usize = 16 << 10;

/// Size of all headers before the header of the frame itself, bytes.
pub(crate) const HEADS_BYTES: usize = size_of::<Prelude>() + size_of::<FrameHead>();

/// Identity of a fleet in messages: FNV-1a hash of its name. Hosts of other fleets refuse each
/// other.
#[repr(transparent)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Pod, Zeroable)]
pub(crate) struct FleetId(pub(crate) u64);

/// Identity of the sending link.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Sender {
    pub(crate) fleet: FleetId,
    /// When the link started, monotonic ns of its host.
    pub(crate) run: u64,
}

/// State of a worker, as its link sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Worker {
    /// The link has not seen the worker yet, or its host has none and sends samples.
    #[default]
    Unknown,
    Alive,
    /// The worker has stopped sending.
    Stale,
    /// The worker has ended.
    Gone,
}

impl Worker {
    fn decode(code: u32) -> Self {
        match code {
            1 => Self::Alive,
            2 => Self::Stale,
            3 => Self::Gone,
            _ => Self::Unknown,
        }
    }
}

/// State and term of the sender's worker.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct LeaderStatus {
    pub(crate) worker: Worker,
    /// Term in which the worker leads, higher than all earlier terms. 0 if it is the only worker.
    pub(crate) term: u64,
    /// Highest term that the sender knows of, its own or another's. A candidate or a store that
    /// lost its terms learns it from here.
    pub(crate) highest_term: u64,
}

impl From<Worker> for LeaderStatus {
    fn from(worker: Worker) -> Self {
        Self { worker, ..Self::default() }
    }
}

/// Times and counters sent with each frame, or alone if there is none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Status {
    /// [`Request::asked_ns`] of the newest request that the sender has received. 0 before the
    /// first.
    pub(crate) asked_ns: u64,
    /// When the sender received it, monotonic ns of the sender.
    pub(crate) received_ns: u64,
    /// When this message was made, monotonic ns of the sender.
    pub(crate) sent_ns: u64,
    /// Frames not sent to this receiver because newer ones replaced them while the link was busy.
    pub(crate) dropped: u64,
    /// State of the sender's worker.
    pub(crate) leader: LeaderStatus,
}

/// A request for frames.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Request {
    /// Acknowledgement: run and number of the sender's newest message that has arrived. 0 before
    /// the first.
    pub(crate) acknowledged: (u64, u64),
    /// When the request was sent, monotonic ns of the receiver.
    pub(crate) asked_ns: u64,
    pub(crate) selection: Selection,
}

#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Message<'a> {
    pub(crate) run: u64,
    pub(crate) number: u64,
    pub(crate) body: Body<'a>,
}

#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Body<'a> {
    Frame(Status, Option<RawFrame<'a>>),
    Request(Request),
}

/// A frame to send: its header, and the selected runs of its elements.
pub(crate) struct Outgoing<'f, 'e> {
    pub(crate) service: Carried,
    pub(crate) header: &'f [u8],
    pub(crate) elements: &'f mut dyn Iterator<Item = &'e [u8]>,
}

/// Encodes a frame. Without a frame the message has the status only.
pub(crate) fn write_frame(
    out: &mut Vec<u8>,
    (sender, number): (Sender, u64),
    status: Status,
    frame: Option<Outgoing<'_, '_>>,
) {
    out.clear();
    out.extend_from_slice(bytes_of(&prelude(FRAME, sender, number)));
    let mut head = FrameHead {
        service: frame.as_ref().map_or(0, |frame| frame.service.code),
        elements: 0,
        worker: status.leader.worker as u32,
        reserved: 0,
        asked_ns: status.asked_ns,
        received_ns: status.received_ns,
        sent_ns: status.sent_ns,
        dropped: status.dropped,
        term: status.leader.term,
        highest_term: status.leader.highest_term,
    };
    let at = out.len();
    out.extend_from_slice(bytes_of(&head));
    let Some(Outgoing { service, header, elements }) = frame else {
        return;
    };
    out.extend_from_slice(header);
    let begun = out.len();
    for run in elements {
        out.extend_from_slice(run);
    }
    let count = (out.len() - begun) / service.sizes().1;
    // The fleet's capacity, a u32, bounds the number of elements.
    head.elements = u32::try_from(count).unwrap_or(u32::MAX);
    out[at..at + size_of::<FrameHead>()].copy_from_slice(bytes_of(&head));
}

pub(crate) fn write_request(sender: Sender, number: u64, request: &Request) -> Vec<u8> {
    let ranges = request.selection.ranges();
    let head = RequestHead {
        run: request.acknowledged.0,
        number: request.acknowledged.1,
        asked_ns: request.asked_ns,
        services: request.selection.services,
        every: request.selection.every,
        // Bounded by MAX_RANGES.
        ranges: ranges.len() as u32,
        reserved: 0,
    };
    let mut out = bytes_of(&prelude(REQUEST, sender, number)).to_vec();
    out.extend_from_slice(bytes_of(&head));
    for (first, last) in ranges {
        out.extend_from_slice(bytes_of(&[*first, *last]));
    }
    out
}

/// Decodes a message of an untrusted host. `most` is the maximum number of elements of a frame.
pub(crate) fn read(bytes: &[u8], fleet: FleetId, most: usize) -> Result<Message<'_>, MessageError> {
    read_of(Carried::ALL, bytes, fleet, most)
}

/// Same as [`read`], if these channels cross the link.
pub(crate) fn read_of<'a>(
    channels: &[Carried],
    bytes: &'a [u8],
    fleet: FleetId,
    most: usize,
) -> Result<Message<'a>, MessageError> {
    let (prelude, rest) = split::<Prelude>(bytes)?;
    if prelude.magic != MAGIC {
        return Err(MessageError::Foreign);
    }
    let release = release_of(&prelude.release);
    if (prelude.protocol, prelude.schema) != (PROTOCOL, SCHEMA_VERSION)
        || release != env!("CARGO_PKG_VERSION")
    {
        return Err(MessageError::Release {
            release: release.to_owned(),
            protocol: prelude.protocol,
            schema: prelude.schema,
        });
    }
    if prelude.fleet != fleet {
        return Err(MessageError::Fleet { found: prelude.fleet.0, allowed: fleet.0 });
    }
    let body = match prelude.kind {
        FRAME => read_frame(channels, rest, most)?,
        REQUEST => Body::Request(read_request(rest)?),
        found => return Err(MessageError::Kind { found }),
    };
    Ok(Message { run: prelude.run, number: prelude.number, body })
}

fn read_frame<'a>(
    channels: &[Carried],
    bytes: &'a [u8],
    most: usize,
) -> Result<Body<'a>, MessageError> {
    let (head, rest) = split::<FrameHead>(bytes)?;
    let status = Status {
        asked_ns: head.asked_ns,
        received_ns: head.received_ns,
        sent_ns: head.sent_ns,
        dropped: head.dropped,
        leader: LeaderStatus {
            worker: Worker::decode(head.worker),
            term: head.term,
            highest_term: head.highest_term,
        },
    };
    if head.service == 0 {
        return Ok(Body::Frame(status, None));
    }
    let found = head.service;
    let service = channels.iter().find(|service| service.code == found);
    let service = service.ok_or(MessageError::Kind { found })?;
    let frame = RawFrame::new(*service, head.elements, most, rest)?;
    Ok(Body::Frame(status, Some(frame)))
}

fn read_request(bytes: &[u8]) -> Result<Request, MessageError> {
    let (head, rest) = split::<RequestHead>(bytes)?;
    let (found, allowed) = (head.ranges as usize, MAX_RANGES);
    if found > allowed {
        return Err(MessageError::Ranges { found, allowed });
    }
    let (found, allowed) = (rest.len(), found * size_of::<[u32; 2]>());
    if found != allowed {
        return Err(MessageError::Length { found, allowed });
    }
    let ranges = rest
        .chunks_exact(size_of::<[u32; 2]>())
        .map(pod_read_unaligned::<[u32; 2]>)
        .map(|[first, last]| (first, last));
    Ok(Request {
        acknowledged: (head.run, head.number),
        asked_ns: head.asked_ns,
        selection: Selection::new(head.services, head.every, ranges.collect()),
    })
}

fn prelude(kind: u32, sender: Sender, number: u64) -> Prelude {
    let mut release = [0; RELEASE_BYTES];
    let name = env!("CARGO_PKG_VERSION").as_bytes();
    let length = name.len().min(RELEASE_BYTES);
    release[..length].copy_from_slice(&name[..length]);
    Prelude {
        magic: MAGIC,
        protocol: PROTOCOL,
        kind,
        release,
        schema: SCHEMA_VERSION,
        reserved: 0,
        fleet: sender.fleet,
        run: sender.run,
        number,
    }
}

fn release_of(bytes: &[u8; RELEASE_BYTES]) -> &str {
    let length = bytes.iter().position(|byte| *byte == 0);
    let name = &bytes[..length.unwrap_or(RELEASE_BYTES)];
    str::from_utf8(name).unwrap_or("unknown")
}

fn split<T: Pod>(bytes: &[u8]) -> Result<(T, &[u8]), MessageError> {
    let allowed = size_of::<T>();
    let (head, rest) = bytes
        .split_at_checked(allowed)
        .ok_or(MessageError::Length { found: bytes.len(), allowed })?;
    Ok((pod_read_unaligned(head), rest))
}

/// Reason that a message was refused.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub(crate) enum MessageError {
    #[error("it is not a message of a link")]
    Foreign,
    #[error(
        "the other side is release {release} (messages {protocol}, schema {schema}), this one {own} (messages \
         {PROTOCOL}, schema {SCHEMA_VERSION}). Use one release on all hosts",
        own = env!("CARGO_PKG_VERSION")
    )]
    Release { release: String, protocol: u32, schema: u32 },
    #[error("it is of another fleet ({found:016x}, this one is {allowed:016x})")]
    Fleet { found: u64, allowed: u64 },
    #[error("it has {found} bytes where {allowed} are needed")]
    Length { found: usize, allowed: usize },
    #[error("it is of the unknown kind {found}")]
    Kind { found: u32 },
    #[error("it asks for {found} ranges of robots, allowed are {allowed}")]
    Ranges { found: usize, allowed: usize },
    #[error(transparent)]
    Frame(#[from] FrameError),
}

impl MessageError {
    /// The name of the reason in reports.
    pub(crate) const fn name(&self) -> &'static str {
        match self {
            Self::Foreign => "not a message of a link",
            Self::Release { .. } => "another release",
            Self::Fleet { .. } => "another fleet",
            Self::Length { .. } | Self::Frame(FrameError::Length { .. }) => "wrong length",
            Self::Kind { .. } => "unknown kind",
            Self::Ranges { .. } => "too many ranges",
            Self::Frame(FrameError::TooLong { .. }) => "too many elements",
            Self::Frame(FrameError::Schema { .. }) => "another schema",
        }
    }
}

#[cfg(test)]
mod tests {
    use joulebus_wire::{Forecast, ForecastHeader};
    use proptest::prelude::*;

    use super::*;

    const FLEET: FleetId = FleetId(77);
    const SENDER: Sender = Sender { fleet: FLEET, run: 5 };

    fn status() -> Status {
        Status {
            asked_ns: 1,
            received_ns: 2,
            sent_ns: 3,
            dropped: 4,
            leader: LeaderStatus {
                worker: Worker::Alive,
                term: u64::MAX - 1,
                highest_term: u64::MAX,
            },
        }
    }

    fn frame() -> Vec<u8> {
        let header = ForecastHeader { schema: SCHEMA_VERSION, ..ForecastHeader::default() };
        let rows = [Forecast::default(); 3];
        let mut out = Vec::new();
        let rows: &[u8] = bytemuck::cast_slice(&rows);
        let frame = Some(Outgoing {
            service: Carried::FORECASTS,
            header: bytes_of(&header),
            elements: &mut [rows].into_iter(),
        });
        write_frame(&mut out, (SENDER, 9), status(), frame);
        out
    }

    fn request() -> Request {
        Request {
            acknowledged: (8, 1_000),
            asked_ns: 55,
            selection: Selection::new(Carried::BUDGETS.bit(), 3, vec![(1, 4), (9, 9)]),
        }
    }

    #[test]
    fn messages_are_read_as_they_were_written() {
        let bytes = frame();
        let message = read(&bytes, FLEET, 3).unwrap();
        assert_eq!((message.run, message.number), (5, 9));
        let Body::Frame(found, Some(frame)) = message.body else {
            panic!("no frame");
        };
        assert_eq!((found, frame.len()), (status(), 3));
        let mut bytes = Vec::new();
        write_frame(&mut bytes, (SENDER, 10), status(), None);
        let message = read(&bytes, FLEET, 3).unwrap();
        assert_eq!(message.body, Body::Frame(status(), None));
        let bytes = write_request(SENDER, 11, &request());
        let message = read(&bytes, FLEET, 3).unwrap();
        assert_eq!(message.number, 11);
        assert_eq!(message.body, Body::Request(request()));
    }

    #[test]
    fn every_truncated_message_is_refused() {
        for bytes in [frame(), write_request(SENDER, 1, &request())] {
            for length in 0..bytes.len() {
                assert!(read(&bytes[..length], FLEET, 3).is_err(), "{length}");
            }
            let mut longer = bytes.clone();
            longer.push(0);
            assert!(read(&longer, FLEET, 3).is_err());
        }
    }

    #[test]
    fn another_release_is_refused_with_both_versions_and_another_fleet_too() {
        let mut bytes = frame();
        bytes[16] = b'9';
        let refused = read(&bytes, FLEET, 3).unwrap_err();
        assert_eq!(refused.name(), "another release");
        let (own, shown) = (env!("CARGO_PKG_VERSION"), refused.to_string());
        assert!(shown.contains(own), "{shown}");
        assert!(shown.contains(&own.replacen('0', "9", 1)), "{shown}");
        let refused = read(&frame(), FleetId(78), 3).unwrap_err();
        assert_eq!(refused.name(), "another fleet");
        // The messages of a release that compared realtime clocks.
        let mut bytes = frame();
        bytes[8..12].copy_from_slice(&5_u32.to_le_bytes());
        let shown = read(&bytes, FLEET, 3).unwrap_err().to_string();
        assert!(shown.contains("messages 5") && shown.contains("one release"), "{shown}");
    }

    proptest! {
        #[test]
        fn no_bytes_panic(bytes in prop::collection::vec(any::<u8>(), 0..400), at in 0_usize..300, by: u8) {
            let _ = read(&bytes, FLEET, 3);
            for mut damaged in [frame(), write_request(SENDER, 1, &request())] {
                let at = at % damaged.len();
                damaged[at] ^= by;
                let _ = read(&damaged, FLEET, 3);
            }
        }
    }
}
