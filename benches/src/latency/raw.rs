//! Two raw iceoryx2 hops: source → relay → sink, frames of the same sizes, one event each, no
//! computation. The lower bound for any broker on iceoryx2.

use std::fmt;
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::Child;

use anyhow::{Context as _, anyhow};
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{
    Config, FileName, Node, NodeBuilder, Path as IoxPath, SemanticString, SignalHandlingMode,
    ZeroCopySend, ipc,
};
use joulebus_bus::clock;
use joulebus_latency::Spread;
use joulebus_wire::{Forecast, ForecastHeader, Sample, SampleHeader};

use super::{Launcher, WARM_UP, finish, record_places};
use crate::histogram;

type End<T, H> = (Publisher<ipc::Service, [T], H>, Notifier<ipc::Service>);
type Start<T, H> = (Subscriber<ipc::Service, [T], H>, Listener<ipc::Service>);

/// The source's end of the two hops, and the other two processes.
pub struct RawHops {
    // Before the node, because ports must be dropped first.
    publisher: Publisher<ipc::Service, [Sample], SampleHeader>,
    notifier: Notifier<ipc::Service>,
    _node: Node<ipc::Service>,
    relay: Child,
    sink: Child,
    root: PathBuf,
    robots: usize,
}

impl fmt::Debug for RawHops {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("RawHops").field("robots", &self.robots).finish_non_exhaustive()
    }
}

impl RawHops {
    /// Starts the relay and the sink, and connects. With `acknowledge` the sink confirms each
    /// frame: [`RawHops::acknowledged`].
    ///
    /// # Errors
    /// A process could not be started, or a port not be opened.
    pub fn open(
        launcher: &Launcher,
        robots: usize,
        period_ns: u64,
        acknowledge: bool,
    ) -> anyhow::Result<Self> {
        let root = PathBuf::from(format!("/dev/shm/joulebus-bench-raw-{}", std::process::id()));
        std::fs::create_dir_all(&root)?;
        let (name, size) = (root.display().to_string(), robots.to_string());
        let relay = launcher.start(&["relay".into(), name.clone(), size.clone()])?;
        let mut role = vec!["sink".into(), name, size, period_ns.to_string()];
        role.extend(acknowledge.then(|| "--acknowledge".to_owned()));
        let sink = launcher.start(&role)?;
        let node = node(&root)?;
        let (publisher, notifier) = sending::<Sample, SampleHeader>(&node, "samples", robots)?;
        Ok(Self { publisher, notifier, _node: node, relay, sink, root, robots })
    }

    /// Waits until the sink has received one more frame.
    ///
    /// # Errors
    /// The sink has ended, or does not acknowledge.
    pub fn acknowledged(&mut self) -> anyhow::Result<()> {
        let output = self.sink.stdout.as_mut().context("no output of the sink")?;
        Ok(output.read_exact(&mut [0])?)
    }

    /// Sends a frame that was due at `intended_ns`. 0 ends the measurement.
    ///
    /// # Errors
    /// iceoryx2 reports an error.
    pub fn send(&mut self, intended_ns: u64) -> anyhow::Result<()> {
        let mut loan = self.publisher.loan_slice_uninit(self.robots)?;
        loan.user_header_mut().intended_ns = intended_ns;
        loan.user_header_mut().sent_ns = clock::monotonic_ns();
        loan.write_from_fn(|robot| Sample::new(robot as u32, 0, 0)).send()?;
        self.notifier.notify()?;
        Ok(())
    }

    /// Ends the processes. Returns the distribution from due to received.
    ///
    /// # Errors
    /// A process failed, or files cannot be removed.
    pub fn finish(mut self) -> anyhow::Result<Spread> {
        self.send(0)?;
        let spread = finish(self.sink)?;
        self.relay.wait()?;
        drop((self.publisher, self.notifier, self._node));
        std::fs::remove_dir_all(&self.root)?;
        remove_segments(&self.root)?;
        Ok(spread)
    }
}

/// Prefix of the segments of the measurement in `root`: those of others running at the same time
/// have another.
fn prefix(root: &Path) -> String {
    let name = root.to_string_lossy();
    let pid = name.rsplit('-').next().unwrap_or_default();
    format!("jbraw_{pid}_")
}

