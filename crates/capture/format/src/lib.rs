//! The format of captures: everything in a fleet's shared memory, in a self-describing file. The
//! only crate that uses mcap. `joulebus-capture-recorder` records, `joulebus-capture-verify`
//! recomputes.
//!
//! ```
//! use joulebus_capture_format::{Attachments, CaptureSettings, Message, Reader, Times, Writer};
//! use joulebus_wire::{Sample, SampleHeader, Samples};
//!
//! let sample = Sample::new(7, 0, 1_000_000).reading(4.2, 1_000_000);
//! let message = Message::of::<Samples>(SampleHeader::default(), vec![sample]);
//! let mut writer =
//!     Writer::new(Vec::new(), CaptureSettings::default(), &Attachments::default())?;
//! writer.write("lab", Times { log_ns: 2_000_000, publish_ns: 1_000_000 }, &message)?;
//! let (written, _, file) = writer.finish()?;
//! assert_eq!(written.messages, 1);
//!
//! let mut reader = Reader::new(&file[..])?;
//! let entry = reader.next_entry()?.ok_or("the file is empty")?;
//! assert_eq!(&*entry.topic, "joulebus/lab/samples");
//! let frame = entry.message.frame::<Samples>().ok_or("it is no frame of samples")?;
//! assert_eq!(frame.rows[0].power_w, 4.2);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **Three types to know.** A [`Writer`] writes messages to a file. Written messages survive a
//! crash. A [`Reader`] reads them, in constant memory. [`Attachments`] are the config, the models
//! and the build, which make the file replayable on its own. [`scan`], [`mod@inspect`] and
//! [`mod@recover`] read damaged files too. [`import`] reads recordings of ROS 2.
//!
//! **The file** is MCAP with protobuf messages. Foxglove and PlotJuggler open it directly. It has
//! one channel per fleet and service, `joulebus/<fleet>/samples` and so on, and optionally channels
//! of single robots for plots, `joulebus/<fleet>/robot/<id>/forecast`.
//!
//! **Bits.** Every field of the payloads in [`joulebus_wire`] is in the message, and is restored
//! with the same bits, −0 and NaN payloads included.
//!
//! **Units.** A message's log time is when the recorder received it, its publish time when it was
//! sent. Both are Unix ns, computed from the monotonic clock with a fixed offset per recording
//! ([`Clock`]). So they are in order even if the wall clock jumps. The messages also contain the
//! monotonic times.
//!
//! **Errors** state the place in the file, what was found and the remedy: [`ReadError`],
//! [`WriteError`], [`ScanError`](scan::ScanError).
//!
//! **In the book**: [record everything, and replay it][1], [formats of recordings][2], [our own
//! scanner reads captures][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/captures.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/reference/recordings.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/captures.md#our-own-scanner-reads-captures
#![forbid(unsafe_code)]

mod attachments;
mod chunk;
mod clock;
mod definitions;
pub mod import;
pub mod inspect;
mod messages;
mod reader;
pub mod recover;
pub mod scan;
mod writer;

pub use attachments::{Attached, Attachments};
pub use clock::Clock;
pub use messages::{
    Content, DecodeError, Entry, Frame, Message, MessageKind, OutOfRange, Query, RobotRow,
};
pub use reader::{ReadError, Reader};
pub use writer::{
    CaptureSettings, MAX_CHANNELS, Preset, Sequences, Times, WriteError, Writer, Written,
};
