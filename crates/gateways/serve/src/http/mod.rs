//! `joulebus serve --http`: a page, an API and metrics of a fleet.
//!
//! One thread reads shared memory ([`reader`]), another serves all clients ([`connections`],
//! [`api`]). The reading thread replaces one shared snapshot ten times a second and never waits for
//! a client. A message is made of the newest snapshot when a client can take it, so nothing is
//! queued for slow clients.

mod access;
mod acknowledge;
mod alarms;
mod api;
mod battery;
mod capacity;
mod connections;
mod entry;
mod error;
mod fleet;
mod history;
mod listen;
mod metrics;
mod outlooks;
mod page;
mod plan_rows;
mod questions;
mod reader;
mod shares;
mod snapshot;
mod stream;
mod totals;
mod view;
mod what_if;

use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use anyhow::Context as _;
use axum::Router;
use axum::body::{Body, HttpBody as _};
use axum::http::{HeaderValue, Request, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use joulebus_bus::{nodes, yield_to_the_worker};
use joulebus_capture_recorder::RECORDER;
use joulebus_config::Config;
use joulebus_program::exit::UsageError;
use joulebus_program::output::log_line;
use serde::Serialize;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::{Notify, watch};

use access::{Access, Token, cookie_name, is_of_health};
use api::App;
use connections::{Busy, Connection, Marked, Slot, Watched};
use error::ApiError;
use fleet::Recorder;
use listen::{Listeners, Peer, SocketFile};
use reader::Reader;
use shares::Share;

/// Timeout of a request's head, and of the pause before the next request on a connection.
const HEAD_TIMEOUT: Duration = Duration::from_secs(5);
/// Largest head of a request, bytes, and most of its fields.
const MAX_HEAD_BYTES: usize = 16 << 10;
const MAX_HEADERS: usize = 64;
/// Bytes that the system keeps for a client that does not take them.
const SEND_BUFFER_BYTES: usize = 64 << 10;
/// Maximum number of unsent bytes of a connection. Beyond it no further message is made.
const MAX_KEPT_BYTES: usize = 64 << 10;
/// Answers of up to this length do not count among the unsent bytes of a client.
const MAX_SMALL_BYTES: usize = 4 << 10;
/// Nice value of the thread that answers clients, and of those that compute for them.
const NICE: u8 = 10;
/// Interval of looking for recorders.
const INSPECT_EVERY: Duration = Duration::from_secs(5);
/// After a failed `accept`: no free descriptor, which passes.
const RETRY_ACCEPT: Duration = Duration::from_millis(50);

/// Options of the server.
#[derive(Debug, Clone)]
pub(crate) struct Options {
    /// At least one of address and socket is set.
    pub(crate) address: Option<SocketAddr>,
    pub(crate) socket: Option<PathBuf>,
    pub(crate) token_file: Option<PathBuf>,
    pub(crate) allow_host: Vec<String>,
    pub(crate) metrics_robots: usize,
}

/// The report of a server that has ended.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct HttpReport {
    /// Null without an address.
    pub(crate) address: Option<String>,
    /// Null without a socket.
    pub(crate) socket: Option<PathBuf>,
    /// Requests answered, refused ones included.
    pub(crate) requests: u64,
    /// Requests refused for their host or token, or without a connection for them.
    pub(crate) refused: u64,
    /// Messages sent on streams.
    pub(crate) messages: u64,
}

pub(crate) struct HttpServer {
    address: Option<SocketAddr>,
    socket: Option<SocketFile>,
    reader: Reader,
    shared: Arc<Shared>,
    web: Option<JoinHandle<()>>,
}

/// State shared by all connections.
struct Shared {
    app: Arc<App>,
    router: Router,
    access: Access,
    requests: AtomicU64,
    refused: AtomicU64,
    end: Notify,
}

