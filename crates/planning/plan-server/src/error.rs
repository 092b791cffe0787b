//! The error of the ports.

/// The ports are opened again after it.
pub(crate) type ServerError = Box<dyn std::error::Error + Send + Sync>;
