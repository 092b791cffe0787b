//! The channels that a link carries, and the layout of their frames.

use std::cmp::Ordering;

use bytemuck::{Pod, pod_read_unaligned};
use joulebus_wire::{
    Budgets, Channel, Diagnostics, Flow, Forecasts, FrameHeader as _, FrameRows, Outlooks,
    PlanStates, SCHEMA_VERSION, Samples, State, Ticks,
};

/// A channel whose frames cross a link.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Carried {
    /// Its code in messages. Codes start at 1, because 0 is a message without a frame.
    pub(crate) code: u32,
    /// The last component of the service's name.
    pub(crate) name: &'static str,
    /// Size of a header and of an element, bytes.
    sizes: (usize, usize),
    flow: Flow,
    rows: FrameRows,
    sent_ns: fn(&[u8]) -> Option<u64>,
}

/// Makes something of each channel.
pub(crate) trait OfChannel {
    type Made;

    fn make<C: Channel>(&self, service: Carried) -> Self::Made;
}

macro_rules! carried {
    ($($(#[doc = $doc:literal])* $code:literal $name:ident: $channel:ident $(, $make:ident)?;)*) => {
        impl Carried {
            $($(#[doc = $doc])* pub(crate) const $name: Self = Self::of::<$channel>($code);)*

            /// In the order of their codes.
            pub(crate) const ALL: &'static [Self] = &[$(Self::$name),*];

            /// Makes something of each channel that a worker writes after its forecasts.
            pub(crate) fn behind_forecasts<M: OfChannel>(of: &M) -> Vec<M::Made> {
                vec![$($(of.$make::<$channel>(Self::$name),)?)*]
            }
        }
    };
}

// The channels that cross a link, with `make` where a worker writes them after its forecasts. Words of `follow.services` are the names of the services.
carried! {
    1 FORECASTS: Forecasts;
    2 DIAGNOSTICS: Diagnostics, make;
    3 BUDGETS: Budgets, make;
    4 PLAN_STATES: PlanStates, make;
    5 TICKS: Ticks;
    6 SAMPLES: Samples;
    /// A worker's whole state, for standbys. The elements are its bytes.
    7 STATE: State;
    8 OUTLOOKS: Outlooks, make;
}

/// Maximum size of a state, bytes: for each robot of the capacity, and for the rest. It takes some
/// 500 and a few thousand.
const STATE_BYTES_PER_ROBOT: usize = 4_096;
const STATE_BYTES: usize = 1 << 18;

impl Carried {
    pub(crate) const fn of<C: Channel>(code: u32) -> Self {
        Self {
            code,
            name: C::SERVICE.name(),
            sizes: (size_of::<C::Header>(), size_of::<C::Row>()),
            flow: C::FLOW,
            rows: C::ROWS,
            sent_ns: |header| pod_read_unaligned::<C::Header>(header).sent_ns(),
        }
    }

    /// The bit in a request's set of services.
    pub(crate) const fn bit(self) -> u32 {
        1 << (self.code - 1)
    }

    /// Size of a header and of an element, bytes.
    pub(crate) const fn sizes(self) -> (usize, usize) {
        self.sizes
    }

    /// True if only the newest frame counts.
    pub(crate) const fn is_replaced(self) -> bool {
        matches!(self.flow, Flow::Planners { .. })
    }

    /// True if each element belongs to one robot and begins with its id.
    pub(crate) const fn is_by_robot(self) -> bool {
        matches!(self.rows, FrameRows::Robots)
    }

    /// Maximum number of elements of a frame in a fleet with that capacity.
    pub(crate) const fn most(self, capacity: usize) -> usize {
        match self.rows {
            FrameRows::Bytes => {
                capacity.saturating_mul(STATE_BYTES_PER_ROBOT).saturating_add(STATE_BYTES)
            }
            _ => capacity,
        }
    }
}

impl PartialEq for Carried {
    fn eq(&self, other: &Self) -> bool {
        self.code == other.code
    }
}

impl Eq for Carried {}

impl PartialOrd for Carried {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Carried {
    fn cmp(&self, other: &Self) -> Ordering {
        self.code.cmp(&other.code)
    }
}

/// Maximum size of a message's and its frame's headers, bytes.
const MAX_HEADER_BYTES: usize = 4_096;

/// Maximum message size in a fleet of that capacity, bytes.
pub(crate) fn max_message_bytes(capacity: usize) -> usize {
    let rows = Carried::ALL.iter().map(|service| service.sizes().1);
    let longest = rows.max().unwrap_or_default();
    MAX_HEADER_BYTES + capacity.saturating_mul(longest)
}

/// Same as [`max_message_bytes`], including a worker's state.
pub(crate) fn max_state_message_bytes(capacity: usize) -> usize {
    let state = MAX_HEADER_BYTES.saturating_add(Carried::STATE.most(capacity));
    state.max(max_message_bytes(capacity))
}

/// Contents of a stream. They are a part of the keys, so that access rules can distinguish the
/// streams.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
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
        (self.service.sent_ns)(self.header).unwrap_or_default()
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

/// Reason that bytes are not a frame.
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
    fn codes_count_from_one() {
        let codes: Vec<u32> = Carried::ALL.iter().map(|service| service.code).collect();
        assert!(codes.iter().copied().eq(1..=codes.len() as u32), "{codes:?}");
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
