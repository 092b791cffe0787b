#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod builtin;
mod bundle;
mod checked_file;
mod config;
mod consistency;
mod cpus;
mod document;
mod explain;
mod files;
mod gateway_keys;
mod key;
mod keys;
mod model_source;
mod numbers;
mod problem;
mod remedy;
mod robots;
mod shared_memory;
mod show;
mod table;
mod template;
mod values;

pub use builtin::{Demo, builtin_model, builtin_models, builtin_platform, builtin_platforms};
pub use bundle::{Bundle, BundleError};
pub use checked_file::{CheckedFile, Section, Text};
pub use config::{Checkpoint, Config, Queries, RecordingOptions, Threads};
pub use explain::{Explanation, UnknownKey, explain, explanations};
pub use files::{default_root, is_below};
pub use joulebus_settings::{self as settings, Domain, Limits, Scheduling};
pub use key::{DefaultValue, File, Key, TextRule, ValueKind};
pub use keys::KEYS;
pub use model_source::ModelSource;
pub use problem::{ConfigError, Problem};
pub use table::{keys, list};
pub use template::{Assignment, fleet_file, platform_file};
pub use values::Scalar;
