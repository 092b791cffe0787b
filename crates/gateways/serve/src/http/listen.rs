//! The listening sockets: an address, a Unix socket, or both.

use std::fs::{self, File, TryLockError};
use std::io::{self, Read, Write as _};
use std::net::{IpAddr, Ipv6Addr, SocketAddr, TcpListener};
use std::os::fd::OwnedFd;
use std::os::unix::fs::{
    FileTypeExt as _, MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _,
};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use rustix::fs::OFlags;
use rustix::net;
use rustix::process::geteuid;

/// Mode of a socket: whoever may enter its folder and is in its group may connect.
const SOCKET_MODE: u32 = 0o660;
/// Connections that wait to be accepted.
const WAITING: i32 = 128;
/// Contents of the lock file. They distinguish it from other files of that name.
const MARKER: &[u8] = b"the lock of a socket of joulebus\n";
/// Reason that a path cannot be had.
const ANOTHER: &str = "another server does. End it, or name another file";

/// The client of a request, as far as it is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Peer {
    /// A client of the network.
    Address(IpAddr),
    /// A user of this host, by the Unix socket.
    User(u32),
}

impl Peer {
    /// As which it has a share: a host has all addresses of an IPv6 network of 64 bits.
    pub(super) fn network(self) -> Self {
        match self {
            Self::Address(IpAddr::V6(address)) => {
                Self::Address(Ipv6Addr::from_bits(address.to_bits() >> 64 << 64).into())
            }
            peer => peer,
        }
    }
}

/// The open listening sockets.
#[derive(Debug)]
pub(super) struct Listeners {
    pub(super) tcp: Option<TcpListener>,
    pub(super) unix: Option<UnixListener>,
}

