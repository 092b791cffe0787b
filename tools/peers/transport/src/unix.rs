//! Unix stream sockets: source → relay → sink, the bytes copied into the kernel and out of it at
//! each hop. Default buffer sizes.

use std::io::{Read as _, Write as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::Child;

use joulebus_bench::Spread;
use joulebus_bench::latency::{Launcher, finish};
use joulebus_bus::clock;

use crate::frame::{Stamps, forecast_bytes, sample_bytes, stamps, write_forecasts, write_samples};
use crate::sink::Sink;
use crate::way::{Way, await_byte};

/// The source's end.
pub struct Unix {
    stream: UnixStream,
    frame: Vec<u8>,
    relay: Child,
    sink: Child,
    directory: PathBuf,
}

impl Unix {
    /// Starts the sink and the relay, and connects.
    pub fn open(
        launcher: &Launcher,
        robots: usize,
        period_ns: u64,
        acknowledge: bool,
    ) -> anyhow::Result<Self> {
        let directory = std::env::temp_dir().join(format!("joulebus-unix-{}", std::process::id()));
        std::fs::create_dir_all(&directory)?;
        let (name, size) = (directory.display().to_string(), robots.to_string());
        let mut role = vec!["unix-sink".into(), name.clone(), size.clone()];
        role.push(period_ns.to_string());
        role.extend(acknowledge.then(|| "--acknowledge".to_owned()));
        let sink = launcher.start(&role)?;
        let relay = launcher.start(&["unix-relay".into(), name, size])?;
        Ok(Self {
            stream: UnixStream::connect(relay_socket(&directory))?,
            frame: vec![0; sample_bytes(robots)],
            relay,
            sink,
            directory,
        })
    }
}

impl Way for Unix {
    fn send(&mut self, due_ns: u64) -> anyhow::Result<()> {
        let sent_ns = clock::monotonic_ns();
        write_samples(&mut self.frame, Stamps { due_ns, sent_ns });
        Ok(self.stream.write_all(&self.frame)?)
    }

    fn acknowledged(&mut self) -> anyhow::Result<()> {
        await_byte(&mut self.sink)
    }

    fn finish(mut self: Box<Self>) -> anyhow::Result<Spread> {
        self.send(0)?;
        let spread = finish(self.sink)?;
        self.relay.wait()?;
        std::fs::remove_dir_all(&self.directory)?;
        Ok(spread)
    }
}

/// The relay's process.
pub fn relay(directory: &Path, robots: usize) -> anyhow::Result<()> {
    let mut to_sink = UnixStream::connect(sink_socket(directory))?;
    let listener = UnixListener::bind(relay_socket(directory))?;
    println!("ready");
    let (mut from_source, _) = listener.accept()?;
    let mut samples = vec![0; sample_bytes(robots)];
    let mut forecasts = vec![0; forecast_bytes(robots)];
    loop {
        from_source.read_exact(&mut samples)?;
        write_forecasts(&samples, &mut forecasts);
        to_sink.write_all(&forecasts)?;
        if stamps(&samples).due_ns == 0 {
            return Ok(());
        }
    }
}

/// The sink's process.
pub fn sink(directory: &Path, mut sink: Sink, robots: usize) -> anyhow::Result<()> {
    let listener = UnixListener::bind(sink_socket(directory))?;
    println!("ready");
    let (mut from_relay, _) = listener.accept()?;
    let mut forecasts = vec![0; forecast_bytes(robots)];
    loop {
        from_relay.read_exact(&mut forecasts)?;
        if sink.take(&forecasts)? {
            return Ok(());
        }
    }
}

fn relay_socket(directory: &Path) -> PathBuf {
    directory.join("relay")
}

fn sink_socket(directory: &Path) -> PathBuf {
    directory.join("sink")
}
