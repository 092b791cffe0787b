//! Captures: everything in a fleet's shared memory, recorded in a self-describing file. The only
//! crate that uses mcap.
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
//! | [`record`] | records shared memory to files, tolerating slow and full disks |
//! | [`verify`] | recomputes everything that was published, bit for bit |
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
pub mod record;
pub mod recover;
mod ros_file;
pub mod scan;
pub mod verify;
mod writer;

pub use attachments::{AttachError, Attached, Attachments};
pub use clock::Clock;
pub use inspect::values;
pub use joulebus_ros_messages as ros;
pub use messages::{DecodeError, Entry, Message, MessageKind, OutOfRange, Query};
pub use reader::{ReadError, Reader};
pub use ros_file::{RosFile, RosTopic, RosTopicId};
pub use writer::{
    CaptureFile, CaptureSettings, Preset, Sequences, Times, WriteError, Writer, Written,
};
