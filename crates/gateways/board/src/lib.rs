//! A planner's data of a fleet, joined by robot: the source of every view.
//!
//! A part of the programs `joulebus` (`watch`, `demo`), `joulebus-serve` and `joulebus-bridge`. All
//! of them show the values of this crate, so their values are the same.
//!
//! **Three types to know.** A [`Reading`] is a planner like any other: it adds its frames to a
//! board. A [`Board`] has the rows of each robot, the runs of the worker, latencies, scores and
//! events. It is pure: time is an argument. A [`Feed`] reads in a thread of its own.
//! [`FrameRecord`] and [`RobotRecord`] are a board as JSON.
//!
//! **Units** are SI. Times are s since the board began, or ns of the monotonic clock. Latencies are
//! in µs. Unknown values are `None`, and null in JSON.
//!
//! **Errors** of the start state the remedy. A [`FeedError`] states why the thread does not read.
//!
//! **In the book**: [watch a fleet][1], [HTTP interface][2], [alarms][3], [programs that show
//! something poll][4].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/watch.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/reference/http.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/reference/alarms.md
//! [4]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/shared-memory-processes.md#programs-that-show-something-now-and-then-poll
#![forbid(unsafe_code)]

mod ahead;
mod alarm;
mod board;
mod feed;
mod record;
mod scores;
mod search;
mod sort;
mod stages;

pub use ahead::AheadScores;
pub use alarm::{AcknowledgedRecord, AlarmRecord, CardRecord};
pub use board::{Board, Link, Newest, Point, Raised, Row, WorkerRun};
pub use feed::{Feed, FeedError, Reading};
pub use record::{FrameRecord, LearnedRecord, OutlookRecord, RobotRecord, quality_name};
pub use scores::Scores;
pub use search::{Platforms, Search};
pub use sort::{Sort, SortKey};
pub use stages::{Counted, Latency, Stages, UPPER_S};