impl HttpServer {
    /// Joins the fleet and serves it.
    ///
    /// # Errors
    /// The address is open to other hosts without a token, the token file cannot be used, the fleet
    /// cannot be joined, or the address cannot be listened on.
    pub(crate) fn start(config: &Config, options: &Options) -> anyhow::Result<Self> {
        let token = options.token_file.as_deref().map(Token::read).transpose();
        let token = token.map_err(|error| UsageError(error.to_string()))?;
        let is_open = |address: &SocketAddr| token.is_none() && !address.ip().is_loopback();
        if let Some(address) = options.address.filter(is_open) {
            let text = format!(
                "{address} can be reached from other hosts: give --token-file FILE (mode 0600), or serve at \
                 127.0.0.1 behind a proxy with TLS (docs/how-to/open-the-page.md)"
            );
            return Err(UsageError(text).into());
        }
        let (tcp, address) = options.address.map(listen::at_address).transpose()?.unzip();
        let socket = options.socket.as_deref().map(listen::at_socket);
        let (unix, socket) = socket.transpose()?.unzip();
        let listeners = Listeners { tcp, unix };
        let reader = Reader::start(config)?;
        let app = Arc::new(App::new(
            config.clone(),
            reader.snapshots.clone(),
            reader.asks.clone(),
            options.metrics_robots,
        ));
        let shared = Arc::new(Shared {
            router: api::router(Arc::clone(&app)),
            app,
            access: Access {
                token,
                cookie: cookie_name(config.fleet()),
                hosts: options.allow_host.clone(),
            },
            requests: AtomicU64::new(0),
            refused: AtomicU64::new(0),
            end: Notify::new(),
        });
        let inside = Arc::clone(&shared);
        let (config, recorders) = (config.clone(), reader.recorders.clone());
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .thread_name("joulebus-compute")
            // A question about a plan, a statement of a person, a capacity, and meanwhile the recorders.
            .max_blocking_threads(4)
            .build()
            .context("cannot start the server's runtime")?;
        let web = thread::Builder::new().name("joulebus-http".to_owned()).spawn(move || {
            yield_to_the_worker(NICE);
            runtime.block_on(async {
                tokio::select! {
                    () = accept_all(listeners, &inside) => {}
                    () = look_for_recorders(config, recorders) => {}
                    () = inside.end.notified() => {}
                }
            });
            // A question being computed is not waited for.
            runtime.shutdown_background();
        });
        Ok(Self {
            address,
            socket,
            reader,
            shared,
            web: Some(web.context("cannot start a thread")?),
        })
    }

    /// The addresses that it listens on, for display.
    pub(crate) fn places(&self) -> Vec<String> {
        let address = self.address.map(|address| format!("http://{address}"));
        let socket = self.socket.as_ref();
        let socket = socket.map(|socket| socket.path.display().to_string());
        address.into_iter().chain(socket).collect()
    }

    /// True if it has ended by itself. [`HttpServer::finish`] returns the reason.
    pub(crate) fn is_over(&self) -> bool {
        self.reader.is_over() || self.web.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Closes all connections and leaves the fleet.
    pub(crate) fn finish(mut self) -> anyhow::Result<HttpReport> {
        // While it still listens: afterwards the next server may have its own there.
        let socket = self.socket.take().map(|socket| socket.path.clone());
        self.shared.end.notify_one();
        let web = self.web.take().map_or(Ok(()), JoinHandle::join);
        self.reader.finish()?;
        web.map_err(|_| anyhow::anyhow!("the server's thread panicked"))?;
        Ok(HttpReport {
            address: self.address.map(|address| format!("http://{address}")),
            socket,
            requests: self.shared.requests.load(Ordering::Relaxed),
            refused: self.shared.refused.load(Ordering::Relaxed),
            messages: self.shared.app.messages.load(Ordering::Relaxed),
        })
    }
}

/// Accepts connections for ever, at one place or two.
async fn accept_all(listeners: Listeners, shared: &Arc<Shared>) {
    let cannot = |error: io::Error| log_line(&format!("error: the server cannot listen: {error}"));
    let tcp = listeners.tcp.map(tokio::net::TcpListener::from_std);
    let unix = listeners.unix.map(tokio::net::UnixListener::from_std);
    let (tcp, unix) = match (tcp.transpose(), unix.transpose()) {
        (Ok(tcp), Ok(unix)) => (tcp, unix),
        (Err(error), _) | (_, Err(error)) => return cannot(error),
    };
    let at_address = async {
        let Some(listener) = tcp else {
            return std::future::pending().await;
        };
        accept(shared, || accept_at_address(&listener)).await;
    };
    let at_socket = async {
        let Some(listener) = unix else {
            return std::future::pending().await;
        };
        accept(shared, || accept_at_socket(&listener)).await;
    };
    tokio::join!(at_address, at_socket);
}

async fn accept_at_address(
    listener: &tokio::net::TcpListener,
) -> io::Result<(tokio::net::TcpStream, Peer)> {
    let (stream, peer) = listener.accept().await?;
    // This limits unsent bytes and their delay. The connection also works without.
    let _ = stream.set_nodelay(true);
    let _ = rustix::net::sockopt::set_socket_send_buffer_size(&stream, SEND_BUFFER_BYTES);
    Ok((stream, Peer::Address(peer.ip().to_canonical())))
}

async fn accept_at_socket(
    listener: &tokio::net::UnixListener,
) -> io::Result<(tokio::net::UnixStream, Peer)> {
    let (stream, _) = listener.accept().await?;
    let _ = rustix::net::sockopt::set_socket_send_buffer_size(&stream, SEND_BUFFER_BYTES);
    let user = stream.peer_cred()?.uid();
    Ok((stream, Peer::User(user)))
}

/// Accepts connections for ever.
async fn accept<S, F>(shared: &Arc<Shared>, next: impl Fn() -> F)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    F: Future<Output = io::Result<(S, Peer)>>,
{
    loop {
        match next().await {
            Ok((stream, peer)) => {
                let slot = shared.app.connections.enter(peer.network());
                drop(tokio::spawn(serve(stream, peer, slot, Arc::clone(shared))));
            }
            Err(error) => {
                tracing::warn!(%error, "a connection was not accepted");
                tokio::time::sleep(RETRY_ACCEPT).await;
            }
        }
    }
}

/// Serves a connection until it ends or has to close.
async fn serve<S>(stream: S, peer: Peer, slot: Slot, shared: Arc<Shared>)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let connection = Arc::clone(&slot.connection);
    let respond = service_fn(|request| {
        let (shared, connection) = (Arc::clone(&shared), Arc::clone(&connection));
        async move { Ok::<_, Infallible>(respond(request, peer, &shared, &connection).await) }
    });
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_TIMEOUT)
        .max_header_size(MAX_HEAD_BYTES)
        .max_headers(MAX_HEADERS)
        .max_buf_size(MAX_KEPT_BYTES)
        .serve_connection(TokioIo::new(Watched::new(stream)), respond);
    tokio::select! {
        result = served => {
            if let Err(error) = result {
                tracing::debug!(%error, "a connection ended");
            }
        }
        () = slot.connection.closed() => {}
    }
}

