//! `joulebus bridge`: starts the threads of a bridge, waits for the stop, and reports.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::sync_channel;
use std::thread;
use std::time::Duration;

use crate::arguments::BridgeArguments;
use joulebus_bus::{Background, NoWorker, check_threads, clock, yield_to_the_worker};
use joulebus_config::{CheckedFile, Config, File};
use joulebus_consumer::FleetAlarms;
use joulebus_program::exit::Outcome;
use joulebus_program::output::{Output, log_line};
use joulebus_program::stop::Stop;
use joulebus_publisher::Implausible;
use joulebus_ros_messages::Clock;
use joulebus_settings::NO_BATTERY;
use serde::Serialize;
use serde_json::json;

use crate::config::{MqttSettings, Ros2Settings, RosWrite, Settings};
use crate::mapping::account::UnmappedRecord;
use crate::mapping::outgoing::What;
use crate::mapping::ros::incoming::RosRoute;
use crate::mapping::ros::names::ros_type;
use crate::mapping::ros::services::Service;
use crate::mapping::simulated::{Allowed, SimulatedClock};
use crate::mqtt::{AlarmReading, MAX_WAITING, Mqtt, MqttSink, Outlet, Start};
use crate::outbound::{self, Sink};
use crate::publishing::{self, PublishedRecord};
use crate::ros2::{
    Answering, CLOCK_TOPIC, Counts, Reading, Requests, Ros2, RosSink, Zenoh, is_zenoh,
};
use crate::shared::{NICE, Shared};
use crate::usual;

/// Interval between checks for a stop.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// The report of a bridge that has ended.
#[derive(Debug, Default, Serialize)]
struct BridgeReport {
    fleet: String,
    bridge: String,
    robots: usize,
    /// Messages received.
    messages: u64,
    /// Observations that the mapping made of them.
    observations: u64,
    published: PublishedRecord,
    /// Messages written.
    written: u64,
    /// Messages and alarm changes that could not be written.
    not_written: u64,
    /// Messages and values that could not be mapped.
    unmapped: Vec<UnmappedRecord>,
    /// Implausible reports of robots.
    implausible: Vec<Implausible>,
}

impl BridgeReport {
    /// The exit code: whether everything that was received or due was passed on. `unmapped` is the
    /// number of messages that should have been mapped but could not be.
    fn outcome(&self, unmapped: u64) -> Outcome {
        Outcome::unless_lost(
            self.not_written > 0
                || self.published.frames_failed > 0
                || self.published.samples_refused > 0
                || unmapped > 0,
        )
    }
}

/// The report of `--check`.
#[derive(Debug, Serialize)]
struct CheckReport {
    fleet: String,
    bridge: String,
    robots: usize,
    broker: Option<String>,
    /// Topics that are read from the broker.
    reads: Vec<String>,
    /// Number of topics that are written to the broker.
    writes: usize,
    ros2: Option<RosCheckReport>,
}

/// The part of the `--check` report about ROS 2. Topics are shown with their types.
#[derive(Debug, Serialize)]
struct RosCheckReport {
    domain_id: u16,
    /// True if messages go over zenoh, and not over DDS.
    zenoh: bool,
    networks: Vec<String>,
    reads: Vec<String>,
    writes: Vec<String>,
    services: Vec<String>,
}

pub(crate) fn run(args: &BridgeArguments, output: Output) -> anyhow::Result<Outcome> {
    let stop = Stop::on_signals()?;
    check_threads()?;
    let config = args.config.load()?;
    let usual = usual::mapping(args)?;
    let file = match &usual {
        Some(mapping) => CheckedFile::parse(mapping, &args.file, File::Bridge)?,
        None => CheckedFile::load(&args.file, File::Bridge)?,
    };
    let settings = Settings::new(&file, &config)?;
    if let (Some(mapping), Some(path)) = (&usual, &args.write) {
        return usual::write_new(mapping, path);
    }
    usual.as_deref().inspect(|mapping| usual::print(mapping));
    if args.check {
        output.report(&checked(&config, &settings))?;
        return Ok(Outcome::Done);
    }
    let mut bridge = Bridge::start(&config, &settings)?;
    if let Some(no_worker) = NoWorker::look(&config.domain()?) {
        log_line(&format!("{no_worker}. Samples sent before one starts are lost"));
    }
    while !stop.is_asked() && !bridge.is_over() {
        thread::sleep(POLL_INTERVAL);
        bridge.shared.log_clock();
    }
    let report = bridge.finish(&config, &settings)?;
    output.report(&report)?;
    Ok(report.outcome(bridge.shared.account().lost()))
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
        ros2: settings.ros2.as_ref().map(ros_checked),
    }
}

