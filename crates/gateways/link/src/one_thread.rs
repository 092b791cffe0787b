//! One thread that reads and writes connections.
//!
//! Those of TLS are read and written by two threads without a lock between them otherwise (zenoh 1.10, its issue 2557):
//! connections end although all works, and memory may be misread.

use std::env;
use std::os::unix::process::CommandExt as _;
use std::process::Command;

/// Where zenoh looks for the number of its threads, and nowhere else.
const VARIABLE: &str = "ZENOH_RUNTIME";
const ONE: &str = "(tx: (handover: rx), rx: (worker_threads: 1))";

/// Begins this program anew, as the same process, unless the environment says already how many threads there are. Nothing
/// may have been opened before.
pub(crate) fn begin() {
    if env::var_os(VARIABLE).is_some() {
        return;
    }
    let mut arguments = env::args_os();
    let name = arguments.next().unwrap_or_default();
    // Returns only what failed.
    let failed = env::current_exe().map_or_else(
        |error| error,
        |own| {
            let mut again = Command::new(own);
            again.arg0(name).args(arguments).env(VARIABLE, ONE).exec()
        },
    );
    tracing::warn!("set {VARIABLE}=\"{ONE}\": without it connections with TLS may end: {failed}");
}
