//! Plays the messages of a capture at their due times.

use std::path::Path;

use joulebus_bus::{Domain, NoWorker, clock, set_timer_slack};
use joulebus_capture_format::{Clock, Entry, MessageKind};
use joulebus_capture_recorder::replay::{Moment, PlayedChannel, Rebase, ReplayPorts, now};
use joulebus_config::{Config, is_below};
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::{Output, log_line};
use joulebus_program::stop::Stop;
use joulebus_wire::{Flow as WireFlow, Forecasts, Sample, Samples};

use super::Args;
use super::files::Files;
use super::pace::Pace;
use super::report::PlayReport;
use super::span::SpanPosition;
use joulebus_source::flow::{Flow, SendWindow};
use joulebus_source::rate::{Passes, Rate};
use joulebus_source::window::Window;

/// Frames in flight when the source is faster than the worker's ticks.
const DEFAULT_WINDOW: usize = 4;
/// Timeout for the worker's answers to the last frames, ns.
const SETTLE_NS: u64 = 5_000_000_000;
/// Interval at which a worker is looked for, ns.
const POLL_INTERVAL_NS: u64 = 50_000_000;
/// Largest factor by which the announced period is stretched.
const MAX_STRETCH: f64 = 1e3;

pub(super) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let stop = Stop::on_signals()?;
    let files = Files::open(&args.files, args.fleet.as_deref())?;
    // Nothing is computed here, so that the attached models are not needed.
    let config = files.config(args.config.as_ref())?;
    if args.config.is_none() {
        check_root(config.root())?;
    }
    let mut player = Player::open(args, &files, &config)?;
    if player.begins(&stop)? {
        player.play(args, &files, &stop)?;
    }
    let report = player.report(&files);
    output.report(&report)?;
    Ok(Outcome::unless_lost(report.has_lost()))
}

/// Usual roots of fleets: directories in memory.
const ROOTS: [&str; 2] = ["/dev/shm", "/run"];

/// Refuses other directories: a foreign capture must not decide where directories are made.
fn check_root(root: &Path) -> Result<(), UsageError> {
    if ROOTS.iter().any(|allowed| is_below(root, Path::new(allowed))) {
        return Ok(());
    }
    let (found, allowed) = (root.display(), ROOTS.join(" and "));
    Err(UsageError(format!(
        "the config attached to the capture has domain.root {found}, allowed is what lies below {allowed}: name the \
         fleet's own config with --config"
    )))
}

struct Player {
    ports: ReplayPorts,
    /// Flow control by the worker's forecasts. Only when samples are played.
    flow: Option<Flow>,
    /// True if the sending rate is limited by the worker's answers.
    follows: bool,
    /// True to wait until a worker runs.
    waits: bool,
    kinds: Vec<MessageKind>,
    slower: f64,
    pace: Option<Pace>,
    rebase: Option<Rebase>,
    started_ns: u64,
    report: PlayReport,
}

/// The newest frame of each of the worker's services before the offset, which planners need first.
#[derive(Default)]
struct Before(Vec<Entry>);

impl Before {
    fn keep(&mut self, entry: Entry) {
        let kind = entry.message.kind();
        if kind.is_some_and(|kind| matches!(kind.flow(), WireFlow::Planners { .. })) {
            self.0.retain(|before| before.message.kind() != kind);
            self.0.push(entry);
        }
    }

    /// Forecasts last: a planner that they wake finds the others.
    fn take(&mut self) -> impl Iterator<Item = Entry> {
        let mut entries = std::mem::take(&mut self.0);
        entries.sort_by_key(|entry| entry.message.frame::<Forecasts>().is_some());
        entries.into_iter()
    }
}

