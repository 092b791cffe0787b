//! Settings of a capture file.

use std::time::Duration;

use mcap::{Compression, WriteOptions};

/// Trade-off between work and file size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum Preset {
    /// No compression: least work, largest file.
    FastWrite,
    /// lz4.
    Lz4,
    /// zstd at its fastest.
    #[default]
    ZstdFast,
    /// zstd in chunks of up to a second, the amount lost if killed: smallest file.
    ZstdSmall,
}

impl Preset {
    /// All presets.
    pub const ALL: [Self; 4] = [Self::FastWrite, Self::Lz4, Self::ZstdFast, Self::ZstdSmall];

    /// The name in command-line options.
    pub const fn name(self) -> &'static str {
        match self {
            Self::FastWrite => "fastwrite",
            Self::Lz4 => "lz4",
            Self::ZstdFast => "zstd_fast",
            Self::ZstdSmall => "zstd_small",
        }
    }

    /// Maximum time span of a chunk: approximately what a killed recorder loses.
    #[must_use]
    pub const fn chunk(self) -> Duration {
        match self {
            Self::FastWrite | Self::Lz4 | Self::ZstdFast => Duration::from_millis(50),
            Self::ZstdSmall => Duration::from_secs(1),
        }
    }
}

/// Settings of a capture file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CaptureSettings {
    /// Compression and chunks.
    pub preset: Preset,
    /// Maximum time span of a chunk in log time, ns.
    pub chunk_ns: u64,
}

impl Default for CaptureSettings {
    fn default() -> Self {
        Self::new(Preset::default())
    }
}

impl CaptureSettings {
    /// The settings of a preset.
    #[must_use]
    pub const fn new(preset: Preset) -> Self {
        Self { preset, chunk_ns: preset.chunk().as_nanos() as u64 }
    }

    /// Chunks grow in memory and are written as a whole, without seeking or rewriting: a full disk
    /// then truncates a file, but corrupts nothing in it.
    pub(crate) fn options(&self) -> WriteOptions {
        let (compression, level) = match self.preset {
            Preset::FastWrite => (None, 0),
            Preset::Lz4 => (Some(Compression::Lz4), 0),
            Preset::ZstdFast => (Some(Compression::Zstd), 1),
            Preset::ZstdSmall => (Some(Compression::Zstd), 9),
        };
        WriteOptions::new()
            .profile("joulebus")
            .library(concat!("joulebus/", env!("CARGO_PKG_VERSION")))
            .compression(compression)
            .compression_level(level)
            .compression_threads(0)
            .disable_seeking(true)
    }
}
