//! How a child notices the end of its supervisor, however that ended: its stdin closes.

use std::io;
use std::time::Duration;

use anyhow::Context as _;
use rustix::process::{Signal, getpid, kill_process};

/// What a process has for its end before it is ended.
const GRACE: Duration = Duration::from_secs(5);

/// From now on this process ends, as by SIGTERM, when its stdin closes.
///
/// # Errors
/// When the thread that waits for it cannot be started.
pub fn end_with_stdin() -> anyhow::Result<()> {
    std::thread::Builder::new()
        .name("joulebus-parent".to_owned())
        .spawn(|| {
            // Whatever comes is of no interest, and an error is an end as well.
            let _ = io::copy(&mut io::stdin().lock(), &mut io::sink());
            let _ = kill_process(getpid(), Signal::TERM);
            std::thread::sleep(GRACE);
            std::process::exit(1);
        })
        .context("cannot watch stdin")?;
    Ok(())
}
