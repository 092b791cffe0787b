//! Where clients connect: an address, a Unix socket, or both.

use std::fs;
use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _, PermissionsExt as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};

/// Mode of a socket: whoever may enter its folder and is in its group may connect.
const SOCKET_MODE: u32 = 0o660;

/// Who sends requests, as far as it is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Peer {
    /// A client of the network.
    Address(IpAddr),
    /// A user of this host, by the Unix socket.
    User(u32),
}

/// What is listened at.
#[derive(Debug)]
pub(super) struct Listeners {
    pub(super) tcp: Option<TcpListener>,
    pub(super) unix: Option<UnixListener>,
}

/// A socket in the file system, removed when dropped.
#[derive(Debug)]
pub(super) struct SocketFile {
    pub(super) path: PathBuf,
    /// Another server may have put its own there.
    is: Identity,
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        if identity(&self.path).is_ok_and(|found| found == self.is) {
            // Who starts next removes what is left.
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Device, number, and time of the last change: numbers of removed files are used again.
type Identity = (u64, u64, i64, i64);

fn identity(path: &Path) -> io::Result<Identity> {
    let found = fs::symlink_metadata(path)?;
    let (ctime_s, ctime_ns) = (found.ctime(), found.ctime_nsec());
    Ok((found.dev(), found.ino(), ctime_s, ctime_ns))
}

/// Listens at an address; port 0 is any free one.
///
/// # Errors
/// The address cannot be used.
pub(super) fn at_address(address: SocketAddr) -> anyhow::Result<(TcpListener, SocketAddr)> {
    let failed = || format!("cannot listen at {address}");
    let listener = TcpListener::bind(address).with_context(failed)?;
    listener.set_nonblocking(true).with_context(failed)?;
    let address = listener.local_addr().with_context(failed)?;
    Ok((listener, address))
}

/// Listens at a socket, in place of one that a server which is gone has left.
///
/// # Errors
/// Another server listens there, something else is there, or it cannot be made.
pub(super) fn at_socket(path: &Path) -> anyhow::Result<(UnixListener, SocketFile)> {
    let shown = path.display();
    let failed = || format!("cannot listen at {shown}");
    if let Ok(found) = fs::symlink_metadata(path) {
        if !found.file_type().is_socket() {
            bail!(
                "cannot listen at {shown}: there is something else than a socket; name another file"
            );
        }
        match UnixStream::connect(path) {
            Ok(_) => {
                bail!("cannot listen at {shown}: another server does; end it, or name another file")
            }
            // Nobody has it open.
            Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {}
            Err(error) => bail!(
                "cannot listen at {shown}: there is a socket that is not ours ({error}); name another file"
            ),
        }
        fs::remove_file(path).with_context(failed)?;
    }
    let listener = UnixListener::bind(path).with_context(failed)?;
    // Before, nobody else has the right to write, which connecting needs: no usual umask gives it.
    fs::set_permissions(path, fs::Permissions::from_mode(SOCKET_MODE)).with_context(failed)?;
    let file = SocketFile {
        path: path.to_owned(),
        is: identity(path).with_context(failed)?,
    };
    listener.set_nonblocking(true).with_context(failed)?;
    Ok((listener, file))
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixDatagram;

    use super::*;

    #[test]
    fn a_socket_replaces_one_that_was_left_and_nothing_else() -> anyhow::Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("fleet.sock");
        let (first, file) = at_socket(&path)?;
        let mode = fs::metadata(&path)?.permissions().mode() & 0o777;
        assert_eq!(mode, SOCKET_MODE);
        let refused = at_socket(&path).map(drop).unwrap_err().to_string();
        assert!(refused.contains("another server does"), "{refused}");
        drop(first);
        // Killed: the file is left.
        let (_second, second_file) = at_socket(&path)?;
        drop(file);
        assert!(path.exists(), "the file of another server");
        drop(second_file);
        assert!(!path.exists());
        fs::write(&path, "a file")?;
        let refused = at_socket(&path).map(drop).unwrap_err().to_string();
        assert!(refused.contains("something else"), "{refused}");
        assert_eq!(fs::read_to_string(&path)?, "a file");
        fs::remove_file(&path)?;
        let datagrams = UnixDatagram::bind(&path)?;
        let refused = at_socket(&path).map(drop).unwrap_err().to_string();
        assert!(refused.contains("not ours"), "{refused}");
        let sender = UnixDatagram::unbound()?;
        sender.send_to(b"still there", &path)?;
        drop(datagrams);
        Ok(())
    }
}
