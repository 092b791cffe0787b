//! Workaround: one zenoh thread for TLS connections.
//!
//! By default two threads read and write a TLS connection without a lock between them (zenoh 1.10,
//! issue 2557). Sound connections then break, and memory may be read wrongly.

use std::env;
use std::os::unix::process::CommandExt as _;
use std::process::Command;

/// The environment variable from which alone zenoh takes its number of threads.
const VARIABLE: &str = "ZENOH_RUNTIME";
const ONE: &str = "(tx: (handover: rx), rx: (worker_threads: 1))";

/// Executes this program again in the same process, with one thread, unless the environment already
/// sets a number. Call it before anything is opened.
pub(crate) fn begin() {
    if env::var_os(VARIABLE).is_some() {
        return;
    }
    let mut arguments = env::args_os();
    let name = arguments.next().unwrap_or_default();
    // `exec` returns only if it failed.
    let failed = env::current_exe().map_or_else(
        |error| error,
        |own| {
            let mut again = Command::new(own);
            again.arg0(name).args(arguments).env(VARIABLE, ONE).exec()
        },
    );
    tracing::warn!("set {VARIABLE}=\"{ONE}\": without it connections with TLS may end: {failed}");
}
