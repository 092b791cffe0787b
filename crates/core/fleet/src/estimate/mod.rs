//! Estimates per robot: lag window, intervals, online learning and scores.

pub(crate) mod calibration;
pub(crate) mod energy;
pub(crate) mod hedge;
pub(crate) mod interval;
pub(crate) mod online;
pub(crate) mod scores;
pub(crate) mod window;
