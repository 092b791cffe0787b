//! Detects the end of the supervisor, whatever its cause: stdin closes.

use std::io;
use std::time::Duration;

use anyhow::Context as _;
use rustix::process::{Signal, getpid, kill_process};

/// Time for a clean exit before the process is ended.
const GRACE: Duration = Duration::from_secs(5);

/// From now on this process exits, as after SIGTERM, when its stdin closes.
///
/// # Errors
/// The watching thread cannot be started.
pub fn end_with_stdin() -> anyhow::Result<()> {
    std::thread::Builder::new()
        .name("joulebus-parent".to_owned())
        .spawn(|| {
            // The input is discarded, and an error counts as the end.
            let _ = io::copy(&mut io::stdin().lock(), &mut io::sink());
            let _ = kill_process(getpid(), Signal::TERM);
            std::thread::sleep(GRACE);
            std::process::exit(1);
        })
        .context("cannot watch stdin")?;
    Ok(())
}
