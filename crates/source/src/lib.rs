#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod flow;
pub mod link;
pub mod rate;
pub mod report;
pub mod window;
