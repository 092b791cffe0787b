//! Which services a link carries, and what their frames consist of.

use bytemuck::{Pod, pod_read_unaligned};
use joulebus_wire::{
    Budget, BudgetHeader, Diagnostic, DiagnosticHeader, Forecast, ForecastHeader, PlanState,
    PlanStateHeader, SCHEMA_VERSION, Sample, SampleHeader, StateHeader, TakenFrame, TickHeader,
};

/// A service whose frames cross a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Carried {
    Forecasts,
    Diagnostics,
    Budgets,
    PlanStates,
    Ticks,
    Samples,
    /// A worker's whole state, for those that stand by: the elements are its bytes.
    State,
}

/// Bytes of a state for each robot of the capacity, at most, and for all else: it takes some 500 and a few thousand.
const STATE_BYTES_PER_ROBOT: usize = 4_096;
const STATE_BYTES: usize = 1 << 18;

impl Carried {
    pub(crate) const ALL: [Self; 7] = [
        Self::Forecasts,
        Self::Diagnostics,
        Self::Budgets,
        Self::PlanStates,
        Self::Ticks,
        Self::Samples,
        Self::State,
    ];

    /// The code in messages: from 1, because 0 is a message without a frame.
    pub(crate) const fn code(self) -> u32 {
        self as u32 + 1
    }

    pub(crate) fn decode(code: u32) -> Option<Self> {
        let at = usize::try_from(code).ok()?.checked_sub(1)?;
        Self::ALL.get(at).copied()
    }

    /// The bit in a request's set.
    pub(crate) const fn bit(self) -> u32 {
        1 << self as u32
    }

    /// Bytes of a header, and of an element.
    pub(crate) const fn sizes(self) -> (usize, usize) {
        match self {
            Self::Forecasts => sizes::<ForecastHeader, Forecast>(),
            Self::Diagnostics => sizes::<DiagnosticHeader, Diagnostic>(),
            Self::Budgets => sizes::<BudgetHeader, Budget>(),
            Self::PlanStates => sizes::<PlanStateHeader, PlanState>(),
            Self::Ticks => sizes::<TickHeader, TakenFrame>(),
            Self::Samples => sizes::<SampleHeader, Sample>(),
            Self::State => sizes::<StateHeader, u8>(),
        }
    }

    /// Whether elements are of one robot each, whose id they begin with.
    pub(crate) const fn is_by_robot(self) -> bool {
        !matches!(self, Self::Ticks | Self::State)
    }

    /// Elements that a frame of a fleet with that capacity may have.
    pub(crate) const fn most(self, capacity: usize) -> usize {
        match self {
            Self::State => capacity
                .saturating_mul(STATE_BYTES_PER_ROBOT)
                .saturating_add(STATE_BYTES),
            _ => capacity,
        }
    }
}

const fn sizes<H, T>() -> (usize, usize) {
    (size_of::<H>(), size_of::<T>())
}

/// A frame that came over a link: sizes are right, the contents are not checked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct RawFrame<'a> {
    pub(crate) service: Carried,
    header: &'a [u8],
    elements: &'a [u8],
}

impl<'a> RawFrame<'a> {
    /// A frame of these bytes, header first. `most`: rows that a frame of the fleet may have.
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
            return Err(FrameError::TooLong {
                found: count,
                allowed,
            });
        }
        let allowed = header_bytes + count * element_bytes;
        if bytes.len() != allowed {
            let found = bytes.len();
            return Err(FrameError::Length { found, allowed });
        }
        let (header, elements) = bytes.split_at(header_bytes);
        // Every header begins with the version.
        let schema = pod_read_unaligned::<u32>(&header[..4]);
        if schema != SCHEMA_VERSION {
            return Err(FrameError::Schema { found: schema });
        }
        Ok(Self {
            service,
            header,
            elements,
        })
    }

    /// The header, as that of its service.
    pub(crate) fn header<H: Pod>(&self) -> H {
        pod_read_unaligned(self.header)
    }

    /// When the frame was sent on its host, as its header says, monotonic ns there; 0 where headers do not say.
    pub(crate) fn sent_ns(&self) -> u64 {
        match self.service {
            Carried::Forecasts => self.header::<ForecastHeader>().sent_ns,
            Carried::Diagnostics => 0,
            Carried::Budgets => self.header::<BudgetHeader>().sent_ns,
            Carried::PlanStates => self.header::<PlanStateHeader>().sent_ns,
            Carried::Ticks => self.header::<TickHeader>().sent_ns,
            Carried::Samples => self.header::<SampleHeader>().sent_ns,
            Carried::State => self.header::<StateHeader>().sent_ns,
        }
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

    /// All elements, which are the service's.
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
        "a frame of schema version {found}, allowed is {SCHEMA_VERSION}; use one release on all hosts"
    )]
    Schema { found: u32 },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_and_bits_are_distinct_and_decode_to_their_service() {
        let mut bits = 0;
        for (at, service) in Carried::ALL.into_iter().enumerate() {
            assert_eq!(service as usize, at);
            assert_eq!(Carried::decode(service.code()), Some(service));
            assert_eq!(bits & service.bit(), 0);
            bits |= service.bit();
        }
        for code in [0, 8, u32::MAX] {
            assert_eq!(Carried::decode(code), None, "{code}");
        }
    }

    #[test]
    fn a_frame_whose_length_count_or_version_is_wrong_is_refused() {
        let header = ForecastHeader {
            schema: SCHEMA_VERSION,
            tick: 9,
            ..ForecastHeader::default()
        };
        let rows = [Forecast {
            robot: 3,
            ..Forecast::default()
        }; 2];
        let mut bytes = bytemuck::bytes_of(&header).to_vec();
        bytes.extend_from_slice(bytemuck::cast_slice(&rows));
        let frame = RawFrame::new(Carried::Forecasts, 2, 2, &bytes).unwrap();
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
            let refused = RawFrame::new(Carried::Forecasts, count, most, &bytes[..length]);
            assert!(refused.is_err(), "{count} {most} {length}");
        }
        bytes[0] ^= 1;
        let refused = RawFrame::new(Carried::Forecasts, 2, 2, &bytes).unwrap_err();
        let found = SCHEMA_VERSION ^ 1;
        assert_eq!(refused, FrameError::Schema { found });
    }
}
