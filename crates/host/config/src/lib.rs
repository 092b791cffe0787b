//! One file configures every process of a fleet.
//!
//! ```
//! let text = r#"
//! [fleet]
//! name = "lab"
//! [[platform]]
//! file = "builtin:rover"
//! robots = ["0-9", 12]
//! "#;
//! let config = joulebus_config::Config::parse(text, std::path::Path::new("."))?;
//! assert_eq!(config.settings().platforms[0].robots, [0..=9, 12..=12]);
//!
//! let wrong = text.replace("name", "nmae");
//! let refused = joulebus_config::Config::parse(&wrong, std::path::Path::new(".")).unwrap_err();
//! assert!(refused.to_string().contains("`fleet.name`"));
//! # Ok::<(), joulebus_config::ConfigError>(())
//! ```
//!
//! [`Config::load`] reads the fleet's file and the platform files that it names. It checks every
//! key against one table ([`KEYS`]). It refuses unknown keys, and values that are out of range or
//! contradictory: all at once, each with file, line and remedy.
//!
//! **Three types to know.** A [`Config`] is plain values: [`Config::settings`] for the tick, and
//! [`Config::root`], [`Config::prefix`] and [`Config::fleet`] for shared memory. A [`Key`]
//! describes a key: unit, range, default and meaning. A [`ConfigError`] has all problems of a file.
//!
//! **Units** stand in the names of the keys: `_w`, `_s`, `_hz`, `_mps`.
//!
//! **In the book**: [config: every key][1], [check configs in an editor][2], [one file for all
//! processes][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/reference/config.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/editors.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/crates-interfaces-the-build.md#one-file-for-all-processes-and-one-table-of-its-keys
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
pub use files::is_below;
pub use joulebus_domain::{Domain, Limits, Scheduling};
pub use joulebus_settings as settings;
pub use key::{DefaultValue, File, Key, TextRule, ValueKind};
pub use keys::KEYS;
pub use model_source::ModelSource;
pub use problem::{ConfigError, Problem};
pub use table::{keys, list};
pub use template::{Assignment, fleet_file, platform_file};
pub use values::Scalar;
