//! The channels that a link carries, and the layout of their frames.

use bytemuck::{Pod, pod_read_unaligned};
use joulebus_wire::{
    Budgets, Channel, Diagnostics, Forecasts, FrameHeader as _, FrameRows, Outlooks, PlanStates,
    SCHEMA_VERSION, Samples, State, Ticks,
};

/// A channel whose frames cross a link, by its code in messages. Codes start at 1, because 0 is a
/// message without a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Carried(u32);

/// A link's knowledge of a channel.
#[derive(Debug, Clone, Copy)]
struct Frames {
    /// Size of a header and of an element, bytes.
    sizes: (usize, usize),
    rows: FrameRows,
    sent_ns: fn(&[u8]) -> Option<u64>,
}

impl Frames {
    const fn of<C: Channel>() -> Self {
        Self {
            sizes: (size_of::<C::Header>(), size_of::<C::Row>()),
            rows: C::ROWS,
            sent_ns: |header| pod_read_unaligned::<C::Header>(header).sent_ns(),
        }
    }
}

/// The channels in the order of their codes.
const CHANNELS: &[Frames] = &[
    Frames::of::<Forecasts>(),
    Frames::of::<Diagnostics>(),
    Frames::of::<Budgets>(),
    Frames::of::<PlanStates>(),
    Frames::of::<Ticks>(),
    Frames::of::<Samples>(),
    Frames::of::<State>(),
    Frames::of::<Outlooks>(),
    #[cfg(test)]
    Frames::of::<joulebus_testkit_channels::Signals>(),
];

/// Maximum size of a state, bytes: for each robot of the capacity, and for the rest. It takes some
/// 500 and a few thousand.
const STATE_BYTES_PER_ROBOT: usize = 4_096;
const STATE_BYTES: usize = 1 << 18;

impl Carried {
    pub(crate) const FORECASTS: Self = Self(1);
    pub(crate) const DIAGNOSTICS: Self = Self(2);
    pub(crate) const BUDGETS: Self = Self(3);
    pub(crate) const PLAN_STATES: Self = Self(4);
    pub(crate) const TICKS: Self = Self(5);
    pub(crate) const SAMPLES: Self = Self(6);
    /// A worker's whole state, for standbys. The elements are its bytes.
    pub(crate) const STATE: Self = Self(7);
    pub(crate) const OUTLOOKS: Self = Self(8);
    #[cfg(test)]
    pub(crate) const SIGNALS: Self = Self(9);

    pub(crate) fn all() -> impl Iterator<Item = Self> {
        (1..).take(CHANNELS.len()).map(Self)
    }

    pub(crate) const fn code(self) -> u32 {
        self.0
    }

    pub(crate) fn decode(code: u32) -> Option<Self> {
        Self::all().find(|carried| carried.code() == code)
    }

    /// The bit in a request's set of services.
    pub(crate) const fn bit(self) -> u32 {
        1 << (self.0 - 1)
    }

    const fn frames(self) -> &'static Frames {
        &CHANNELS[self.0 as usize - 1]
    }

    /// Size of a header and of an element, bytes.
    pub(crate) const fn sizes(self) -> (usize, usize) {
        self.frames().sizes
    }

    /// Whether each element belongs to one robot and begins with its id.
    pub(crate) const fn is_by_robot(self) -> bool {
        matches!(self.frames().rows, FrameRows::Robots)
    }

    /// Maximum number of elements of a frame in a fleet with that capacity.
    pub(crate) const fn most(self, capacity: usize) -> usize {
        match self.frames().rows {
            FrameRows::Bytes => {
                capacity.saturating_mul(STATE_BYTES_PER_ROBOT).saturating_add(STATE_BYTES)
            }
            _ => capacity,
        }
    }
}

/// Maximum size of a message's and its frame's headers, bytes.
const MAX_HEADER_BYTES: usize = 4_096;

/// Maximum message size in a fleet of that capacity, bytes.
pub(crate) fn max_message_bytes(capacity: usize) -> usize {
    let rows = Carried::all().map(|service| service.sizes().1);
    let longest = rows.max().unwrap_or_default();
    MAX_HEADER_BYTES + capacity.saturating_mul(longest)
}

/// Same as [`max_message_bytes`], including a worker's state.
pub(crate) fn max_state_message_bytes(capacity: usize) -> usize {
    let state = MAX_HEADER_BYTES.saturating_add(Carried::STATE.most(capacity));
    state.max(max_message_bytes(capacity))
}

/// What a stream carries. It is a part of the keys, so that access rules can distinguish the
/// streams.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Frames that a worker writes.
    Outputs,
    /// Samples that sources write.
    Samples,
}

impl Kind {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Outputs => "outputs",
            Self::Samples => "samples",
        }
    }
}

/// A received frame with checked sizes and unchecked contents.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct RawFrame<'a> {
    pub(crate) service: Carried,
    header: &'a [u8],
    elements: &'a [u8],
}

