#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod config_file;
pub mod described;
pub mod exit;
pub mod exit_with_parent;
pub mod file;
mod gone;
pub mod installed;
pub mod logging;
pub mod model_range;
pub mod model_source;
pub mod options;
pub mod output;
pub mod platform;
pub mod shell;
pub mod stop;
pub mod utc;
pub mod verb;
