//! Two raw iceoryx2 hops: source → relay → sink, frames of the same sizes, an event each, nothing
//! computed. What no broker on iceoryx2 can be faster than.

use std::io::Read;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, anyhow};
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{
    Config, FileName, Node, NodeBuilder, Path as IoxPath, SemanticString, SignalHandlingMode,
    ZeroCopySend, ipc,
};
use joulebus_benches::{Spread, histogram};
use joulebus_bus::clock;
use joulebus_publisher::Pace;
use joulebus_wire::{Forecast, ForecastHeader, Sample, SampleHeader};

use crate::{finish, start};

/// Frames before the figures count.
const WARM_UP: u64 = 30;

type End<T, H> = (Publisher<ipc::Service, [T], H>, Notifier<ipc::Service>);
type Start<T, H> = (Subscriber<ipc::Service, [T], H>, Listener<ipc::Service>);

pub(crate) fn measure(robots: usize, rate_hz: u64, frames: u64) -> anyhow::Result<Spread> {
    let root = format!("/dev/shm/joulebus-bench-raw-{}", std::process::id());
    std::fs::create_dir_all(&root)?;
    let spread = run(Path::new(&root), robots, rate_hz, frames);
    std::fs::remove_dir_all(&root)?;
    remove_segments()?;
    spread
}

fn run(root: &Path, robots: usize, rate_hz: u64, frames: u64) -> anyhow::Result<Spread> {
    let name = root.display().to_string();
    let mut relay = start(&["relay".into(), name.clone(), robots.to_string()])?;
    let mut sink = start(&["sink".into(), name, robots.to_string(), frames.to_string()])?;
    for child in [&mut relay, &mut sink] {
        let stdout = child.stdout.as_mut().context("not piped")?;
        stdout
            .read_exact(&mut [0; 6])
            .context("the child ended before it was ready")?;
    }
    let node = node(root)?;
    let (publisher, notifier) = sending::<Sample, SampleHeader>(&node, "samples", robots)?;
    let mut pace = Pace::every(Duration::from_nanos(1_000_000_000 / rate_hz));
    for _ in 0..WARM_UP + frames + 1 {
        let slot = pace.wait();
        let mut loan = publisher.loan_slice_uninit(robots)?;
        loan.user_header_mut().sent_ns = slot.intended_ns;
        loan.write_from_fn(|robot| Sample::new(robot as u32, 0, 0))
            .send()?;
        notifier.notify()?;
    }
    let spread = finish(sink);
    relay.kill()?;
    relay.wait()?;
    spread
}

/// iceoryx2 leaves a segment of its own behind, and the relay is killed.
fn remove_segments() -> anyhow::Result<()> {
    for entry in std::fs::read_dir("/dev/shm")? {
        let entry = entry?;
        if entry.file_name().to_string_lossy().starts_with("jbraw_") {
            std::fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

pub(crate) fn relay(root: &Path, robots: usize) -> anyhow::Result<()> {
    let node = node(root)?;
    let (publisher, notifier) = sending::<Forecast, ForecastHeader>(&node, "forecasts", robots)?;
    let (subscriber, listener) = receiving::<Sample, SampleHeader>(&node, "samples")?;
    println!("ready");
    loop {
        listener
            .blocking_wait(|_| {})
            .map_err(|error| anyhow!("{error:?}"))?;
        while let Some(frame) = subscriber.receive()? {
            let mut loan = publisher.loan_slice_uninit(robots)?;
            loan.user_header_mut().sent_ns = frame.user_header().sent_ns;
            let payload = frame.payload();
            let forecast = |place: usize| Forecast {
                robot: payload[place].robot,
                ..Forecast::default()
            };
            loan.write_from_fn(forecast).send()?;
            notifier.notify()?;
        }
    }
}

pub(crate) fn sink(root: &Path, robots: usize, frames: u64) -> anyhow::Result<()> {
    let node = node(root)?;
    let (subscriber, listener) = receiving::<Forecast, ForecastHeader>(&node, "forecasts")?;
    println!("ready");
    let (mut times, mut seen) = (histogram(), 0);
    while seen < WARM_UP + frames {
        listener
            .blocking_wait(|_| {})
            .map_err(|error| anyhow!("{error:?}"))?;
        while let Some(frame) = subscriber.receive()? {
            let now_ns = clock::monotonic_ns();
            anyhow::ensure!(frame.payload().len() == robots, "a frame of another size");
            seen += 1;
            if seen > WARM_UP {
                times.saturating_record(now_ns.saturating_sub(frame.user_header().sent_ns));
            }
        }
    }
    println!("{}", serde_json::to_string(&Spread::of(&times))?);
    Ok(())
}

fn node(root: &Path) -> anyhow::Result<Node<ipc::Service>> {
    let mut config = Config::default();
    config.global.prefix = FileName::new(b"jbraw_")?;
    config
        .global
        .set_root_path(&IoxPath::new(root.as_os_str().as_encoded_bytes())?);
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
    let service = node
        .service_builder(&name.try_into()?)
        .publish_subscribe::<[T]>();
    let publisher = service
        .user_header::<H>()
        .open_or_create()?
        .publisher_builder()
        .initial_max_slice_len(robots)
        .create()?;
    let event = node
        .service_builder(&name.try_into()?)
        .event()
        .open_or_create()?;
    Ok((publisher, event.notifier_builder().create()?))
}

fn receiving<T, H>(node: &Node<ipc::Service>, name: &str) -> anyhow::Result<Start<T, H>>
where
    T: std::fmt::Debug + ZeroCopySend + 'static,
    H: std::fmt::Debug + Default + ZeroCopySend + 'static,
{
    let service = node
        .service_builder(&name.try_into()?)
        .publish_subscribe::<[T]>();
    let subscriber = service
        .user_header::<H>()
        .open_or_create()?
        .subscriber_builder()
        .create()?;
    let event = node
        .service_builder(&name.try_into()?)
        .event()
        .open_or_create()?;
    Ok((subscriber, event.listener_builder().create()?))
}
