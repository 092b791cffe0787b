//! zenoh with shared memory: payloads in a POSIX segment, references over a Unix socket. Sessions
//! are peers with fixed addresses; no scouting.

use std::path::{Path, PathBuf};
use std::process::Child;
use std::sync::mpsc;
use std::time::Duration;

use anyhow::{Context as _, anyhow};
use joulebus_bench::Spread;
use joulebus_bench::latency::{Launcher, finish};
use joulebus_bus::clock;
use zenoh::qos::CongestionControl;
use zenoh::shm::{
    BlockOn, GarbageCollect, PosixShmProviderBackend, ShmProvider, ShmProviderBuilder, ZShmMut,
};
use zenoh::{Session, Wait as _};

use crate::frame::{Stamps, forecast_bytes, sample_bytes, write_forecasts, write_samples};
use crate::sink::Sink;
use crate::way::{Way, await_byte};

/// Frames that a provider has memory for: more than can be in flight.
const FRAMES: usize = 16;

/// One end that sends.
struct Sender {
    publisher: zenoh::pubsub::Publisher<'static>,
    provider: ShmProvider<PosixShmProviderBackend>,
    bytes: usize,
}

impl Sender {
    fn open(session: &Session, key: &'static str, bytes: usize) -> anyhow::Result<Self> {
        let publisher = session
            .declare_publisher(key)
            .congestion_control(CongestionControl::Block)
            .express(true)
            .wait()
            .map_err(in_words)?;
        let provider = ShmProviderBuilder::default_backend((bytes + 4096) * FRAMES)
            .wait()
            .map_err(|error| anyhow!("{error:?}"))?;
        Ok(Self { publisher, provider, bytes })
    }

    /// Waits for a subscriber.
    fn await_listener(&self) -> anyhow::Result<()> {
        while !self.publisher.matching_status().wait().map_err(in_words)?.matching() {
            std::thread::sleep(Duration::from_millis(5));
        }
        Ok(())
    }

    fn send(&self, write: impl FnOnce(&mut [u8])) -> anyhow::Result<()> {
        let mut frame: ZShmMut = self
            .provider
            .alloc(self.bytes)
            .with_policy::<BlockOn<GarbageCollect>>()
            .wait()
            .map_err(|error| anyhow!("{error:?}"))?;
        write(&mut frame);
        self.publisher.put(frame).wait().map_err(in_words)
    }
}

/// The source's end.
pub struct Zenoh {
    sender: Sender,
    session: Session,
    relay: Child,
    sink: Child,
    directory: PathBuf,
}

impl Zenoh {
    /// Starts the relay and the sink, and connects.
    pub fn open(
        launcher: &Launcher,
        robots: usize,
        period_ns: u64,
        acknowledge: bool,
    ) -> anyhow::Result<Self> {
        let directory = std::env::temp_dir().join(format!("joulebus-zenoh-{}", std::process::id()));
        std::fs::create_dir_all(&directory)?;
        let (name, size) = (directory.display().to_string(), robots.to_string());
        let relay = launcher.start(&["zenoh-relay".into(), name.clone(), size.clone()])?;
        let mut role = vec!["zenoh-sink".into(), name, size, period_ns.to_string()];
        role.extend(acknowledge.then(|| "--acknowledge".to_owned()));
        let sink = launcher.start(&role)?;
        let session = session("connect", &directory)?;
        let sender = Sender::open(&session, "samples", sample_bytes(robots))?;
        sender.await_listener()?;
        Ok(Self { sender, session, relay, sink, directory })
    }
}

impl Way for Zenoh {
    fn send(&mut self, due_ns: u64) -> anyhow::Result<()> {
        let sent_ns = clock::monotonic_ns();
        self.sender.send(|frame| write_samples(frame, Stamps { due_ns, sent_ns }))
    }

    fn acknowledged(&mut self) -> anyhow::Result<()> {
        await_byte(&mut self.sink)
    }

    fn finish(mut self: Box<Self>) -> anyhow::Result<Spread> {
        self.send(0)?;
        let spread = finish(self.sink)?;
        // The relay has sent the last frame and waits for its stdin to close.
        drop(self.relay.stdin.take());
        self.relay.wait()?;
        drop(self.sender);
        self.session.close().wait().map_err(in_words)?;
        std::fs::remove_dir_all(&self.directory)?;
        Ok(spread)
    }
}

/// The relay's process: answers in the receiving thread, so that no hop is added.
pub fn relay(directory: &Path, robots: usize) -> anyhow::Result<()> {
    let session = session("listen", directory)?;
    let sender = Sender::open(&session, "forecasts", forecast_bytes(robots))?;
    let (failed, failure) = mpsc::channel();
    let subscriber = session
        .declare_subscriber("samples")
        .callback(move |sample| {
            if let Err(error) = answer(&sender, &sample) {
                let _ = failed.send(error);
            }
        })
        .wait()
        .map_err(in_words)?;
    println!("ready");
    std::io::read_to_string(std::io::stdin())?;
    drop(subscriber);
    session.close().wait().map_err(in_words)?;
    failure.try_recv().map_or(Ok(()), Err)
}

fn answer(sender: &Sender, sample: &zenoh::sample::Sample) -> anyhow::Result<()> {
    let samples = in_shared_memory(sample)?;
    sender.send(|forecasts| write_forecasts(samples, forecasts))
}

/// The sink's process: measures in the receiving thread.
pub fn sink(directory: &Path, mut sink: Sink) -> anyhow::Result<()> {
    let session = session("connect", directory)?;
    let (ended, end) = mpsc::channel();
    let subscriber = session
        .declare_subscriber("forecasts")
        .callback_mut(move |sample| {
            match in_shared_memory(&sample).and_then(|frame| sink.take(frame)) {
                Ok(false) => {}
                outcome => drop(ended.send(outcome)),
            }
        })
        .wait()
        .map_err(in_words)?;
    // The relay has a listener when its publisher reports it; querying it would need another
    // channel.
    std::thread::sleep(Duration::from_millis(500));
    println!("ready");
    end.recv().context("zenoh has dropped the subscriber")??;
    drop(subscriber);
    session.close().wait().map_err(in_words)
}

/// The frame in shared memory; a copy is an error.
fn in_shared_memory(sample: &zenoh::sample::Sample) -> anyhow::Result<&[u8]> {
    let shared = sample.payload().as_shm();
    Ok(shared.context("a frame was not in shared memory")?)
}

fn session(does: &str, directory: &Path) -> anyhow::Result<Session> {
    let socket = directory.join("relay");
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"peer\"".to_owned()),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
        ("listen/endpoints", "[]".to_owned()),
        ("transport/shared_memory/enabled", "true".to_owned()),
        (&format!("{does}/endpoints"), format!("[\"unixsock-stream/{}\"]", socket.display())),
    ] {
        config.insert_json5(key, &value).map_err(|error| anyhow!("{key}: {error}"))?;
    }
    zenoh::open(config).wait().map_err(in_words)
}

fn in_words(error: zenoh::Error) -> anyhow::Error {
    anyhow!("zenoh: {error}")
}
