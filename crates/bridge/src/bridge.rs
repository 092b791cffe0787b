//! `joulebus bridge`: the threads of a bridge, and its report.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use anyhow::{Context as _, anyhow};
use joulebus_bus::lower_priority;
use joulebus_config::Config;
use joulebus_program::exit::Outcome;
use joulebus_program::output::{Output, say};
use joulebus_program::stop::Stop;
use joulebus_program::verbs::bridge::BridgeArguments;
use serde::Serialize;
use serde_json::json;

use crate::config::{MqttSettings, Settings};
use crate::mapping::account::UnmappedRecord;
use crate::mapping::outgoing::What;
use crate::mqtt::{Mqtt, Outlet};
use crate::publishing::{self, PublishedRecord};
use crate::shared::Shared;
use crate::telling::{MOST_WAITING, Start, Telling, read_alarms};

/// Interval of checking whether to stop.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// Nice value of the threads that talk to others: the worker and its sources run first.
const NICE: u8 = 5;

/// What was bridged.
#[derive(Debug, Serialize)]
struct BridgeReport {
    fleet: String,
    bridge: String,
    robots: usize,
    /// Messages that came.
    messages: u64,
    /// Of which the mapping made this much.
    observations: u64,
    published: PublishedRecord,
    /// Messages written.
    written: u64,
    /// Messages and changes of alarms that could not be written.
    not_written: u64,
    /// What could not be mapped.
    unmapped: Vec<UnmappedRecord>,
}

/// What `--check` says.
#[derive(Debug, Serialize)]
struct CheckReport {
    fleet: String,
    bridge: String,
    robots: usize,
    broker: Option<String>,
    reads: Vec<String>,
    writes: usize,
}

pub(crate) fn run(args: &BridgeArguments, output: Output) -> anyhow::Result<Outcome> {
    let stop = Stop::on_signals()?;
    let config = args.config.load()?;
    let settings = Settings::load(&args.file, &config)?;
    if args.check {
        output.report(&checked(&config, &settings))?;
        return Ok(Outcome::Done);
    }
    let mut bridge = Bridge::start(&config, &settings)?;
    while !stop.is_asked() && !bridge.is_over() {
        thread::sleep(LOOK_EVERY);
    }
    let report = bridge.finish(&config, &settings)?;
    let lost = report.not_written > 0 || bridge.shared.account().lost() > 0;
    output.report(&report)?;
    Ok(Outcome::unless_lost(lost))
}

fn checked(config: &Config, settings: &Settings) -> CheckReport {
    let mqtt = settings.mqtt.as_ref();
    let routes = mqtt.map_or(&[][..], |mqtt| &mqtt.routes);
    CheckReport {
        fleet: config.fleet().to_owned(),
        bridge: settings.name.clone(),
        robots: settings.robots.len(),
        broker: mqtt.map(|mqtt| format!("{}:{}", mqtt.host, mqtt.port)),
        reads: routes.iter().map(|route| route.name.clone()).collect(),
        writes: mqtt.map_or(0, |mqtt| mqtt.writes.len()),
    }
}

type Thread<T> = JoinHandle<anyhow::Result<T>>;

/// The running threads.
struct Bridge {
    shared: Arc<Shared>,
    lost: Arc<AtomicU64>,
    publishing: Option<Thread<PublishedRecord>>,
    others: Vec<Thread<()>>,
    connection: Option<Thread<()>>,
    outlet: Option<Arc<Outlet>>,
}

impl Bridge {
    fn start(config: &Config, settings: &Settings) -> anyhow::Result<Self> {
        let mut bridge = Self {
            shared: Arc::new(Shared::new(settings.intake(config))),
            lost: Arc::default(),
            publishing: None,
            others: Vec::new(),
            connection: None,
            outlet: None,
        };
        bridge.start_publishing(config, settings)?;
        if let Some(mqtt) = &settings.mqtt {
            bridge.start_mqtt(config, settings, mqtt)?;
        }
        let (fleet, robots) = (config.fleet(), settings.robots.len());
        say(&format!("bridging {robots} robots of fleet {fleet}"));
        Ok(bridge)
    }

    fn start_publishing(&mut self, config: &Config, settings: &Settings) -> anyhow::Result<()> {
        let is_source = settings
            .mqtt
            .as_ref()
            .is_some_and(|mqtt| !mqtt.routes.is_empty() || mqtt.vizier.is_some());
        if !is_source {
            return Ok(());
        }
        let (ready, joined) = sync_channel(1);
        let (config, shared) = (config.clone(), Arc::clone(&self.shared));
        let (name, robots) = (settings.name.clone(), settings.robots.clone());
        let thread = spawn("joulebus-publish", move || {
            publishing::run(&config, &name, &robots, &shared, || {
                // The caller waits for it.
                let _ = ready.send(());
            })
        })?;
        if joined.recv().is_err() {
            join(thread)?;
        } else {
            self.publishing = Some(thread);
        }
        Ok(())
    }

    fn start_mqtt(
        &mut self,
        config: &Config,
        settings: &Settings,
        mqtt: &MqttSettings,
    ) -> anyhow::Result<()> {
        let offline = json!({"fleet": config.fleet(), "bridge": settings.name, "state": "offline"});
        let offline = offline.to_string().into_bytes();
        let connection = Mqtt::new(mqtt, &settings.robots, &offline, &self.shared);
        let outlet = connection.outlet();
        self.outlet = Some(Arc::clone(&outlet));
        if !mqtt.writes.is_empty() {
            self.start_telling(config, settings, mqtt, outlet)?;
        }
        let thread = spawn("joulebus-mqtt", move || {
            yield_to_the_worker();
            connection.run().map_err(Into::into)
        })?;
        self.connection = Some(thread);
        Ok(())
    }

