//! The thread that publishes samples at each platform's rate, independent of the rate of the
//! messages.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use joulebus_bus::{Background, Rounds, clock};
use joulebus_config::Config;
use joulebus_connect::findings::FindingsFile;
use joulebus_program::output::log_line;
use joulebus_publisher::{Grid, PublishError, Publisher, RobotState};
use serde::Serialize;

use crate::mapping::account::Reason;
use crate::mapping::robots::Robots;
use crate::shared::Shared;

/// Maximum sleep: with a simulated clock, the delay until a stop is noticed.
const POLL_INTERVAL_NS: u64 = 50_000_000;

/// Interval of logging what is implausible.
const LOG_EVERY_NS: u64 = 1_000_000_000;

/// Time after which a robot that nothing has come from is named.
const NEVER_CAME_NS: u64 = 30_000_000_000;

/// Totals of the published frames.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub(crate) struct PublishedRecord {
    pub(crate) frames: u64,
    pub(crate) samples: u64,
    /// Samples that the worker refuses for their values. The first of each robot and reason is
    /// logged.
    pub(crate) samples_refused: u64,
    /// Frames without a reading worker.
    pub(crate) frames_unheard: u64,
    /// Frames that could not be sent.
    pub(crate) frames_failed: u64,
}

/// Robots with the same rate.
struct Group {
    grid: Grid,
    robots: Vec<u32>,
}

/// State of the thread.
struct Publishing {
    robots: Robots,
    shared: Arc<Shared>,
    publisher: Publisher,
    groups: Vec<Group>,
    record: PublishedRecord,
    states: Vec<RobotState>,
    news_ns: u64,
    never_came_ns: Option<u64>,
    refused: BTreeSet<(u32, &'static str)>,
    findings: FindingsFile,
    /// Robots with a finding.
    doubted: BTreeSet<u32>,
}

/// Starts the thread, which has joined the fleet then.
///
/// # Errors
/// The fleet cannot be joined. Later: its files were removed.
pub(crate) fn start(
    config: &Config,
    name: &str,
    robots: &Robots,
    shared: &Arc<Shared>,
) -> anyhow::Result<Background<anyhow::Result<PublishedRecord>>> {
    let (config, name) = (config.clone(), name.to_owned());
    let (robots, shared) = (robots.clone(), Arc::clone(shared));
    let open = move || Ok((Publishing::open(&config, &name, robots, shared)?, ()));
    Ok(Background::repeat("joulebus-publish", open)?.0)
}

impl Publishing {
    fn open(
        config: &Config,
        name: &str,
        robots: Robots,
        shared: Arc<Shared>,
    ) -> anyhow::Result<Self> {
        let publisher = Publisher::without_judgement(config, name)?;
        let news_ns = clock::monotonic_ns();
        Ok(Self {
            publisher,
            groups: groups(config, &robots, shared.now_ns().unwrap_or_default()),
            record: PublishedRecord::default(),
            states: Vec::new(),
            news_ns,
            never_came_ns: Some(news_ns + NEVER_CAME_NS),
            refused: BTreeSet::new(),
            findings: FindingsFile::new(config, name),
            doubted: BTreeSet::new(),
            robots,
            shared,
        })
    }