fn ros_checked(ros2: &Ros2Settings) -> RosCheckReport {
    let read = |route: &RosRoute| format!("{} ({})", route.name, ros_type(route.kind));
    let write = |write: &RosWrite| format!("{} ({})", write.name, write.what.type_name());
    let clock = ros2.use_sim_time.then(|| format!("{CLOCK_TOPIC} ({})", Clock::NAME));
    let serve = |(service, name): &(Service, String)| format!("{name} ({})", service.type_name());
    RosCheckReport {
        domain_id: ros2.domain_id,
        zenoh: is_zenoh(),
        networks: ros2.networks.iter().map(ToString::to_string).collect(),
        reads: ros2.routes.iter().map(read).chain(clock).collect(),
        writes: ros2.writes.iter().map(write).collect(),
        services: ros2.services.iter().map(serve).collect(),
    }
}

type Thread<T> = Background<anyhow::Result<T>>;

struct Bridge {
    shared: Arc<Shared>,
    /// Number of lost alarm changes.
    lost: Arc<AtomicU64>,
    publishing: Option<Thread<PublishedRecord>>,
    others: Vec<Thread<()>>,
    connections: Vec<Thread<()>>,
    outlet: Option<Arc<Outlet>>,
    ros2: Arc<Counts>,
}

impl Bridge {
    fn start(config: &Config, settings: &Settings) -> anyhow::Result<Self> {
        let is_simulated = settings.ros2.as_ref().is_some_and(|ros2| ros2.use_sim_time);
        let allowed = Allowed::new(config.settings(), config.tick_period_ns());
        let simulated = is_simulated.then(|| SimulatedClock::new(allowed, clock::monotonic_ns()));
        let mut bridge = Self {
            shared: Arc::new(Shared::new(settings.intake(config), simulated)),
            lost: Arc::default(),
            publishing: None,
            others: Vec::new(),
            connections: Vec::new(),
            outlet: None,
            ros2: Arc::default(),
        };
        bridge.start_publishing(config, settings)?;
        let mut sides: Vec<Box<dyn Sink>> = Vec::new();
        if let Some(ros2) = &settings.ros2 {
            bridge.start_ros2(config, settings, ros2, &mut sides)?;
        }
        let mqtt = settings.mqtt.as_ref();
        let connection = mqtt.map(|mqtt| bridge.prepare_mqtt(config, settings, mqtt));
        let connection = connection.transpose()?;
        if let (Some(mqtt), Some(connection)) = (mqtt, &connection) {
            bridge.start_mqtt_sink(config, settings, (mqtt, connection), &mut sides)?;
        }
        bridge.start_outbound(config, settings, sides)?;
        if let Some(connection) = connection {
            let (thread, ()) = Background::run("joulebus-mqtt", move |thread| {
                yield_to_the_worker(NICE);
                thread.joined(());
                connection.run().map_err(anyhow::Error::from)
            })?;
            bridge.connections.push(thread);
        }
        let (fleet, robots) = (config.fleet(), settings.robots.len());
        for platform in &config.settings().platforms {
            let mut ids = settings.robots.iter().map(|(id, _)| id);
            let bridged = ids.any(|id| platform.robots.iter().any(|range| range.contains(&id)));
            if bridged && platform.battery.is_none() && settings.writes_budgets() {
                log_line(&format!("platform {}: {NO_BATTERY}", platform.name));
            }
        }
        log_line(&format!("bridging {robots} robots of fleet {fleet}"));
        Ok(bridge)
    }

    fn start_publishing(&mut self, config: &Config, settings: &Settings) -> anyhow::Result<()> {
        if !settings.is_source() {
            return Ok(());
        }
        let thread = publishing::start(config, &settings.name, &settings.robots, &self.shared)?;
        self.publishing = Some(thread);
        Ok(())
    }