impl Player {
    fn open(args: &Args, files: &Files, config: &Config) -> anyhow::Result<Self> {
        let played_as = args.name_for(&files.fleet)?;
        let played_as = if args.config.is_some() && args.remap.is_empty() {
            config.fleet().to_owned()
        } else {
            played_as
        };
        let domain = Domain::new(&played_as, config.root(), config.prefix())?;
        let (limits, kinds) = (config.limits(), args.kinds());
        let ports = ReplayPorts::open(&domain, &limits, &PlayedChannel::all(), &kinds)?;
        let follows = args.rate.is_faster_than_recorded();
        // When the replay takes the worker's place there is no other worker to follow.
        let to_worker = kinds == [MessageKind::of::<Samples>()];
        let window = Window::new(
            DEFAULT_WINDOW.min(config.buffer_frames()),
            usize::from(config.settings().intake.max_samples_per_tick),
        );
        let flow = to_worker.then(|| Flow::open(&domain, &limits, window, 0));
        Ok(Self {
            ports,
            flow: flow.transpose()?,
            follows,
            waits: !args.no_wait,
            kinds,
            slower: match args.rate {
                Rate::Times(factor) => (1.0 / factor).clamp(1.0, MAX_STRETCH),
                Rate::Max => 1.0,
            },
            pace: None,
            rebase: None,
            started_ns: clock::monotonic_ns(),
            report: PlayReport {
                files: files.name(),
                fleet: files.fleet.clone(),
                played_as,
                ..PlayReport::default()
            },
        })
    }

    /// Waits for a worker. False at a signal.
    fn begins(&mut self, stop: &Stop) -> anyhow::Result<bool> {
        if let Err(error) = set_timer_slack() {
            tracing::warn!(%error, "frames may be sent 50 µs late");
        }
        if let Some(flow) = &mut self.flow
            && self.waits
            && !wait_for_worker(flow, stop)?
        {
            return Ok(false);
        }
        self.started_ns = clock::monotonic_ns();
        Ok(true)
    }

    fn play(&mut self, args: &Args, files: &Files, stop: &Stop) -> anyhow::Result<()> {
        let passes = match args.passes.unwrap_or(Passes::Count(1)) {
            Passes::Count(count) => count,
            Passes::ForEver => u64::MAX,
        };
        let mut pace = Pace::new(args.rate, args.start_paused, args.step)?;
        while self.report.passes < passes {
            self.report.passes += 1;
            let frames = self.report.frames.values().sum::<u64>();
            pace.begin();
            let continues = self.pass(args, files, &mut pace, stop)?;
            // A capture without anything to play would loop forever.
            if !continues || self.report.frames.values().sum::<u64>() == frames {
                break;
            }
        }
        if let Some(flow) = &mut self.flow {
            flow.settle(stop, clock::monotonic_ns().saturating_add(SETTLE_NS))?;
        }
        self.ports.end();
        self.pace = Some(pace);
        Ok(())
    }

    /// Plays the capture once. False at a signal or a request to quit.
    fn pass(
        &mut self,
        args: &Args,
        files: &Files,
        pace: &mut Pace,
        stop: &Stop,
    ) -> anyhow::Result<bool> {
        let mut messages = files.read();
        let (mut first_ns, mut begin) = (None, None);
        let (mut before, mut at_ns) = (Before::default(), 0);
        for entry in messages.by_ref() {
            let first_ns = *first_ns.get_or_insert(entry.log_time_ns);
            match args.span.position(entry.log_time_ns.saturating_sub(first_ns)) {
                SpanPosition::Before => {
                    before.keep(entry);
                    continue;
                }
                SpanPosition::Inside => {}
                SpanPosition::After => break,
            }
            let kind = entry.message.kind();
            let Some(kind) = kind.filter(|kind| self.kinds.contains(kind)) else {
                continue;
            };
            let is_first = begin.is_none();
            if is_first && !self.begin(files, &entry, &mut before, pace, stop)? {
                return Ok(false);
            }
            let begin_ns = *begin.get_or_insert(entry.publish_time_ns);
            // In file order, even if a clock was set back.
            at_ns = entry.publish_time_ns.saturating_sub(begin_ns).max(at_ns);
            // The step of the first message was consumed by `begin`.
            let leads = kind == self.kinds[0] && !is_first;
            if !pace.wait(at_ns, leads, stop)? || !self.send(entry, kind, stop)? {
                return Ok(false);
            }
        }
        self.report.played_s += at_ns as f64 / 1e9;
        self.report.damages.append(&mut messages.damages);
        Ok(true)
    }

