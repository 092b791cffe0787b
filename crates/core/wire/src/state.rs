//! Keyframes: the worker's whole state at one tick, so that a recording can be recomputed from its
//! middle.

use crate::declare::ZeroCopySend;
use crate::rows;

rows! {
    /// Header of a piece of a keyframe. The payload is bytes. 72 bytes.
    ///
    /// A keyframe is too long for one frame: it is sent in pieces, in order, and is complete when
    /// they add up to `total_bytes`. `joulebus_fleet::FleetState` defines the encoding. A keyframe
    /// with a missing piece is discarded. The next one follows soon.
    #[derive(Eq)]
    pub struct StateHeader: "joulebus.StateHeader.v2", 72 {
        /// [`crate::SCHEMA_VERSION`].
        pub schema: u32,
        /// Process id of the worker.
        pub pid: u32,
        /// As in [`crate::ForecastHeader::worker_epoch`].
        #[run]
        pub worker_epoch: u64,
        /// The tick after which the state was taken. 0 before the first.
        pub tick: u64,
        /// Bytes of the complete keyframe.
        pub total_bytes: u64,
        /// Offset of this piece in the keyframe.
        pub offset: u64,
        /// When the state was taken, monotonic ns.
        #[instant]
        pub taken_ns: u64,
        /// When the piece was sent, monotonic ns.
        #[instant]
        pub sent_ns: u64,
        /// When the piece was sent, Unix ns: informative only.
        pub sent_unix_ns: u64,
        /// [`crate::fnv1a`] of the keyframe that the run sent before this one. 0 for the first one:
        /// a recording that lacks a keyframe shows it.
        pub before_hash: u64,
    }
}
