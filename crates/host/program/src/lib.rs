//! The shared part of all joulebus programs: arguments, output, exit codes, signals and logging.
//!
//! A part of the programs `joulebus`, `joulebus-lab`, `joulebus-serve`, `joulebus-link` and
//! `joulebus-bridge`. It is not for use on its own.
//!
//! **Three types to know.** [`GlobalOptions`](options::GlobalOptions) are the options of every
//! verb. An [`Output`](output::Output) writes results to stdout, as text or as JSON. Everything
//! else goes to stderr. An [`Outcome`](exit::Outcome) is the result of a verb, from which its exit
//! code follows.
//!
//! **Verbs.** A verb that is a separate program has its `main` in [`verb`]. [`described`] gives its
//! options to `joulebus`, as data.
//!
//! **Signals.** [`stop`] turns SIGINT, SIGTERM and SIGHUP into a flag, so that the clean-up always
//! runs.
//!
//! **Units** stand in the names: ns, s, Hz.
//!
//! **Errors** are `anyhow::Error`, which [`exit`] prints once to stderr. A
//! [`UsageError`](exit::UsageError) is for arguments that are well formed but invalid together.
//!
//! **In the book**: [programs and verbs][1], [every option][2], [one program for recordings, and
//! options as data][3].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/reference/programs.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/reference/programs.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/decisions/crates-interfaces-the-build.md#one-program-for-recordings-and-models-and-options-as-data
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
