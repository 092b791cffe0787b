//! The planner's view of a board: live in the terminal, or as lines.

mod cells;
mod choice;
mod help;
#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]
mod look;
mod panels;
mod plain;
mod screen;
mod style;
mod terminal;

pub(crate) use cells::count;
pub(crate) use plain::{line, table};
pub(crate) use screen::Screen;
pub(crate) use terminal::show;
