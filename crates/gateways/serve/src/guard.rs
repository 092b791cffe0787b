//! A proxy in front of the Foxglove server. It checks the `Origin` of web pages, and limits the
//! duration of handshakes and the number of connections.
//!
//! The library's server accepts every `Origin`, waits for a handshake without a timeout (even while
//! it stops), and stops accepting after one failed `accept`. It therefore listens on a random
//! loopback address. The proxy forwards a connection once it has read and checked the request. A
//! web page cannot find the address among 2³⁸ combinations of address and port.

use std::collections::hash_map::RandomState;
use std::fmt;
use std::hash::{BuildHasher as _, Hasher as _};
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::net::{IpAddr, Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use joulebus_program::output::log_line;

/// Maximum duration of a handshake.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);
/// Maximum bytes of a request.
const MAX_REQUEST_BYTES: usize = 8 << 10;
/// Maximum number of connections, including those in their handshake.
const MAX_CONNECTIONS: usize = 64;
/// A client that has accepted no bytes for this time is disconnected.
const WRITE_TIMEOUT: Duration = Duration::from_secs(10);
/// Interval of checks for connections and for the stop flag.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// The origin of Foxglove's web application.
const FOXGLOVE: &str = "https://app.foxglove.dev";

/// Accepts connections. Ends with [`Guard::stop`], or when dropped.
pub(crate) struct Guard {
    shared: Arc<Shared>,
    accept: Option<thread::JoinHandle<()>>,
}

struct Shared {
    /// Address of the library's server.
    server: SocketAddr,
    origins: Vec<String>,
    connections: AtomicUsize,
    stop: AtomicBool,
}

/// Reason that a connection is refused.
#[derive(Debug, PartialEq, Eq)]
enum Refusal {
    /// The request is not HTTP.
    Malformed,
    /// The origin of the web page is not accepted.
    Origin(String),
    /// The request was not complete in time.
    Late,
    TooLong,
    TooMany,
}

impl Refusal {
    const fn status(&self) -> &'static str {
        match self {
            Self::Malformed => "400 Bad Request",
            Self::Origin(_) => "403 Forbidden",
            Self::Late => "408 Request Timeout",
            Self::TooLong => "431 Request Header Fields Too Large",
            Self::TooMany => "503 Service Unavailable",
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Malformed => write!(out, "the request is no WebSocket handshake"),
            Self::Origin(origin) => {
                write!(out, "a page of {origin} wants to connect: allow it with --allow-origin")
            }
            Self::Late => write!(out, "no whole request within {} s", HANDSHAKE_TIMEOUT.as_secs()),
            Self::TooLong => write!(out, "a request of more than {MAX_REQUEST_BYTES} bytes"),
            Self::TooMany => write!(out, "more than {MAX_CONNECTIONS} connections"),
        }
    }
}

/// A loopback address that cannot be guessed.
pub(crate) fn hidden_address() -> IpAddr {
    // The keys of a new hash map's state are random.
    let [_, a, b, c, ..] = RandomState::new().build_hasher().finish().to_be_bytes();
    // 0 and 255 are network and broadcast addresses.
    let [a, b, c] = [a, b, c].map(|byte| byte.clamp(1, 254));
    Ipv4Addr::new(127, a, b, c).into()
}

impl Guard {
    /// Forwards connections on `listener` to `server`: those of programs, of pages of this host and
    /// of Foxglove, and of pages of `origins`.
    pub(crate) fn start(
        listener: TcpListener,
        server: SocketAddr,
        origins: Vec<String>,
    ) -> io::Result<Self> {
        listener.set_nonblocking(true)?;
        let shared = Arc::new(Shared {
            server,
            origins,
            connections: AtomicUsize::new(0),
            stop: AtomicBool::new(false),
        });
        let inside = Arc::clone(&shared);
        let accept = thread::Builder::new()
            .name("joulebus-accept".to_owned())
            .spawn(move || inside.accept(&listener))?;
        Ok(Self { shared, accept: Some(accept) })
    }

    /// Stops accepting. Existing connections stay open.
    pub(crate) fn stop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(accept) = self.accept.take() {
            // A panic has been reported already.
            let _ = accept.join();
        }
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        self.stop();
    }
}

/// Counts a connection for its lifetime.
struct CountedConnection(Arc<Shared>);