/// Removes the segment that iceoryx2 leaves behind.
fn remove_segments(root: &Path) -> anyhow::Result<()> {
    let prefix = prefix(root);
    for entry in std::fs::read_dir("/dev/shm")? {
        let entry = entry?;
        if entry.file_name().to_string_lossy().starts_with(&prefix) {
            std::fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// The relay's process.
///
/// # Errors
/// iceoryx2 reports an error.
pub fn relay(root: &Path, robots: usize) -> anyhow::Result<()> {
    let node = node(root)?;
    let (publisher, notifier) = sending::<Forecast, ForecastHeader>(&node, "forecasts", robots)?;
    let (subscriber, listener) = receiving::<Sample, SampleHeader>(&node, "samples")?;
    println!("ready");
    loop {
        listener.blocking_wait(|_| {}).map_err(|error| anyhow!("{error:?}"))?;
        while let Some(frame) = subscriber.receive()? {
            let mut loan = publisher.loan_slice_uninit(robots)?;
            let intended_ns = frame.user_header().intended_ns;
            loan.user_header_mut().first_intended_ns = intended_ns;
            loan.user_header_mut().first_sent_ns = frame.user_header().sent_ns;
            let payload = frame.payload();
            let forecast =
                |place: usize| Forecast { robot: payload[place].robot, ..Forecast::default() };
            loan.write_from_fn(forecast).send()?;
            notifier.notify()?;
            if intended_ns == 0 {
                return Ok(());
            }
        }
    }
}

/// The sink's process: prints the distribution of its latencies. `acknowledge`: prints a byte for
/// each frame before.
///
/// # Errors
/// iceoryx2 reports an error.
pub fn sink(root: &Path, robots: usize, period_ns: u64, acknowledge: bool) -> anyhow::Result<()> {
    let node = node(root)?;
    let (subscriber, listener) = receiving::<Forecast, ForecastHeader>(&node, "forecasts")?;
    println!("ready");
    let mut stdout = std::io::stdout();
    let (mut times, mut seen) = (histogram(), 0);
    loop {
        listener.blocking_wait(|_| {}).map_err(|error| anyhow!("{error:?}"))?;
        while let Some(frame) = subscriber.receive()? {
            let now_ns = clock::monotonic_ns();
            anyhow::ensure!(frame.payload().len() == robots, "a frame of another size");
            let header = frame.user_header();
            let (intended_ns, sent_ns) = (header.first_intended_ns, header.first_sent_ns);
            if intended_ns == 0 {
                println!("\n{}", serde_json::to_string(&Spread::new(&times))?);
                return Ok(());
            }
            seen += 1;
            if seen > WARM_UP {
                record_places(&mut times, (intended_ns, sent_ns, now_ns), period_ns, 1);
            }
            if acknowledge {
                stdout.write_all(b".")?;
                stdout.flush()?;
            }
        }
    }
}

fn node(root: &Path) -> anyhow::Result<Node<ipc::Service>> {
    let mut config = Config::default();
    config.global.prefix = FileName::new(prefix(root).as_bytes())?;
    config.global.set_root_path(&IoxPath::new(root.as_os_str().as_encoded_bytes())?);
    let node = NodeBuilder::new()
        .config(&config)
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create()?;
    Ok(node)
}

fn sending<T, H>(node: &Node<ipc::Service>, name: &str, robots: usize) -> anyhow::Result<End<T, H>>
where
    T: std::fmt::Debug + ZeroCopySend + 'static,
    H: std::fmt::Debug + Default + ZeroCopySend + 'static,
{
    let service = node.service_builder(&name.try_into()?).publish_subscribe::<[T]>();
    let publisher = service
        .user_header::<H>()
        .open_or_create()?
        .publisher_builder()
        .initial_max_slice_len(robots)
        .create()?;
    let event = node.service_builder(&name.try_into()?).event().open_or_create()?;
    Ok((publisher, event.notifier_builder().create()?))
}

fn receiving<T, H>(node: &Node<ipc::Service>, name: &str) -> anyhow::Result<Start<T, H>>
where
    T: std::fmt::Debug + ZeroCopySend + 'static,
    H: std::fmt::Debug + Default + ZeroCopySend + 'static,
{
    let service = node.service_builder(&name.try_into()?).publish_subscribe::<[T]>();
    let subscriber = service.user_header::<H>().open_or_create()?.subscriber_builder().create()?;
    let event = node.service_builder(&name.try_into()?).event().open_or_create()?;
    Ok((subscriber, event.listener_builder().create()?))
}