    fn start_ros2(
        &mut self,
        config: &Config,
        settings: &Settings,
        ros2: &Ros2Settings,
        sides: &mut Vec<Box<dyn Sink>>,
    ) -> anyhow::Result<()> {
        let mut sink = RosSink {
            fleet: config.fleet().to_owned(),
            name: settings.name.clone(),
            robots: settings.robots.clone(),
            topics: Vec::new(),
            counts: Arc::clone(&self.ros2),
            shared: Arc::clone(&self.shared),
        };
        let requests = Arc::<Requests>::default();
        let reading = Reading {
            routes: ros2.routes.clone(),
            robots: settings.robots.clone(),
            shared: Arc::clone(&self.shared),
            requests: Arc::clone(&requests),
        };
        let services = ros2.services.clone();
        let ros2 = ros2.clone();
        let (thread, (sink, writers)) = Background::run("joulebus-ros2", move |thread| {
            yield_to_the_worker(NICE);
            if is_zenoh() {
                let (connection, writers) = Zenoh::open(&ros2, reading, &mut sink)?;
                thread.joined((sink, writers));
                return connection.run().map_err(anyhow::Error::from);
            }
            let (connection, writers) = Ros2::open(&ros2, reading, &mut sink)?;
            thread.joined((sink, writers));
            connection.run().map_err(anyhow::Error::from)
        })?;
        self.connections.push(thread);
        if !services.is_empty() {
            let answering = Answering {
                config: config.clone(),
                name: settings.name.clone(),
                robots: settings.robots.clone(),
                services,
                writers,
                counts: Arc::clone(&self.ros2),
                shared: Arc::clone(&self.shared),
            };
            let (thread, ()) = Background::run("joulebus-answer", move |thread| {
                yield_to_the_worker(NICE);
                thread.joined(());
                answering.run(&requests, thread);
                Ok(())
            })?;
            self.others.push(thread);
        }
        if sink.has_topics() {
            sides.push(Box::new(sink));
        }
        Ok(())
    }

    fn prepare_mqtt(
        &mut self,
        config: &Config,
        settings: &Settings,
        mqtt: &MqttSettings,
    ) -> anyhow::Result<Mqtt> {
        let offline = json!({"fleet": config.fleet(), "bridge": settings.name, "state": "offline"});
        let offline = offline.to_string().into_bytes();
        let connection = Mqtt::new(mqtt, &settings.robots, &offline, &self.shared)?;
        self.outlet = Some(connection.outlet());
        Ok(connection)
    }

    fn start_mqtt_sink(
        &mut self,
        config: &Config,
        settings: &Settings,
        (mqtt, connection): (&MqttSettings, &Mqtt),
        sides: &mut Vec<Box<dyn Sink>>,
    ) -> anyhow::Result<()> {
        if mqtt.writes.is_empty() {
            return Ok(());
        }
        let (changes, changed) = sync_channel(MAX_WAITING);
        sides.push(Box::new(MqttSink::new(Start {
            fleet: config.fleet().to_owned(),
            name: settings.name.clone(),
            robots: settings.robots.clone(),
            writes: mqtt.writes.clone(),
            outlet: connection.outlet(),
            changes: changed,
            shared: Arc::clone(&self.shared),
            lost: Arc::clone(&self.lost),
            // The second ping notices a broker that does not answer.
            arrives_within_ns: u64::try_from(3 * mqtt.keep_alive.as_nanos()).unwrap_or(u64::MAX),
        })));
        let mut whats = mqtt.writes.iter().map(|write| write.what);
        if whats.any(|what| what == What::AlarmChanges) {
            let (config, name) = (config.clone(), settings.name.clone());
            let lost = Arc::clone(&self.lost);
            let (thread, ()) = Background::repeat("joulebus-alarms", move || {
                yield_to_the_worker(NICE);
                let alarms = FleetAlarms::with_config(&config, &name)?;
                Ok((AlarmReading { alarms, to: changes, lost }, ()))
            })?;
            self.others.push(thread);
        }
        Ok(())
    }

    fn start_outbound(
        &mut self,
        config: &Config,
        settings: &Settings,
        sides: Vec<Box<dyn Sink>>,
    ) -> anyhow::Result<()> {
        if sides.is_empty() {
            return Ok(());
        }
        let times = (settings.publish_interval(), settings.writes_outlooks());
        self.others.push(outbound::start(config, &settings.name, times, sides)?);
        Ok(())
    }

    /// True if a thread has ended by itself.
    fn is_over(&self) -> bool {
        let publishing = self.publishing.as_ref();
        let mut others = self.others.iter().chain(&self.connections);
        publishing.is_some_and(Background::has_ended) || others.any(Background::has_ended)
    }