impl Drop for CountedConnection {
    fn drop(&mut self) {
        self.0.connections.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Shared {
    fn accept(self: Arc<Self>, listener: &TcpListener) {
        while !self.stop.load(Ordering::Relaxed) {
            match listener.accept() {
                Ok((client, _)) => self.take(client),
                // No connection, or no free descriptor, which is transient.
                Err(_) => thread::sleep(POLL_INTERVAL),
            }
        }
    }

    fn take(self: &Arc<Self>, mut client: TcpStream) {
        let counted = CountedConnection(Arc::clone(self));
        if self.connections.fetch_add(1, Ordering::Relaxed) >= MAX_CONNECTIONS {
            return refuse(&mut client, &Refusal::TooMany);
        }
        let started = thread::Builder::new().name("joulebus-client".to_owned()).spawn(move || {
            let counted = counted;
            counted.0.serve(client);
        });
        if let Err(error) = started {
            tracing::warn!(%error, "a connection was not taken");
        }
    }

    fn serve(&self, mut client: TcpStream) {
        // The client notices a failed connection.
        let _ = match self.request(&mut client) {
            Ok(Ok(request)) => self.join(&client, &request),
            Ok(Err(refusal)) => {
                refuse(&mut client, &refusal);
                Ok(())
            }
            Err(error) => Err(error),
        };
    }

    /// Reads the request, including bytes that follow it.
    fn request(&self, client: &mut TcpStream) -> io::Result<Result<Vec<u8>, Refusal>> {
        client.set_nonblocking(false)?;
        client.set_nodelay(true)?;
        client.set_write_timeout(Some(WRITE_TIMEOUT))?;
        client.set_read_timeout(Some(POLL_INTERVAL))?;
        let end = Instant::now() + HANDSHAKE_TIMEOUT;
        let mut request = Vec::new();
        let mut buffer = [0; 2048];
        loop {
            if let Some(length) = end_of(&request) {
                let checked = check(&request[..length], &self.origins);
                return Ok(checked.map(|()| request));
            }
            if request.len() > MAX_REQUEST_BYTES {
                return Ok(Err(Refusal::TooLong));
            }
            if Instant::now() >= end || self.stop.load(Ordering::Relaxed) {
                return Ok(Err(Refusal::Late));
            }
            match client.read(&mut buffer) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(read) => request.extend_from_slice(&buffer[..read]),
                Err(error) if is_nothing(&error) => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Forwards bytes in both directions until one side ends.
    fn join(&self, client: &TcpStream, request: &[u8]) -> io::Result<()> {
        let mut server = TcpStream::connect(self.server)?;
        server.set_nodelay(true)?;
        server.write_all(request)?;
        client.set_read_timeout(None)?;
        thread::scope(|scope| {
            scope.spawn(|| pass_on(client, &server));
            pass_on(&server, client);
        });
        Ok(())
    }
}

/// Forwards until `from` ends or `to` accepts no more, then closes both.
fn pass_on(mut from: &TcpStream, mut to: &TcpStream) {
    // An error ends the connection as well.
    let _ = io::copy(&mut from, &mut to);
    for stream in [from, to] {
        let _ = stream.shutdown(Shutdown::Both);
    }
}

fn refuse(client: &mut TcpStream, refusal: &Refusal) {
    if let Refusal::Origin(_) = refusal {
        log_line(&refusal.to_string());
    } else {
        tracing::info!("refused: {refusal}");
    }
    let (status, body) = (refusal.status(), format!("{refusal}\n"));
    let length = body.len();
    // The client may have disconnected.
    let _ = write!(
        client,
        "HTTP/1.1 {status}\r\nConnection: close\r\nContent-Type: text/plain; charset=utf-8\r\n\
         Content-Length: {length}\r\n\r\n{body}"
    );
}

fn is_nothing(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}

/// Length of the request, if it is complete.
fn end_of(request: &[u8]) -> Option<usize> {
    const END: &[u8] = b"\r\n\r\n";
    let at = request.windows(END.len()).position(|four| four == END)?;
    Some(at + END.len())
}

/// Accepts a request of a program, or of a page that may connect.
fn check(request: &[u8], origins: &[String]) -> Result<(), Refusal> {
    let request = std::str::from_utf8(request).map_err(|_| Refusal::Malformed)?;
    let mut lines = request.split_terminator("\r\n");
    if !lines.next().is_some_and(|line| line.starts_with("GET ")) {
        return Err(Refusal::Malformed);
    }
    for line in lines.take_while(|line| !line.is_empty()) {
        // Other parsers accept bare line feeds and continued lines, and would find other headers.
        let (name, value) = line.split_once(':').ok_or(Refusal::Malformed)?;
        let is_plain = |byte: u8| byte.is_ascii_graphic();
        if name.is_empty() || !name.bytes().all(is_plain) || value.contains(['\r', '\n']) {
            return Err(Refusal::Malformed);
        }
        let origin = value.trim();
        if name.eq_ignore_ascii_case("origin") && !may_connect(origin, origins) {
            return Err(Refusal::Origin(origin.to_owned()));
        }
    }
    Ok(())
}

fn may_connect(origin: &str, origins: &[String]) -> bool {
    is_of_this_host(origin) || origin == FOXGLOVE || origins.iter().any(|allowed| allowed == origin)
}

/// True if a page comes from a server on this host.
fn is_of_this_host(origin: &str) -> bool {
    let host = ["http://", "https://"].iter().find_map(|scheme| origin.strip_prefix(scheme));
    let rest = host.and_then(|host| {
        let names = ["localhost", "127.0.0.1", "[::1]"];
        names.iter().find_map(|name| host.strip_prefix(name))
    });
    rest.is_some_and(|rest| {
        let port = rest.strip_prefix(':');
        rest.is_empty() || port.is_some_and(|port| port.parse::<u16>().is_ok())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checked(headers: &str) -> Result<(), Refusal> {
        let request = format!("GET / HTTP/1.1\r\nHost: 127.0.0.1:8765\r\n{headers}\r\n");
        assert_eq!(end_of(request.as_bytes()), Some(request.len()));
        check(request.as_bytes(), &["https://lab.example".to_owned()])
    }

    #[test]
    fn programs_and_pages_of_this_host_and_of_foxglove_may_connect() {
        for headers in [
            "",
            "Origin: http://localhost\r\n",
            "Origin: http://localhost:8080\r\n",
            "origin:https://127.0.0.1:1\r\n",
            "ORIGIN: http://[::1]:65535 \r\n",
            "Origin: https://app.foxglove.dev\r\n",
            "Origin: https://lab.example\r\n",
        ] {
            assert_eq!(checked(headers), Ok(()), "{headers}");
        }
    }

    #[test]
    fn pages_of_other_origins_may_not_connect() {
        for origin in [
            "null",
            "file://",
            "",
            "http://evil.example",
            "http://localhost.evil.example",
            "http://localhost:80.evil.example",
            "http://localhost:",
            "http://localhost:70000",
            "http://localhost@evil.example",
            "http://127.0.0.1.evil.example",
            "https://app.foxglove.dev.evil.example",
            "https://app.foxglove.dev:8443",
            "http://app.foxglove.dev",
            "https://lab.example:8080",
            "http://lab.example",
            "localhost",
        ] {
            let refused = checked(&format!("Origin: {origin}\r\n"));
            assert_eq!(refused, Err(Refusal::Origin(origin.to_owned())), "{origin}");
            // Nor together with an accepted origin.
            for headers in [
                format!("Origin: http://localhost\r\nOrigin: {origin}\r\n"),
                format!("Origin: {origin}\r\nOrigin: http://localhost\r\n"),
            ] {
                assert!(checked(&headers).is_err(), "{headers}");
            }
        }
    }

    #[test]
    fn ambiguous_requests_are_refused() {
        for request in [
            "POST / HTTP/1.1\r\n\r\n",
            "GET / HTTP/1.1\r\nOrigin : http://evil.example\r\n\r\n",
            "GET / HTTP/1.1\r\nHost: a\nOrigin: http://evil.example\r\n\r\n",
            "GET / HTTP/1.1\r\nHost: a\r\n Origin: http://evil.example\r\n\r\n",
            "GET / HTTP/1.1\r\nno header\r\n\r\n",
        ] {
            let refused = check(request.as_bytes(), &[]);
            assert_eq!(refused, Err(Refusal::Malformed), "{request}");
        }
        assert_eq!(check(b"GET /\xff\r\n\r\n", &[]), Err(Refusal::Malformed));
    }

    #[test]
    fn hidden_addresses_are_loopback_and_differ() {
        let addresses: Vec<IpAddr> = (0..50).map(|_| hidden_address()).collect();
        assert!(addresses.iter().all(IpAddr::is_loopback), "{addresses:?}");
        let mut distinct = addresses.clone();
        distinct.sort_unstable();
        distinct.dedup();
        assert!(distinct.len() > 45, "{addresses:?}");
    }
}
