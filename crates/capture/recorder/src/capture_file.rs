//! The file of a capture on a disk that may be full or fail.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use joulebus_files::disk::{self, File, FileId};

use joulebus_capture_format::WriteError;

/// A file that contains only flushed data: when a write fails, the bytes since the last flush are
/// truncated. So a capture contains no partial chunk, nor a complete chunk of a failed flush: what
/// is counted as written is what can be read.
#[derive(Debug)]
pub(crate) struct CaptureFile {
    path: PathBuf,
    file: File,
    bytes: u64,
    flushed_bytes: Arc<AtomicU64>,
}

/// Looks whether the file is still at its path with all that was flushed.
#[derive(Debug)]
pub(crate) struct Watch {
    path: PathBuf,
    id: FileId,
    flushed_bytes: Arc<AtomicU64>,
}

impl Watch {
    /// Damage that another process has done to the file, if any. Since each write goes to the end,
    /// a file that was cut stays too short.
    pub(crate) fn harm(&self) -> Option<&'static str> {
        match disk::found_at(&self.path) {
            Ok(None) => Some("removed"),
            Ok(Some((id, _))) if id != self.id => Some("replaced"),
            Ok(Some((_, bytes))) if bytes < self.flushed_bytes.load(Ordering::Relaxed) => {
                Some("cut")
            }
            // What cannot be looked at is seen when it cannot be written.
            Ok(Some(_)) | Err(_) => None,
        }
    }
}

impl CaptureFile {
    /// Creates the file. An existing file is refused.
    pub(crate) fn create(path: &Path) -> Result<Self, WriteError> {
        let file = disk::create_to_append(path).map_err(|source| match source.kind() {
            io::ErrorKind::AlreadyExists => WriteError::Exists { path: path.to_owned() },
            _ => WriteError::Create { path: path.to_owned(), source },
        })?;
        Ok(Self { path: path.to_owned(), file, bytes: 0, flushed_bytes: Arc::default() })
    }

    /// A watch over the file.
    pub(crate) fn watch(&self) -> io::Result<Watch> {
        Ok(Watch {
            path: self.path.clone(),
            id: disk::id(&self.file)?,
            flushed_bytes: Arc::clone(&self.flushed_bytes),
        })
    }

    /// Syncs the file and its folder to the disk: write errors of the disk may be reported only
    /// then, and without the folder a power failure may take the file's name.
    pub(crate) fn sync(self) -> io::Result<()> {
        self.file.sync_all()?;
        let folder = self.path.parent().filter(|path| *path != Path::new(""));
        disk::sync_directory(folder.unwrap_or(Path::new(".")))
    }
}

impl Write for CaptureFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self.file.write(bytes) {
            Ok(written) if written > 0 || bytes.is_empty() => {
                self.bytes += written as u64;
                Ok(written)
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => Err(error),
            ended => {
                // A file that another process has cut is not made longer again.
                let flushed_bytes = self.flushed_bytes.load(Ordering::Relaxed);
                let found = disk::found_at(&self.path).ok().flatten();
                if found.is_some_and(|(_, bytes)| bytes < flushed_bytes) {
                    return ended;
                }
                if let Err(error) = self.file.set_len(flushed_bytes) {
                    let path = self.path.display();
                    tracing::warn!(%error, "{path} ends with half a chunk");
                }
                ended
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.flushed_bytes.store(self.bytes, Ordering::Relaxed);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read as _;

    use joulebus_wire::{TickHeader, Ticks};
    use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, memfd_create};

    use super::*;
    use joulebus_capture_format::{
        Attachments, CaptureSettings, Message, Preset, Reader, Times, Writer,
    };

    /// A disk with a capacity of `room` bytes, and a second descriptor of the file on it.
    fn disk(room: u64) -> (CaptureFile, File) {
        let flags = MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING;
        let file = File::from(memfd_create("joulebus-test", flags).unwrap());
        file.set_len(room).unwrap();
        fcntl_add_seals(&file, SealFlags::GROW).unwrap();
        let reading = file.try_clone().unwrap();
        let capture = CaptureFile {
            path: PathBuf::from("memory"),
            file,
            bytes: 0,
            flushed_bytes: Arc::default(),
        };
        (capture, reading)
    }

    /// Number of messages in a file.
    fn readable(file: &Path) -> u64 {
        let Ok(reader) = Reader::open(file) else {
            return 0;
        };
        reader.map_while(Result::ok).count() as u64
    }

    const GIVEN: u64 = 7;

    /// Passes messages to a writer, two per chunk. Returns the counts of written and unwritten
    /// ones.
    fn write<W: Write>(out: W, settings: CaptureSettings) -> (u64, u64, bool) {
        let Ok(mut writer) = Writer::new(out, settings, &Attachments::default()) else {
            return (0, GIVEN, false);
        };
        for number in 1..=GIVEN {
            let message = Message::of::<Ticks>(TickHeader::default(), Vec::new());
            let times = Times::default();
            // A failure is counted. Later calls return an error again.
            let _ = writer.write("lab", times, &message);
            if number % 2 == 0 {
                let _ = writer.flush();
            }
        }
        let _ = writer.flush();
        let written = writer.written();
        assert_eq!(written.by_topic.values().sum::<u64>(), written.messages);
        let unwritten = writer.unwritten().values().sum();
        (written.messages, unwritten, writer.finish().is_ok())
    }

    #[test]
    fn at_any_capacity_of_the_disk_the_file_contains_what_is_counted_as_written() {
        for preset in Preset::ALL {
            let settings = CaptureSettings::new(preset);
            let mut whole = Vec::new();
            assert_eq!(write(&mut whole, settings), (GIVEN, 0, true));
            let step = if preset == Preset::ZstdFast { 1 } else { 7 };
            for room in (0..whole.len() as u64).step_by(step) {
                let (file, reading) = disk(room);
                let (written, unwritten, finished) = write(file, settings);
                assert!(!finished, "{preset:?}, room for {room}");
                assert_eq!(written + unwritten, GIVEN, "{preset:?}, room for {room}");
                let mut bytes = Vec::new();
                let path = format!("/proc/self/fd/{}", std::os::fd::AsRawFd::as_raw_fd(&reading));
                File::open(&path).unwrap().read_to_end(&mut bytes).unwrap();
                assert!(whole.starts_with(&bytes), "{preset:?}, room for {room}");
                let found = readable(Path::new(&path));
                assert_eq!(found, written, "{preset:?}, room for {room}");
            }
        }
    }
}