async fn respond(
    mut request: Request<Incoming>,
    peer: Peer,
    shared: &Arc<Shared>,
    connection: &Arc<Connection>,
) -> Response {
    let busy = Busy::new(connection);
    shared.requests.fetch_add(1, Ordering::Relaxed);
    let is_page = request.uri().path() == "/";
    let peer = peer.network();
    let checked = match connection.is_reserved && !is_of_health(request.uri()) {
        true => Err(ApiError::busy("all connections are taken: try again")),
        false => shared.admit(&request, peer),
    };
    let closes = connection.is_reserved;
    let mut response = match checked {
        Err(refusal) => {
            shared.refused.fetch_add(1, Ordering::Relaxed);
            if is_page && refusal.status == StatusCode::UNAUTHORIZED {
                page::closed()
            } else {
                refusal.into_response()
            }
        }
        Ok(Some(entered)) => entered,
        Ok(None) => {
            request.extensions_mut().insert(peer);
            request.extensions_mut().insert(Arc::clone(connection));
            let router = TowerToHyperService::new(shared.router.clone());
            match router.call(request.map(Body::new)).await {
                Ok(response) => response,
                Err(never) => match never {},
            }
        }
    };
    let bytes = response.body().size_hint().exact().unwrap_or(0) as usize;
    let share =
        (bytes > MAX_SMALL_BYTES).then(|| shared.app.shares.unsent.take(peer, bytes)).transpose();
    let share = share.unwrap_or_else(|refused| {
        response = refused.into_response();
        None
    });
    if closes {
        // The next request may find a slot where all is answered.
        let close = HeaderValue::from_static("close");
        response.headers_mut().insert(header::CONNECTION, close);
    }
    finish(response, busy, share)
}

impl Shared {
    /// Checks a request before it is handled. A token in the URL is answered with a cookie and a
    /// redirect to the page.
    fn admit(&self, request: &Request<Incoming>, peer: Peer) -> Result<Option<Response>, ApiError> {
        let (uri, headers) = (request.uri(), request.headers());
        // The socket's directory, group and mode replace the token.
        if matches!(peer, Peer::User(_)) {
            return self.access.check_site(uri, headers).map(|()| None);
        }
        let Some(token) = self.access.token_of(uri) else {
            return self.access.check(uri, headers).map(|()| None);
        };
        self.access.check_host(uri, headers)?;
        let name = &self.access.cookie;
        let cookie = format!("{name}={token}; HttpOnly; SameSite=Strict; Path=/");
        let headers = [(header::LOCATION, "/"), (header::SET_COOKIE, cookie.as_str())];
        Ok(Some((StatusCode::SEE_OTHER, headers).into_response()))
    }
}

/// Adds the headers of every response, and marks the connection busy until the body has been sent.
fn finish(response: Response, busy: Busy, share: Option<Share>) -> Response {
    let (mut parts, body) = response.into_parts();
    for (name, value) in [
        (
            header::CONTENT_SECURITY_POLICY,
            "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        ),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
    ] {
        parts.headers.insert(name, HeaderValue::from_static(value));
    }
    let cache = parts.headers.entry(header::CACHE_CONTROL);
    cache.or_insert(HeaderValue::from_static("no-store"));
    let body = Marked::new(body, busy, share);
    Response::from_parts(parts, Body::new(body))
}

/// Looks for processes that record, for ever.
async fn look_for_recorders(config: Config, found: watch::Sender<Option<Vec<Recorder>>>) {
    loop {
        let config = config.clone();
        let looked = tokio::task::spawn_blocking(move || recorders(&config));
        found.send_replace(looked.await.ok().flatten());
        tokio::time::sleep(INSPECT_EVERY).await;
    }
}

/// The processes that record now. `None` if that cannot be determined.
fn recorders(config: &Config) -> Option<Vec<Recorder>> {
    let nodes = nodes(&config.domain().ok()?).ok()?;
    let recorders =
        nodes.into_iter().filter(|node| node.alive != Some(false) && node.name == RECORDER);
    let recorders = recorders.map(|node| Recorder { name: node.name, pid: node.pid });
    Some(recorders.collect())
}