    /// Ends all threads. The connections end last, after the messages that the other threads have
    /// handed to them.
    fn finish(&mut self, config: &Config, settings: &Settings) -> anyhow::Result<BridgeReport> {
        self.publishing.iter().for_each(Background::stop);
        self.others.iter().for_each(Background::stop);
        let published = self.publishing.take().map(Background::join);
        let others = self.others.drain(..).map(Background::join);
        let mut ended: Vec<anyhow::Result<()>> = others.collect();
        self.shared.close();
        ended.extend(self.connections.drain(..).map(Background::join));
        ended.into_iter().collect::<anyhow::Result<()>>()?;
        let outlet = self.outlet.as_ref();
        // Guards in one expression would wait for each other.
        let implausible = self.shared.intake().judgement().records();
        let unmapped = self.shared.account().records();
        Ok(BridgeReport {
            fleet: config.fleet().to_owned(),
            bridge: settings.name.clone(),
            robots: settings.robots.len(),
            messages: self.shared.messages(),
            observations: self.shared.intake().observations(),
            published: published.transpose()?.unwrap_or_default(),
            written: self.ros2.sent() + outlet.map_or(0, |outlet| outlet.sent()),
            not_written: self.lost.load(Ordering::Relaxed)
                + self.ros2.lost()
                + outlet.map_or(0, |outlet| outlet.lost()),
            unmapped,
            implausible,
        })
    }
}

/// Threads that run are waited for, also where a later one could not be started.
impl Drop for Bridge {
    fn drop(&mut self) {
        self.shared.close();
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
            implausible,
        } = self;
        writeln!(
            out,
            "bridge {bridge} of fleet {fleet}, {robots} robots: {messages} messages, {observations} observations"
        )?;
        let PublishedRecord { frames, samples, samples_refused, frames_unheard, frames_failed } =
            published;
        writeln!(
            out,
            "published {samples} samples in {frames} frames, {samples_refused} refused by the worker, \
             {frames_unheard} frames without a worker, {frames_failed} not sent"
        )?;
        writeln!(out, "wrote {written} messages, {not_written} lost")?;
        for line in unmapped {
            writeln!(out, "not mapped: {line}")?;
        }
        implausible.iter().try_for_each(|one| {
            let (robot, finding, remedy) = (one.robot, &one.finding, &one.remedy);
            writeln!(out, "implausible: robot {robot}: {finding}: {remedy}")
        })
    }
}

impl fmt::Display for CheckReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { fleet, bridge, robots, broker, reads, writes, ros2 } = self;
        writeln!(out, "bridge {bridge} of fleet {fleet}: {robots} robots")?;
        if let Some(broker) = broker {
            writeln!(out, "broker {broker}: reads {}; writes {writes} topics", reads.join(", "))?;
        }
        let Some(ros2) = ros2 else {
            return Ok(());
        };
        let RosCheckReport { domain_id, zenoh, networks, reads, writes, services } = ros2;
        let networks =
            if networks.is_empty() { "all networks".to_owned() } else { networks.join(", ") };
        let networks = if *zenoh { "zenoh (RMW_IMPLEMENTATION)".to_owned() } else { networks };
        writeln!(out, "ROS domain {domain_id} on {networks}")?;
        let lists = [("reads", reads), ("writes", writes), ("serves", services)];
        let mut lines =
            lists.iter().flat_map(|(verb, all)| all.iter().map(move |topic| (verb, topic)));
        lines.try_for_each(|(verb, topic)| writeln!(out, "  {verb} {topic}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_kind_of_loss_and_none_that_is_not_one_ends_with_code_3() {
        let unheard = PublishedRecord { frames_unheard: 9, ..PublishedRecord::default() };
        let failed = PublishedRecord { frames_failed: 1, ..PublishedRecord::default() };
        let refused = PublishedRecord { samples_refused: 1, ..PublishedRecord::default() };
        for (published, not_written, unmapped, outcome) in [
            (unheard, 0, 0, Outcome::Done),
            (failed, 0, 0, Outcome::Incomplete),
            (refused, 0, 0, Outcome::Incomplete),
            (unheard, 1, 0, Outcome::Incomplete),
            (unheard, 0, 1, Outcome::Incomplete),
        ] {
            let report = BridgeReport { published, not_written, ..BridgeReport::default() };
            assert_eq!(report.outcome(unmapped), outcome, "{report:?}");
        }
    }
}
