//! How a capture is written.

use std::time::Duration;

use mcap::{Compression, WriteOptions};

/// How much work goes into making a capture small.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum Preset {
    /// Not compressed: least work, biggest file.
    FastWrite,
    /// lz4.
    Lz4,
    /// zstd at its fastest.
    #[default]
    ZstdFast,
    /// zstd in chunks of up to a second, which a kill then costs: smallest file.
    ZstdSmall,
}

impl Preset {
    /// All presets.
    pub const ALL: [Self; 4] = [Self::FastWrite, Self::Lz4, Self::ZstdFast, Self::ZstdSmall];

    /// The name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::FastWrite => "fastwrite",
            Self::Lz4 => "lz4",
            Self::ZstdFast => "zstd_fast",
            Self::ZstdSmall => "zstd_small",
        }
    }

    /// What a chunk may span in time before it is written: about what a killed recorder loses.
    #[must_use]
    pub const fn chunk(self) -> Duration {
        match self {
            Self::FastWrite | Self::Lz4 | Self::ZstdFast => Duration::from_millis(50),
            Self::ZstdSmall => Duration::from_secs(1),
        }
    }
}

/// How a capture is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CaptureSettings {
    /// Compression and chunks.
    pub preset: Preset,
    /// What a chunk may span in time before it is written, ns. Counted in log time.
    pub chunk_ns: u64,
}

impl Default for CaptureSettings {
    fn default() -> Self {
        Self::of(Preset::default())
    }
}

impl CaptureSettings {
    /// As the preset has it.
    #[must_use]
    pub const fn of(preset: Preset) -> Self {
        Self {
            preset,
            chunk_ns: preset.chunk().as_nanos() as u64,
        }
    }

    /// Chunks grow in memory and are written whole, so that nothing is ever sought or rewritten: a
    /// full disk then ends a file, but spoils nothing that is in it.
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