    /// Starts a pass at its first message: sets the time mapping and sends planners the last state
    /// before the offset.
    fn begin(
        &mut self,
        files: &Files,
        entry: &Entry,
        before: &mut Before,
        pace: &mut Pace,
        stop: &Stop,
    ) -> anyhow::Result<bool> {
        if let Some(flow) = &mut self.flow {
            flow.settle(stop, clock::monotonic_ns().saturating_add(SETTLE_NS))?;
        }
        if !pace.wait(0, true, stop)? {
            return Ok(false);
        }
        let recorded = recorded(files, entry);
        self.rebase = Some(match self.rebase.take() {
            None => Rebase::new(recorded, now()),
            Some(before) => before.again(recorded, now()),
        });
        for entry in before.take() {
            let kind = entry.message.kind();
            if kind.is_some_and(|kind| self.kinds.contains(&kind)) {
                self.report.frames_before += 1;
                self.deliver(entry)?;
            }
        }
        pace.begin();
        Ok(true)
    }

    /// Sends a message once the worker has capacity. False at a signal.
    fn send(&mut self, entry: Entry, kind: MessageKind, stop: &Stop) -> anyhow::Result<bool> {
        if let Some(frame) = entry.message.frame::<Samples>() {
            let rebase = self.rebase.as_ref();
            let epoch = rebase.map(|rebase| rebase.epoch(frame.header.source_epoch));
            if !self.wait_for_capacity(epoch.unwrap_or_default(), &frame.rows, stop)? {
                return Ok(false);
            }
        }
        self.ports.update();
        if self.deliver(entry)? {
            *self.report.frames.entry(kind.name()).or_default() += 1;
        }
        Ok(true)
    }

    fn wait_for_capacity(
        &mut self,
        epoch: u64,
        samples: &[Sample],
        stop: &Stop,
    ) -> anyhow::Result<bool> {
        let Some(flow) = self.flow.as_mut().filter(|_| self.follows) else {
            return Ok(true);
        };
        flow.follow(epoch);
        match flow.wait_for_capacity(samples, stop)? {
            SendWindow::Free => Ok(true),
            SendWindow::Stopped => Ok(false),
            // With --no-wait, frames sent without a worker are lost.
            SendWindow::NoWorker if !self.waits => Ok(true),
            SendWindow::NoWorker => wait_for_worker(flow, stop),
        }
    }

    /// Returns true if the message was sent.
    fn deliver(&mut self, mut entry: Entry) -> anyhow::Result<bool> {
        let Some(rebase) = &mut self.rebase else {
            return Ok(false);
        };
        if let Err(error) = self.ports.send(&mut entry.message, rebase, self.slower) {
            self.report.frames_failed += 1;
            tracing::warn!(%error, "a frame was not sent");
            return Ok(false);
        }
        if let Some(frame) = entry.message.frame::<Samples>() {
            self.report.samples += frame.rows.len() as u64;
            if let Some(flow) = self.flow.as_mut().filter(|_| self.follows) {
                flow.sent(&frame.rows);
            }
        }
        Ok(true)
    }

    fn report(mut self, files: &Files) -> PlayReport {
        let took_ns = clock::monotonic_ns().saturating_sub(self.started_ns);
        let report = &mut self.report;
        report.files = files.name();
        report.duration_s = took_ns as f64 / 1e9;
        report.held_up_s = self.pace.as_ref().map_or(0.0, Pace::held_up_s);
        report.frames_unanswered = self.flow.as_ref().map_or(0, |flow| flow.unanswered);
        self.report
    }
}

/// Waits until a worker answers. False at a signal.
fn wait_for_worker(flow: &mut Flow, stop: &Stop) -> anyhow::Result<bool> {
    let mut is_logged = false;
    let patience_ns = clock::monotonic_ns() + 10 * POLL_INTERVAL_NS;
    while !flow.has_seen_worker()? {
        if !is_logged && clock::monotonic_ns() > patience_ns {
            let no_worker = NoWorker::seen_nowhere(flow.domain());
            log_line(&format!("{no_worker}. Waiting for one"));
            is_logged = true;
        }
        if !stop.sleep_until(clock::monotonic_ns() + POLL_INTERVAL_NS) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Time at which a message was sent, on both clocks of the recording host.
fn recorded(files: &Files, entry: &Entry) -> Moment {
    let unix_ns = entry.publish_time_ns;
    let by_message = entry.message.sent_ns();
    let by_clock = files.attachments.clock();
    let monotonic_ns = by_message.or(by_clock.map(|clock: Clock| clock.monotonic_ns(unix_ns)));
    Moment { monotonic_ns: monotonic_ns.unwrap_or_default(), unix_ns }
}
