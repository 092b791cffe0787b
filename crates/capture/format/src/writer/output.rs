//! Buffered output of a capture.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Buffer size that causes a flush.
const MAX_GATHERED: usize = 1 << 20;

/// Buffers bytes and passes them on when flushed. After the first failure nothing is passed on any
/// more: bytes after a hole would corrupt the file.
#[derive(Debug)]
pub(crate) struct Output<W> {
    inner: W,
    gathered: Vec<u8>,
    taken: u64,
    bytes: Arc<AtomicU64>,
    failed: bool,
}

impl<W: Write> Output<W> {
    /// `bytes` counts the bytes passed on and flushed.
    pub(crate) const fn new(inner: W, bytes: Arc<AtomicU64>) -> Self {
        Self { inner, gathered: Vec::new(), taken: 0, bytes, failed: false }
    }

    pub(crate) fn into_inner(self) -> W {
        self.inner
    }

    fn hand_on(&mut self) -> io::Result<()> {
        if self.failed {
            return Err(io::Error::other("an earlier write failed"));
        }
        let handed_on = self.inner.write_all(&self.gathered);
        self.gathered.clear();
        self.failed = handed_on.is_err();
        handed_on
    }
}

impl<W: Write> Write for Output<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.failed {
            return Err(io::Error::other("an earlier write failed"));
        }
        self.gathered.extend_from_slice(bytes);
        self.taken += bytes.len() as u64;
        if self.gathered.len() > MAX_GATHERED {
            self.hand_on()?;
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.hand_on()?;
        let flushed = self.inner.flush();
        match &flushed {
            Ok(()) => self.bytes.store(self.taken, Ordering::Relaxed),
            Err(_) => self.failed = true,
        }
        flushed
    }
}
