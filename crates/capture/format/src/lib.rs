//! The format of captures: everything in a fleet's shared memory, in a self-describing file. The
//! only crate that uses mcap. `joulebus-capture-recorder` records, `joulebus-capture-verify`
//! recomputes.
//!
//! A capture is an MCAP file with protobuf messages; it contains the schemas, the config, the
//! models and the build. Foxglove and PlotJuggler open it directly. One channel per fleet and
//! service, `joulebus/<fleet>/samples` and so on, and optionally channels of single robots for
//! plots, `joulebus/<fleet>/robot/<id>/forecast`.
//!
//! | part | purpose |
//! |---|---|
//! | [`Writer`] | writes messages to a file; written messages survive a crash |
//! | [`Reader`] | reads messages from a file, in constant memory |
//! | [`scan`], [`inspect`], [`recover`] | any MCAP file, damaged ones too |
//! | [`import`] | recordings of ROS 2 |
//! | [`Attachments`] | config, models and build, which make the file replayable on its own |
//!
//! **Bits.** Every field of the payloads in [`joulebus_wire`] is in the message, and is restored
//! with the same bits, −0 and NaN payloads included.
//!
//! **Time.** A message's log time is when the recorder received it, its publish time when it was
//! sent; both are Unix ns, computed from the monotonic clock with a fixed offset per recording
//! ([`Clock`]). So they are in order even if the wall clock jumps. The messages also contain the
//! monotonic times.
#![forbid(unsafe_code)]

mod attachments;
mod chunk;
mod clock;
pub mod import;
pub mod inspect;
mod messages;
mod reader;
pub mod recover;
mod ros_file;
pub mod scan;
mod writer;

pub use attachments::{Attached, Attachments};
pub use clock::Clock;
pub use inspect::values;
pub use messages::{
    Content, DecodeError, Entry, ForEachChannel, Frame, Message, MessageKind, OutOfRange, Query,
    RobotRow,
};
pub use reader::{ReadError, Reader};
pub use ros_file::{RosFile, RosTopic, RosTopicId};
pub use writer::{
    CaptureSettings, MAX_CHANNELS, Preset, Sequences, Times, WriteError, Writer, Written,
};
