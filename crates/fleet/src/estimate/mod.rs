//! Estimates per robot: lag window, intervals, online learning and scores.

pub(crate) mod adaptation;
pub(crate) mod interval;
pub(crate) mod mixture;
pub(crate) mod scores;
pub(crate) mod window;