/// A socket in the file system, removed when dropped.
#[derive(Debug)]
pub(super) struct SocketFile {
    pub(super) path: PathBuf,
    /// Identity of the socket's file, because another process may have replaced it.
    is: Identity,
    /// Given up after the socket is removed.
    _lock: SocketLock,
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        if identity(&self.path).is_ok_and(|found| found == self.is) {
            // A socket that cannot be removed now is removed by the next server.
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

/// Listens on an address. Port 0 takes any free port.
pub(super) fn at_address(address: SocketAddr) -> anyhow::Result<(TcpListener, SocketAddr)> {
    let failed = || format!("cannot listen at {address}");
    let listener = TcpListener::bind(address).with_context(failed)?;
    listener.set_nonblocking(true).with_context(failed)?;
    let address = listener.local_addr().with_context(failed)?;
    Ok((listener, address))
}

/// Listens on a Unix socket. Replaces the socket of a server that has died.
///
/// # Errors
/// Another server listens there or is starting, the path has another file, or the socket cannot be
/// made.
pub(super) fn at_socket(path: &Path) -> anyhow::Result<(UnixListener, SocketFile)> {
    let failed = || format!("cannot listen at {}", path.display());
    let lock = SocketLock::take(path)?;
    remove_stale(path)?;
    let socket = bind(path).with_context(failed)?;
    let file =
        SocketFile { path: path.to_owned(), is: identity(path).with_context(failed)?, _lock: lock };
    net::listen(&socket, WAITING).with_context(failed)?;
    let listener = UnixListener::from(socket);
    listener.set_nonblocking(true).with_context(failed)?;
    Ok((listener, file))
}

/// Binds a socket with its mode, without listening. Connections are refused until it listens, so a
/// generous umask admits nobody.
fn bind(path: &Path) -> io::Result<OwnedFd> {
    let address = net::SocketAddrUnix::new(path)?;
    let (family, kind) = (net::AddressFamily::UNIX, net::SocketType::STREAM);
    let socket = net::socket_with(family, kind, net::SocketFlags::CLOEXEC, None)?;
    net::bind(&socket, &address)?;
    fs::set_permissions(path, fs::Permissions::from_mode(SOCKET_MODE))?;
    Ok(socket)
}

/// Removes a socket that no process has open. The caller holds the lock, so no other server can put
/// one there.
fn remove_stale(path: &Path) -> anyhow::Result<()> {
    let Ok(found) = fs::symlink_metadata(path) else {
        return Ok(());
    };
    let shown = path.display();
    if !found.file_type().is_socket() {
        bail!("cannot listen at {shown}: there is something else than a socket. Name another file");
    }
    match UnixStream::connect(path) {
        Ok(_) => bail!("cannot listen at {shown}: {ANOTHER}"),
        Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {}
        Err(error) => bail!(
            "cannot listen at {shown}: there is a socket that is not ours ({error}). Name another \
             file"
        ),
    }
    fs::remove_file(path).with_context(|| format!("cannot listen at {shown}"))
}

/// The exclusive right to a socket's path: a lock on the file `PATH.lock`. The system releases it
/// when a server is killed.
#[derive(Debug)]
struct SocketLock {
    path: PathBuf,
    _file: File,
}

impl SocketLock {
    fn take(socket: &Path) -> anyhow::Result<Self> {
        let mut name = socket.as_os_str().to_owned();
        name.push(".lock");
        let path = PathBuf::from(name);
        let failed = || format!("cannot lock {}", path.display());
        let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
        let mut options = File::options();
        options.read(true).write(true).create(true);
        options.truncate(false).mode(0o600);
        options.custom_flags(flags.bits().cast_signed());
        loop {
            let mut file = options.open(&path).with_context(failed)?;
            match file.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => {
                    bail!("cannot listen at {}: {ANOTHER}", socket.display())
                }
                Err(TryLockError::Error(error)) => return Err(error).with_context(failed),
            }
            // Whoever had it may have removed it before it was locked here.
            let own = file.metadata().with_context(failed)?;
            let is_there = fs::symlink_metadata(&path)
                .is_ok_and(|found| (found.dev(), found.ino()) == (own.dev(), own.ino()));
            if !is_there {
                continue;
            }
            if !mark(&mut file).with_context(failed)? {
                bail!(
                    "cannot lock {}: there is something else than our lock. Move it away, or name \
                     another socket",
                    path.display()
                );
            }
            return Ok(Self { path, _file: file });
        }
    }
}

/// Writes the marker into a new lock file. Returns false for a file of another program, and leaves
/// it unchanged.
fn mark(file: &mut File) -> io::Result<bool> {
    let about = file.metadata()?;
    if !about.is_file() || about.nlink() != 1 || about.uid() != geteuid().as_raw() {
        return Ok(false);
    }
    let mut found = Vec::new();
    let most = MARKER.len() as u64 + 1;
    Read::by_ref(file).take(most).read_to_end(&mut found)?;
    // A server that was killed while it wrote has left a part of the marker.
    if found != MARKER && MARKER.starts_with(&found) {
        file.write_all(&MARKER[found.len()..])?;
        return Ok(true);
    }
    Ok(found == MARKER)
}

impl Drop for SocketLock {
    fn drop(&mut self) {
        // Remove it while it is locked. A file that stays does no harm.
        let _ = fs::remove_file(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixDatagram;
    use std::sync::Barrier;

    use super::*;

    #[test]
    fn a_socket_replaces_one_that_was_left_and_nothing_else() -> anyhow::Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("fleet.sock");
        // Killed: its files are left.
        drop(UnixListener::bind(&path)?);
        fs::write(folder.path().join("fleet.sock.lock"), "")?;
        let (first, file) = at_socket(&path)?;
        let refused = at_socket(&path).map(drop).unwrap_err().to_string();
        assert!(refused.contains("another server does"), "{refused}");
        drop(first);
        // A socket of another program, which does not use our lock.
        fs::remove_file(&path)?;
        let other = UnixListener::bind(&path)?;
        drop(file);
        assert!(path.exists(), "the file of another server");
        let refused = at_socket(&path).map(drop).unwrap_err().to_string();
        assert!(refused.contains("another server does"), "{refused}");
        drop(other);
        drop(at_socket(&path)?);
        assert_eq!(fs::read_dir(folder.path())?.count(), 0);
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

    #[test]
    fn a_file_in_the_place_of_the_lock_that_is_not_ours_is_left_as_it_is() -> anyhow::Result<()> {
        let folder = tempfile::tempdir()?;
        let (path, lock) = (folder.path().join("Cargo"), folder.path().join("Cargo.lock"));
        let longer = [MARKER, b"and more"].concat();
        let other = folder.path().join("other");
        for text in [&b"version = 4"[..], b"\0\0", &longer] {
            fs::write(&lock, text)?;
            let refused = at_socket(&path).map(drop).unwrap_err().to_string();
            assert!(refused.contains("something else"), "{refused}");
            assert_eq!(fs::read(&lock)?, text);
            // A hard link to another program's file, and a symbolic link to it.
            fs::rename(&lock, &other)?;
            fs::hard_link(&other, &lock)?;
            assert!(at_socket(&path).is_err());
            fs::remove_file(&lock)?;
            std::os::unix::fs::symlink(&other, &lock)?;
            assert!(at_socket(&path).is_err());
            assert_eq!(fs::read(&other)?, text);
            fs::remove_file(&lock)?;
            assert!(!path.exists());
        }
        // Files that killed servers have left.
        for text in [&b""[..], &MARKER[..7], MARKER] {
            fs::write(&lock, text)?;
            drop(at_socket(&path)?);
            assert!(!lock.exists());
        }
        Ok(())
    }

    #[test]
    fn nobody_can_connect_before_the_socket_has_its_mode() -> anyhow::Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("fleet.sock");
        let socket = bind(&path)?;
        let mode = fs::metadata(&path)?.permissions().mode() & 0o777;
        assert_eq!(mode, SOCKET_MODE);
        let refused = UnixStream::connect(&path).unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::ConnectionRefused);
        net::listen(&socket, WAITING)?;
        UnixStream::connect(&path)?;
        Ok(())
    }

    #[test]
    fn of_servers_that_start_at_once_one_has_the_path() -> anyhow::Result<()> {
        const SERVERS: usize = 6;
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("fleet.sock");
        for _ in 0..50 {
            // A killed server's socket, which all threads find.
            drop(UnixListener::bind(&path)?);
            let (begin, end) = (Barrier::new(SERVERS), Barrier::new(SERVERS));
            let start = || {
                begin.wait();
                let started = at_socket(&path);
                end.wait();
                match started {
                    Ok((listener, _file)) => {
                        UnixStream::connect(&path).expect("its socket is at the path");
                        listener.accept().expect("it takes the connection");
                        None
                    }
                    Err(refused) => Some(refused.to_string()),
                }
            };
            let refused: Vec<String> = std::thread::scope(|scope| {
                let servers: Vec<_> = (0..SERVERS).map(|_| scope.spawn(start)).collect();
                let ended = servers.into_iter().map(|server| server.join().unwrap());
                ended.flatten().collect()
            });
            assert_eq!(refused.len(), SERVERS - 1, "{refused:?}");
            assert!(refused.iter().all(|why| why.contains(ANOTHER)), "{refused:?}");
            assert_eq!(fs::read_dir(folder.path())?.count(), 0);
        }
        Ok(())
    }
}
