//! Ports of a member.

mod channel;
mod connection_leak;
mod degradation;
mod inlet;
mod noted;
mod open;
mod outlet;
mod places;
mod poll;
mod query;
mod readiness;
mod reading;
mod repair;
mod samples;
mod service;
mod wait;
mod writer_watch;

use self::channel::Received;
pub use self::channel::{Loan, Reader, Writer};
use self::inlet::Member;
pub use self::inlet::ReceiveError;
use self::noted::Noted;
pub use self::outlet::{SendError, Sent};
use self::places::OpenPlaces;
pub use self::poll::Poller;
pub use self::query::{OpenQuery, QueryClient, QueryError, QueryServer};
pub use self::readiness::Readiness;
pub use self::reading::Frame;
pub use self::samples::{FrameBuf, IncomingFrame, SampleReader, SampleWriter};
pub use self::service::OpenError;
pub use self::wait::{WaitError, Waiter, Waker, Woken};
pub use self::writer_watch::WriterWatch;
