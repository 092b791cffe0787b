//! Where a capture's bytes go: gathered, and handed on in one piece.

use std::io::{self, Write};

/// Bytes that are gathered before they are handed on without being asked to.
const MOST_GATHERED: usize = 1 << 20;

/// Gathers bytes and hands them on when flushed. After the first failure nothing is handed on any
/// more: bytes after a hole would spoil the file for who reads it.
#[derive(Debug)]
pub(crate) struct Output<W> {
    inner: W,
    gathered: Vec<u8>,
    handed_on: u64,
    failed: bool,
}

impl<W: Write> Output<W> {
    pub(crate) const fn new(inner: W) -> Self {
        Self {
            inner,
            gathered: Vec::new(),
            handed_on: 0,
            failed: false,
        }
    }

    /// Bytes so far, handed on or not.
    pub(crate) const fn bytes(&self) -> u64 {
        self.handed_on + self.gathered.len() as u64
    }

    pub(crate) fn into_inner(self) -> W {
        self.inner
    }

    fn hand_on(&mut self) -> io::Result<()> {
        if self.failed {
            return Err(io::Error::other("an earlier write failed"));
        }
        let handed_on = self.inner.write_all(&self.gathered);
        self.handed_on += self.gathered.len() as u64;
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
        if self.gathered.len() > MOST_GATHERED {
            self.hand_on()?;
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.hand_on()?;
        self.inner.flush()
    }
}