    /// Logs what is new.
    fn log(&mut self, host_ns: u64) {
        if self.never_came_ns.is_some_and(|at_ns| host_ns >= at_ns) {
            self.never_came_ns = None;
            never_came(&self.robots, &self.shared);
        }
        self.shared.log_news();
        // Those of a value are logged with their frame.
        for refused in self.publisher.refusals().iter().filter(|refused| refused.found.is_none()) {
            if self.refused.insert((refused.robot, refused.reason.name())) {
                log_line(&format!("refused: {refused}"));
            }
        }
        let found = self.shared.intake().judgement().records().into_iter();
        // A monitor that never changes may be of a robot that stands.
        let found = found.filter(|found| found.finding.is_error());
        let found: Vec<_> = found.map(|found| (found.robot, found.finding.kind)).collect();
        self.doubted = found.iter().map(|(robot, _)| *robot).collect();
        match self.findings.write(found) {
            Ok(0) => {}
            Ok(cut) => tracing::warn!(cut, "too many findings: some raise no alarm"),
            Err(error) => tracing::warn!(%error, "the findings were not written"),
        }
    }
}

impl Rounds<PublishedRecord, anyhow::Error> for Publishing {
    fn round(&mut self) -> anyhow::Result<Duration> {
        let (host_ns, now_ns) = (clock::monotonic_ns(), self.shared.now_ns());
        let due_ns = self.groups.iter().map(|group| group.grid.due_ns()).min();
        let wait_ns = due_ns.zip(now_ns).map(|(due_ns, now_ns)| due_ns.saturating_sub(now_ns));
        let wait_ns = wait_ns.unwrap_or(POLL_INTERVAL_NS).min(POLL_INTERVAL_NS);
        if wait_ns > 0 && host_ns < self.news_ns {
            return Ok(self.shared.wait(Duration::from_nanos(wait_ns)));
        }
        let (states, mut late_ns) = (&mut self.states, 0);
        states.clear();
        for group in &mut self.groups {
            if let Some((slot, now_ns)) =
                now_ns.and_then(|now_ns| Some((group.grid.take(now_ns)?, now_ns)))
            {
                late_ns = late_ns.max(now_ns - slot.intended_ns);
                let mut intake = self.shared.intake();
                states
                    .extend(group.robots.iter().filter_map(|robot| intake.sample(*robot, now_ns)));
            }
        }
        if host_ns >= self.news_ns {
            self.news_ns = host_ns + LOG_EVERY_NS;
            self.log(host_ns);
        }
        if let Some(stamp_ns) = now_ns.filter(|_| !self.states.is_empty()) {
            let intended_ns = host_ns.saturating_sub(late_ns);
            let doubted = &self.doubted;
            let states = self.states.iter().copied().map(|mut state| {
                state.implausible |= doubted.contains(&state.robot);
                state
            });
            let sent = self.publisher.publish_stamped(intended_ns, stamp_ns, states);
            count(sent, &mut self.record, &mut self.refused)?;
        }
        Ok(Duration::ZERO)
    }

    fn finish(self) -> anyhow::Result<PublishedRecord> {
        Ok(self.record)
    }
}

/// Names the robots that nothing has come from: a topic is probably misspelt, or they are off.
fn never_came(robots: &Robots, shared: &Shared) {
    let silent: Vec<u32> = shared.intake().silent().collect();
    let unreported: Vec<u32> = shared.intake().unreported().collect();
    let mut account = shared.account();
    for name in silent.iter().filter_map(|robot| robots.name(*robot)) {
        account.count("[robots]", Reason::NeverCame, &format!("anything of {name}"));
    }
    for name in unreported.iter().filter_map(|robot| robots.name(*robot)) {
        let what = format!("charging of {name}, which is taken for off its charger");
        account.count("[robots]", Reason::NeverCame, &what);
    }
}

/// The robots, grouped by the rate of their platforms.
fn groups(config: &Config, robots: &Robots, now_ns: u64) -> Vec<Group> {
    let platforms = &config.settings().platforms;
    let mut by_period: BTreeMap<u64, Vec<u32>> = BTreeMap::new();
    for (robot, _) in robots.iter() {
        let is_its = |ids: &std::ops::RangeInclusive<u32>| ids.contains(&robot);
        let platform = platforms.iter().find(|platform| platform.robots.iter().any(is_its));
        // The check of the bridge's file refuses robots without a platform.
        if let Some(platform) = platform {
            by_period.entry(platform.period_ns).or_default().push(robot);
        }
    }
    let group = |(period_ns, robots)| Group { grid: Grid::new(now_ns, period_ns), robots };
    by_period.into_iter().map(group).collect()
}

/// Counts the result of a frame. A frame that the bus refuses does not end the bridge.
fn count(
    sent: Result<joulebus_publisher::Sent, PublishError>,
    record: &mut PublishedRecord,
    refused: &mut BTreeSet<(u32, &'static str)>,
) -> Result<(), PublishError> {
    match sent {
        Ok(sent) => {
            record.frames += 1;
            record.samples += sent.samples as u64;
            record.samples_refused += sent.refused as u64;
            record.frames_unheard += u64::from(sent.readers == 0);
            if let Some(first) = sent.first_refused
                && refused.insert((first.robot, first.reason.name()))
            {
                log_line(&format!("refused: {first}"));
            }
            if let Some(error) = sent.not_woken {
                tracing::warn!(%error, "the worker was not woken");
            }
        }
        Err(PublishError::Send(error)) if !error.is_final() => {
            record.frames_failed += 1;
            tracing::warn!(%error, "a frame was not sent");
        }
        Err(error) => return Err(error),
    }
    Ok(())
}