    fn start_telling(
        &mut self,
        config: &Config,
        settings: &Settings,
        mqtt: &MqttSettings,
        outlet: Arc<Outlet>,
    ) -> anyhow::Result<()> {
        let (changes, changed) = sync_channel(MOST_WAITING);
        let start = Start {
            name: settings.name.clone(),
            robots: settings.robots.clone(),
            writes: mqtt.writes.clone(),
            outlet,
            changes: changed,
            shared: Arc::clone(&self.shared),
            lost: Arc::clone(&self.lost),
            // A broker that does not answer is noticed by the second ping.
            arrives_within_ns: u64::try_from(3 * mqtt.keep_alive.as_nanos()).unwrap_or(u64::MAX),
        };
        let told = config.clone();
        self.start_joining("joulebus-tell", move |ready| {
            let telling = Telling::open(&told, start)?;
            // The caller waits for it.
            let _ = ready.send(());
            telling.run()
        })?;
        if mqtt
            .writes
            .iter()
            .any(|write| write.what == What::AlarmChanges)
        {
            let (config, name) = (config.clone(), settings.name.clone());
            let (shared, lost) = (Arc::clone(&self.shared), Arc::clone(&self.lost));
            let thread = spawn("joulebus-alarms", move || {
                yield_to_the_worker();
                read_alarms(&config, &name, &changes, &shared, &lost)
            })?;
            self.others.push(thread);
        }
        Ok(())
    }

    /// Starts a thread, and waits until it has joined the fleet.
    fn start_joining(
        &mut self,
        name: &str,
        work: impl FnOnce(SyncSender<()>) -> anyhow::Result<()> + Send + 'static,
    ) -> anyhow::Result<()> {
        let (ready, joined) = sync_channel(1);
        let thread = spawn(name, move || {
            yield_to_the_worker();
            work(ready)
        })?;
        if joined.recv().is_err() {
            return join(thread);
        }
        self.others.push(thread);
        Ok(())
    }

    /// Whether a thread has ended by itself.
    fn is_over(&self) -> bool {
        let publishing = self.publishing.as_ref();
        let mut others = self.others.iter().chain(&self.connection);
        publishing.is_some_and(JoinHandle::is_finished) || others.any(JoinHandle::is_finished)
    }

    /// Ends all threads: the connection last, after what the others have told.
    fn finish(&mut self, config: &Config, settings: &Settings) -> anyhow::Result<BridgeReport> {
        self.shared.stop();
        let published = self.publishing.take().map(join);
        let mut ended: Vec<anyhow::Result<()>> = self.others.drain(..).map(join).collect();
        self.shared.close();
        ended.extend(self.connection.take().map(join));
        ended.into_iter().collect::<anyhow::Result<()>>()?;
        let outlet = self.outlet.as_ref();
        Ok(BridgeReport {
            fleet: config.fleet().to_owned(),
            bridge: settings.name.clone(),
            robots: settings.robots.len(),
            messages: self.shared.messages(),
            observations: self.shared.intake().observations(),
            published: published.transpose()?.unwrap_or_default(),
            written: outlet.map_or(0, |outlet| outlet.sent()),
            not_written: self.lost.load(Ordering::Relaxed)
                + outlet.map_or(0, |outlet| outlet.lost()),
            unmapped: self.shared.account().records(),
        })
    }
}

fn spawn<T: Send + 'static>(
    name: &str,
    work: impl FnOnce() -> anyhow::Result<T> + Send + 'static,
) -> anyhow::Result<Thread<T>> {
    let thread = thread::Builder::new().name(name.to_owned());
    thread
        .spawn(work)
        .with_context(|| format!("cannot start the thread {name}"))
}

fn join<T>(thread: Thread<T>) -> anyhow::Result<T> {
    thread
        .join()
        .map_err(|_| anyhow!("a thread of the bridge panicked"))?
}

fn yield_to_the_worker() {
    if let Err(error) = lower_priority(NICE) {
        tracing::warn!(%error, "this thread competes with the worker for processors");
    }
}

impl fmt::Display for BridgeReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            fleet,
            bridge,
            robots,
            messages,
            observations,
            published,
            written,
            not_written,
            unmapped,
        } = self;
        writeln!(
            out,
            "bridge {bridge} of fleet {fleet}, {robots} robots: {messages} messages, {observations} observations"
        )?;
        let PublishedRecord {
            frames,
            samples,
            frames_unheard,
            frames_failed,
        } = published;
        writeln!(
            out,
            "published {samples} samples in {frames} frames, {frames_unheard} without a worker, {frames_failed} not sent"
        )?;
        writeln!(out, "wrote {written} messages, {not_written} lost")?;
        unmapped
            .iter()
            .try_for_each(|line| writeln!(out, "not mapped: {line}"))
    }
}

impl fmt::Display for CheckReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            fleet,
            bridge,
            robots,
            broker,
            reads,
            writes,
        } = self;
        writeln!(out, "bridge {bridge} of fleet {fleet}: {robots} robots")?;
        if let Some(broker) = broker {
            writeln!(
                out,
                "broker {broker}: reads {}; writes {writes} topics",
                reads.join(", ")
            )?;
        }
        Ok(())
    }
}
