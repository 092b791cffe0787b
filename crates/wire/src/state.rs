//! Keyframes: the worker's whole state at one tick, so that a recording that begins in the middle
//! can be computed again.

use bytemuck::{Pod, Zeroable};

use crate::layout::ZeroCopySend;

/// Header of a piece of a keyframe. The payload is bytes.
///
/// A keyframe is too long for one frame: it comes in pieces, in order, and is whole when they add
/// up to `total_bytes`. What the bytes mean is `joulebus_fleet::FleetState`'s to say. A keyframe of
/// which a piece is missing is of no use; the next one comes soon.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable, ZeroCopySend)]
#[type_name("joulebus.StateHeader.v1")]
pub struct StateHeader {
    /// [`crate::SCHEMA_VERSION`].
    pub schema: u32,
    /// Process id of the worker.
    pub pid: u32,
    /// As in [`crate::ForecastHeader::worker_epoch`].
    pub worker_epoch: u64,
    /// The tick after which the state was taken; 0: before the first.
    pub tick: u64,
    /// Bytes of the whole keyframe.
    pub total_bytes: u64,
    /// Place of this piece in it.
    pub offset: u64,
    /// When the state was taken, monotonic ns.
    pub taken_ns: u64,
    /// When the piece was sent, monotonic ns.
    pub sent_ns: u64,
    /// When the piece was sent, Unix ns: a label.
    pub sent_unix_ns: u64,
}
