//! iceoryx2's messages as events of `tracing`.

use std::fmt::Arguments;

use iceoryx2_log::{Log, LogLevel};

/// Sends the messages of iceoryx2 to `tracing`, with the target `iceoryx2`, from now on. For
/// programs: a library leaves the logger to the program around it. Returns false if iceoryx2 has a
/// logger already, by an earlier call or because it has logged something: the first one stays.
pub fn trace_iceoryx2() -> bool {
    iceoryx2_log::set_logger(&ToTracing)
}

/// iceoryx2's own logger of that kind is a feature, and two such features do not compile: a program
/// with iceoryx2's defaults could not be linked with this crate.
struct ToTracing;

impl Log for ToTracing {
    fn log(&self, level: LogLevel, origin: Arguments<'_>, message: Arguments<'_>) {
        match level {
            LogLevel::Trace => tracing::trace!(target: "iceoryx2", %origin, "{message}"),
            LogLevel::Debug => tracing::debug!(target: "iceoryx2", %origin, "{message}"),
            LogLevel::Info => tracing::info!(target: "iceoryx2", %origin, "{message}"),
            LogLevel::Warn => tracing::warn!(target: "iceoryx2", %origin, "{message}"),
            LogLevel::Error | LogLevel::Fatal => {
                tracing::error!(target: "iceoryx2", %origin, "{message}");
            }
        }
    }
}
