//! Serves the channels of a capture over the Foxglove WebSocket protocol.
//!
//! A recorder writes its capture into a pipe, and this server sends the messages that it reads from
//! the pipe to its clients. Live and recorded data are therefore the same by construction. A slow
//! client loses messages, without effect on the fleet.

use std::collections::HashMap;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::channel;
use std::thread::JoinHandle;
use std::time::Duration;

use crate::arguments::ServeArguments;
use ::foxglove::websocket::ShutdownHandle;
use ::foxglove::{
    ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, WebSocketServer,
    WebSocketServerHandle,
};
use anyhow::Context as _;
use joulebus_capture_format::{CaptureSettings, Entry, Preset, ReadError, Reader};
use joulebus_capture_recorder::{Options, Recorder, Target, attach, host_clock};
use joulebus_config::Config;
use joulebus_program::output::log_line;
use serde::Serialize;

use crate::guard::{Guard, hidden_address};

/// Timeout for clients to disconnect at the end.
const DISCONNECT_TIMEOUT: Duration = Duration::from_secs(1);
/// Bytes of messages queued for a slow reader.
const QUEUE_BYTES: usize = 64 << 20;

/// The report of a server that has ended.
#[derive(Debug, Serialize)]
pub(crate) struct FoxgloveReport {
    pub(crate) address: String,
    pub(crate) messages: u64,
    /// Messages overwritten in shared memory or dropped because the queue was full.
    pub(crate) lost: u64,
}

/// The running server.
pub(crate) struct Foxglove {
    address: String,
    guard: Guard,
    server: WebSocketServerHandle,
    recorder: Recorder,
    forward: JoinHandle<anyhow::Result<()>>,
    sent: Arc<AtomicU64>,
}

impl Foxglove {
    /// Joins the fleet as a recorder and serves what it records.
    pub(crate) fn start(args: &ServeArguments, config: &Config) -> anyhow::Result<Self> {
        if !args.host.is_loopback() {
            log_line(&format!(
                "warning: {} can be reached from other hosts, and there is no password",
                args.host
            ));
        }
        let context = Context::new();
        let failed = || format!("cannot listen at {} port {}", args.host, args.port);
        let listener = TcpListener::bind((args.host, args.port)).with_context(failed)?;
        let address = format!("ws://{}", listener.local_addr().with_context(failed)?);
        let hidden = hidden_address();
        let server = WebSocketServer::new()
            .name(format!("joulebus {}", config.fleet()))
            .bind(hidden.to_string(), 0)
            .context(&context)
            .start_blocking()
            .with_context(|| format!("cannot listen at {hidden}"))?;
        let clock = host_clock();
        let attachments = attach(std::slice::from_ref(config), clock)?;
        let (reader, writer) = io::pipe().context("cannot make a pipe")?;
        let options = Options {
            settings: CaptureSettings::new(Preset::FastWrite),
            per_robot: args.per_robot,
            max_file_ns: u64::MAX,
            queue_bytes: QUEUE_BYTES,
            // A server shows what it reads and keeps nothing.
            member: "foxglove",
            ..Options::default()
        };
        // Start reading before the recorder starts: it first writes the models, which may exceed
        // the pipe's capacity.
        let sent = Arc::new(AtomicU64::new(0));
        let counted = Arc::clone(&sent);
        let forward = std::thread::Builder::new()
            .name("joulebus-serve".to_owned())
            .spawn(move || forward(reader, &context, &counted))?;
        let target = Target::Stream(Box::new(writer));
        let recorder = Recorder::start(config, Vec::new(), clock, attachments, target, &options)?;
        let inside = SocketAddr::new(hidden, server.port());
        let guard = Guard::start(listener, inside, args.allow_origin.clone())?;
        Ok(Self { address, guard, server, recorder, forward, sent })
    }

    /// The address that it listens on.
    pub(crate) fn address(&self) -> &str {
        &self.address
    }

    /// True if it has ended by itself.
    pub(crate) fn is_over(&self) -> bool {
        self.recorder.is_over() || self.forward.is_finished()
    }

    /// Lets the clients go, and leaves the fleet.
    ///
    /// # Errors
    /// The error that ended the recorder or the forwarding.
    pub(crate) fn finish(mut self) -> anyhow::Result<FoxgloveReport> {
        let summary = self.recorder.finish();
        // The recorder has closed the pipe, and the forwarding thread has ended.
        let forward = self.forward.join();
        forward.map_err(|_| anyhow::anyhow!("the server's thread has panicked"))??;
        self.guard.stop();
        end(self.server.stop());
        if let Some(reason) = summary.failure {
            return Err(anyhow::anyhow!(reason));
        }
        Ok(FoxgloveReport {
            address: self.address,
            messages: self.sent.load(Ordering::Relaxed),
            lost: summary.messages_lost(),
        })
    }
}

/// Waits for clients to disconnect, at most [`DISCONNECT_TIMEOUT`]: the exit of the process closes
/// their connections.
fn end(clients: ShutdownHandle) {
    let (done, finished) = channel();
    let wait = move || {
        clients.wait_blocking();
        // The receiver may have timed out.
        let _ = done.send(());
    };
    let waiting = std::thread::Builder::new().name("joulebus-end".to_owned());
    if waiting.spawn(wait).is_ok() {
        let _ = finished.recv_timeout(DISCONNECT_TIMEOUT);
    }
}

/// Forwards the messages from the pipe until it ends.
fn forward(pipe: io::PipeReader, context: &Arc<Context>, sent: &AtomicU64) -> anyhow::Result<()> {
    let mut channels: HashMap<Arc<str>, Arc<RawChannel>> = HashMap::new();
    let mut bytes = Vec::new();
    let mut reader = Reader::new(pipe)?;
    loop {
        let entry = match reader.next_entry() {
            Ok(Some(entry)) => entry,
            // A recorder stopped before its first message truncates its stream.
            Ok(None) | Err(ReadError::Truncated { .. }) => return Ok(()),
            Err(error) => return Err(error.into()),
        };
        let channel = match channels.get(&entry.topic) {
            Some(channel) => channel,
            None => {
                let channel = open(&entry, context)?;
                channels.entry(Arc::clone(&entry.topic)).or_insert(channel)
            }
        };
        bytes.clear();
        entry.message.encode(&mut bytes);
        channel.log_with_meta(&bytes, PartialMetadata::with_log_time(entry.log_time_ns));
        sent.fetch_add(1, Ordering::Relaxed);
    }
}

/// Opens a channel like that of the capture.
fn open(entry: &Entry, context: &Arc<Context>) -> anyhow::Result<Arc<RawChannel>> {
    let builder = ChannelBuilder::new(entry.topic.to_string())
        .context(context)
        .message_encoding("protobuf")
        .add_metadata("fleet", &entry.fleet);
    let builder = match entry.message.kind() {
        Some(kind) => builder.schema(Schema::new(kind.schema(), "protobuf", kind.descriptors())),
        None => builder,
    };
    builder.build_raw().with_context(|| format!("cannot open a channel for {}", entry.topic))
}