impl<'a> RawFrame<'a> {
    /// Splits the bytes of a frame, header first. `most` is the maximum number of rows of the
    /// fleet's frames.
    ///
    /// # Errors
    /// [`FrameError`]: the bytes are no frame of the service.
    pub(crate) fn new(
        service: Carried,
        count: u32,
        most: usize,
        bytes: &'a [u8],
    ) -> Result<Self, FrameError> {
        let (header_bytes, element_bytes) = service.sizes();
        let (count, allowed) = (count as usize, service.most(most));
        if count > allowed {
            return Err(FrameError::TooLong { found: count, allowed });
        }
        let allowed = header_bytes + count * element_bytes;
        if bytes.len() != allowed {
            let found = bytes.len();
            return Err(FrameError::Length { found, allowed });
        }
        let (header, elements) = bytes.split_at(header_bytes);
        // Every header begins with the schema version.
        let schema = pod_read_unaligned::<u32>(&header[..4]);
        if schema != SCHEMA_VERSION {
            return Err(FrameError::Schema { found: schema });
        }
        Ok(Self { service, header, elements })
    }

    /// The header, as the type of its service.
    pub(crate) fn header<H: Pod>(&self) -> H {
        pod_read_unaligned(self.header)
    }

    /// When the frame was sent by its header, monotonic ns of its host. 0 if headers do not state
    /// it.
    pub(crate) fn sent_ns(&self) -> u64 {
        (self.service.frames().sent_ns)(self.header).unwrap_or_default()
    }

    /// The number of elements.
    pub(crate) const fn len(&self) -> usize {
        self.elements.len() / self.service.sizes().1
    }

    /// Element `at`, below [`RawFrame::len`].
    pub(crate) fn element<T: Pod>(&self, at: usize) -> T {
        let bytes = self.service.sizes().1;
        pod_read_unaligned(&self.elements[at * bytes..][..bytes])
    }

    /// The bytes of all elements.
    pub(crate) const fn bytes(&self) -> &'a [u8] {
        self.elements
    }

    /// All elements, as the type of the service.
    pub(crate) fn elements<T: Pod>(&self) -> impl Iterator<Item = T> {
        let bytes = self.service.sizes().1;
        self.elements.chunks_exact(bytes).map(pod_read_unaligned)
    }
}

/// Why bytes are not a frame.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub(crate) enum FrameError {
    #[error("a frame of {found} elements, allowed are {allowed} (`fleet.capacity`)")]
    TooLong { found: usize, allowed: usize },
    #[error("a frame of {found} bytes that should have {allowed}")]
    Length { found: usize, allowed: usize },
    #[error(
        "a frame of schema version {found}, allowed is {SCHEMA_VERSION}. Use one release on all \
            hosts"
    )]
    Schema { found: u32 },
}

#[cfg(test)]
mod tests {
    use joulebus_wire::{Forecast, ForecastHeader};

    use super::*;

    #[test]
    fn codes_and_bits_are_distinct_and_decode_to_their_service() {
        let mut bits = 0;
        for (at, service) in Carried::all().enumerate() {
            assert_eq!(service.code() as usize, at + 1);
            assert_eq!(Carried::decode(service.code()), Some(service));
            assert_eq!(bits & service.bit(), 0);
            bits |= service.bit();
        }
        for code in [0, CHANNELS.len() as u32 + 1, u32::MAX] {
            assert_eq!(Carried::decode(code), None, "{code}");
        }
    }

    #[test]
    fn a_frame_whose_length_count_or_version_is_wrong_is_refused() {
        let header =
            ForecastHeader { schema: SCHEMA_VERSION, tick: 9, ..ForecastHeader::default() };
        let rows = [Forecast { robot: 3, ..Forecast::default() }; 2];
        let mut bytes = bytemuck::bytes_of(&header).to_vec();
        bytes.extend_from_slice(bytemuck::cast_slice(&rows));
        let frame = RawFrame::new(Carried::FORECASTS, 2, 2, &bytes).unwrap();
        assert_eq!(frame.header::<ForecastHeader>(), header);
        let copied: Vec<Forecast> = frame.elements().collect();
        assert_eq!((frame.len(), copied.as_slice()), (2, rows.as_slice()));
        for (count, most, length) in [
            (2, 1, bytes.len()),
            (u32::MAX, 2, bytes.len()),
            (1, 2, bytes.len()),
            (2, 2, bytes.len() - 1),
            (0, 2, 3),
            (0, 2, 0),
        ] {
            let refused = RawFrame::new(Carried::FORECASTS, count, most, &bytes[..length]);
            assert!(refused.is_err(), "{count} {most} {length}");
        }
        bytes[0] ^= 1;
        let refused = RawFrame::new(Carried::FORECASTS, 2, 2, &bytes).unwrap_err();
        let found = SCHEMA_VERSION ^ 1;
        assert_eq!(refused, FrameError::Schema { found });
    }
}
