//! What is logged, to stderr.

use tracing_subscriber::EnvFilter;

const VARIABLE: &str = "JOULEBUS_LOG";

/// Starts logging: `JOULEBUS_LOG` decides, else how often `--verbose` was given.
pub fn start(verbose: u8) {
    let level = match verbose {
        // What iceoryx2 warns of, the bus handles and reports in its own words.
        0 => "warn,iceoryx2=error",
        1 => "info,iceoryx2=error",
        2 => "debug,iceoryx2=warn",
        _ => "trace",
    };
    let filter = match EnvFilter::try_from_env(VARIABLE) {
        Ok(filter) => filter,
        Err(error) => {
            if std::env::var_os(VARIABLE).is_some_and(|value| !value.is_empty()) {
                crate::output::say(&format!("{VARIABLE} is not used: {error}"));
            }
            EnvFilter::new(level)
        }
    };
    // Fails only when logging was started before: then it stays as it is.
    let _ = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::IsTerminal::is_terminal(&std::io::stderr()))
        .try_init();
}
