//! The planner's view: a board fed from shared memory, shown live, as lines or as JSON.

mod board;
mod cells;
mod feed;
#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]
mod look;
mod plain;
mod record;
mod scores;
mod screen;
mod stages;
mod terminal;

pub(crate) use board::{Board, Link, Raised, Row};
pub(crate) use cells::count;
pub(crate) use feed::{Feed, Reading};
pub(crate) use plain::{line, table};
pub(crate) use record::FrameRecord;
pub(crate) use scores::Scores;
pub(crate) use screen::Screen;
pub(crate) use stages::Latency;
pub(crate) use terminal::show;
