//! The capture written by a demo.

use std::path::{Path, PathBuf};

use joulebus_bus::clock;
use joulebus_program::exit::UsageError;
use serde::{Deserialize, Serialize};

use joulebus_program::utc::Utc;

/// Path of the capture.
pub(super) fn file(asked: Option<&Path>) -> Result<PathBuf, UsageError> {
    let path = asked.map_or_else(usual, ToOwned::to_owned);
    // Tried here, where the error can be reported, instead of in a process that would be restarted
    // repeatedly.
    let tried = std::fs::File::create_new(&path).and_then(|_| std::fs::remove_file(&path));
    match tried {
        Ok(()) => Ok(path),
        Err(error) => Err(UsageError(format!(
            "cannot write the capture {}: {error}. Name another with --capture, or leave it out \
             with --no-capture",
            path.display()
        ))),
    }
}

/// Named after the time, so that no file is overwritten.
fn usual() -> PathBuf {
    let Utc { year, month, day, hour, minute, second, .. } = Utc::new(clock::unix_ns());
    PathBuf::from(format!(
        "joulebus-demo-{year}{month:02}{day:02}T{hour:02}{minute:02}{second:02}Z.mcap"
    ))
}

/// The recorder's report on the capture.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Captured {
    /// The path of the first file. There is only one unless the recorder died.
    #[serde(default)]
    pub(super) path: PathBuf,
    pub(super) messages: u64,
    pub(super) bytes: u64,
    /// Duration of the recording, s.
    pub(super) duration_s: f64,
    /// CPU time of the recorder over that time: 1 is one core.
    pub(super) cpu_share: f64,
    pub(super) messages_lost: u64,
    /// Reason that the recording stopped before its end, if it did.
    pub(super) failure: Option<String>,
}

impl Captured {
    /// Parses the recorder's report.
    pub(super) fn read(report: &str, path: &Path) -> Option<Self> {
        let read: Self = serde_json::from_str(report).ok()?;
        Some(Self { path: path.to_owned(), ..read })
    }
}
