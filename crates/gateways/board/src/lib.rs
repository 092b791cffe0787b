#![doc = include_str!("../README.md")]
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
pub use board::{Board, Link, Newest, Point, Raised, Row, WorkerRun, model_fit};
pub use feed::{Feed, FeedError, Reading};
pub use record::{FrameRecord, LearnedRecord, OutlookRecord, RobotRecord, quality_name};
pub use scores::Scores;
pub use search::{Platforms, Search};
pub use sort::{Sort, SortKey};
pub use stages::{Counted, Latency, Stages, UPPER_S};
