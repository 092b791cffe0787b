//! `joulebus publish trial`: plays recorded trials as a fleet.

use std::collections::{BTreeSet, HashMap};
use std::time::Duration;

use joulebus_bus::{clock, set_timer_slack};
use joulebus_config::Config;
use joulebus_dataset::trial::{Playback, Trial, TrialFleet};
use joulebus_program::config_file::ConfigFile;
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;
use joulebus_program::stop::Stop;
use joulebus_source::flow::{Flow, SendWindow};
use joulebus_source::link::{Fate, Link};
use joulebus_source::rate::{Hertz, Passes, Rate, seconds};
use joulebus_source::report::{PlayedTrial, PublishReport};
use joulebus_source::window::Window;
use joulebus_wire::Sample;

use crate::judgement::{self, AcceptArguments, limits};
use crate::trials::{TrialFiles, place_of};

/// Default number of frames in flight when the source could send faster than the worker ticks.
const USUAL_WINDOW: usize = 4;
/// Maximum time for the worker to answer the last frames, ns.
const SETTLE_NS: u64 = 5_000_000_000;
/// Minimum delay that counts as one, ns.
const LATE_NS: u64 = 50_000_000;

/// Play recorded trials as a fleet, one robot per file, then report
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus publish trial recordings/*.csv.gz\n  \
    joulebus publish trial recordings/@3 --rate max\n  \
    joulebus publish trial a.npy@3 b.npy@17 --loop=10 --rate 2\n  \
    joulebus publish trial --config configs/mixed.toml robotino/@robotino husky/@husky rover/@rover\n\n\
    A directory stands for the recordings in it, up to the number of its platform's ids. Values that a file does \
    not have (a rover without velocities) are sent as missing, never as 0. Faster than recorded, \
    the source follows the worker's forecasts and never sends more than the worker can process.")]
pub(crate) struct Args {
    #[command(flatten)]
    trials: TrialFiles,
    #[command(flatten)]
    accept: AcceptArguments,
    #[command(flatten)]
    config: ConfigFile,
    /// Speed: 1 as recorded, 2 twice as fast, max as fast as the worker answers
    #[arg(long, value_name = "FACTOR|max", default_value = "1")]
    rate: Rate,
    /// Restart each trial when it has ended: indefinitely, or N times in total
    #[arg(long = "loop", value_name = "N", num_args = 0..=1, require_equals = true, default_missing_value = "for-ever")]
    passes: Option<Passes>,
    /// Frames per second of recorded time, Hz, 0.1 to 1000 [default: the config's tick.rate_hz]
    #[arg(long, value_name = "HZ")]
    frame_rate: Option<Hertz>,
    /// Frames in flight without an answer of the worker, at most the config's intake.buffer_frames
    /// [default: 4 when faster than recorded, else no limit]
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u16).range(1..=256))]
    window: Option<u16>,
    /// Do not wait for a worker: samples sent without one are lost
    #[arg(long)]
    no_wait: bool,
    /// End after this time, s [default: at the end of the trials]
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    duration: Option<Duration>,
    /// Name of the source. A second source of the same name replaces the first [default: trial and
    /// the first robot's id]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let stop = Stop::on_signals()?;
    let config = args.config.load()?;
    let settings = config.settings();
    let trials = args.trials.read(&config)?;
    let place = |(robot, _): &(u32, Trial)| place_of(settings, *robot);
    let judged = trials.iter().map(|one| {
        let platform = place(one).map(|place| &settings.platforms[place]);
        (platform.map(limits).unwrap_or_default(), &one.1)
    });
    let places: BTreeSet<usize> = trials.iter().filter_map(place).collect();
    let accept = args.accept.or_configured(&config, places)?;
    let implausible = accept.judge_within(judged)?;
    for (robot, trial) in trials.iter().filter(|(_, trial)| !trial.notes().is_clean()) {
        tracing::info!(robot, "{}: {}", trial.path().display(), trial.notes());
    }
    let mut link = Link::open(&config, &args.source(&trials))?;
    let report = if args.starts(&mut link, &stop)? {
        let mut player = Player::new(args, &config, link, trials)?;
        player.play(args, &stop)?;
        player.report()
    } else {
        report(args, &config, &trials)
    };
    judgement::report(output, &report, implausible)?;
    Ok(Outcome::unless_lost(report.has_lost()))
}

impl Args {
    /// Name of the source.
    fn source(&self, trials: &[(u32, Trial)]) -> String {
        let first = trials.iter().map(|(robot, _)| *robot).min();
        match &self.name {
            Some(name) => name.clone(),
            None => format!("trial-{}", first.unwrap_or_default()),
        }
    }

    /// Waits for a worker, unless disabled. `false` at a signal.
    fn starts(&self, link: &mut Link, stop: &Stop) -> anyhow::Result<bool> {
        if !self.no_wait {
            return link.wait_for_worker(stop);
        }
        link.warn_without_worker()?;
        Ok(true)
    }

    /// Follows the worker if the source could be too fast for it.
    fn flow(&self, config: &Config, link: &Link) -> anyhow::Result<Option<Flow>> {
        let frames = match self.window {
            Some(frames) => usize::from(frames),
            None if self.rate.is_faster_than_recorded() => USUAL_WINDOW,
            None => return Ok(None),
        };
        let most_samples = config.settings().intake.max_samples_per_tick;
        let window = Window::new(frames.min(config.buffer_frames()), usize::from(most_samples));
        Flow::open(link.domain(), &config.limits(), window, link.epoch()).map(Some)
    }
}

struct Player {
    link: Link,
    flow: Option<Flow>,
    waits: bool,
    fleet: TrialFleet,
    frame_period_ns: u64,
    /// Number of samples to play per robot. Empty: unlimited.
    most_samples: HashMap<u32, u64>,
    frame: Vec<Sample>,
    started_ns: u64,
    /// Its trials are sorted by robot.
    report: PublishReport,
    played_samples: u64,
    played_ns: u64,
    held_up_ns: u64,
}

impl Player {
    /// Starts the trials now.
    fn new(
        args: &Args,
        config: &Config,
        link: Link,
        trials: Vec<(u32, Trial)>,
    ) -> anyhow::Result<Self> {
        let flow = args.flow(config, &link)?;
        let passes = args.passes.unwrap_or(Passes::Count(1));
        let most_samples = match passes {
            Passes::ForEver => HashMap::new(),
            Passes::Count(count) => trials
                .iter()
                .map(|(robot, trial)| (*robot, count.saturating_mul(trial.rows() as u64)))
                .collect(),
        };
        let report = report(args, config, &trials);
        let frame_period_ns = args.frame_rate.map_or(config.tick_period_ns(), Hertz::period_ns);
        let started_ns = clock::monotonic_ns();
        let playback =
            Playback { base_ns: started_ns, frame_period_ns, repeat: passes != Passes::Count(1) };
        Ok(Self {
            link,
            flow,
            waits: !args.no_wait,
            fleet: TrialFleet::new(trials, playback)?,
            frame_period_ns,
            most_samples,
            frame: Vec::new(),
            started_ns,
            report,
            played_samples: 0,
            played_ns: 0,
            held_up_ns: 0,
        })
    }

    fn play(&mut self, args: &Args, stop: &Stop) -> anyhow::Result<()> {
        if let Err(error) = set_timer_slack() {
            tracing::warn!(%error, "frames may be sent 50 µs late");
        }
        let end_ns = args.duration.map_or(u64::MAX, |duration| {
            let duration_ns = u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX);
            self.started_ns.saturating_add(duration_ns)
        });
        while let Some(due_ns) = self.fleet.next_due_ns() {
            let intended_ns = self.intended_ns(due_ns, args.rate);
            // Frames due after the end are not waited for.
            if intended_ns > end_ns {
                stop.sleep_until(end_ns);
                break;
            }
            if !stop.sleep_until(intended_ns) {
                break;
            }
            self.fleet.frame_into(due_ns, &mut self.frame);
            self.drop_what_is_past_the_end();
            if self.is_finished() {
                break;
            }
            self.played_ns = due_ns;
            if !self.send(intended_ns, stop)? {
                break;
            }
        }
        if let Some(flow) = &mut self.flow {
            flow.settle(stop, clock::monotonic_ns().saturating_add(SETTLE_NS))?;
        }
        Ok(())
    }

    /// When to send the frame. A delay shifts all later frames: catching up would be a burst that
    /// no controller sends.
    fn intended_ns(&mut self, due_ns: u64, rate: Rate) -> u64 {
        let now_ns = clock::monotonic_ns();
        let Rate::Times(factor) = rate else {
            return now_ns;
        };
        let wall_ns = |trial_ns: u64| (trial_ns as f64 / factor) as u64;
        let due_ns = self.started_ns + self.held_up_ns + wall_ns(due_ns);
        let late_ns = now_ns.saturating_sub(due_ns);
        if late_ns > LATE_NS.max(2 * wall_ns(self.frame_period_ns)) {
            self.held_up_ns += late_ns;
            return now_ns;
        }
        due_ns
    }

    /// With a number of passes the fleet continues until the longest trial has ended.
    fn drop_what_is_past_the_end(&mut self) {
        let most = &self.most_samples;
        let is_wanted =
            |sample: &Sample| most.get(&sample.robot).is_none_or(|most| sample.seq < *most);
        self.frame.retain(is_wanted);
    }

    fn is_finished(&self) -> bool {
        let most: u64 = self.most_samples.values().sum();
        self.frame.is_empty() && !self.most_samples.is_empty() && self.played_samples >= most
    }

    /// Sends the frame, in parts if it is longer than the fleet can take. `false` at a signal.
    fn send(&mut self, intended_ns: u64, stop: &Stop) -> anyhow::Result<bool> {
        let frame = std::mem::take(&mut self.frame);
        for part in frame.chunks(self.link.capacity()) {
            if !self.has_room(part, stop)? {
                return Ok(false);
            }
            let fate = self.link.send(intended_ns, part, &mut self.report)?;
            self.played_samples += part.len() as u64;
            if fate != Fate::Failed {
                self.count(part);
            }
            let Some(flow) = &mut self.flow else { continue };
            match fate {
                Fate::Sent => flow.sent(part),
                // A frame without a reader is not answered, and further ones would be lost as well.
                Fate::NoReader if self.waits && !self.link.wait_for_worker(stop)? => {
                    return Ok(false);
                }
                Fate::NoReader | Fate::Failed => {}
            }
        }
        self.frame = frame;
        Ok(true)
    }

    /// Waits until the worker has answered enough. `false` at a signal.
    fn has_room(&mut self, part: &[Sample], stop: &Stop) -> anyhow::Result<bool> {
        while let Some(flow) = &mut self.flow {
            match flow.wait_for_capacity(part, stop)? {
                SendWindow::Free => break,
                SendWindow::Stopped => return Ok(false),
                SendWindow::NoWorker if !self.waits => break,
                SendWindow::NoWorker => {
                    if !self.link.wait_for_worker(stop)? {
                        return Ok(false);
                    }
                }
            }
        }
        Ok(true)
    }

    fn count(&mut self, part: &[Sample]) {
        let trials = &mut self.report.trials;
        for sample in part {
            let place = trials.binary_search_by_key(&sample.robot, |trial| trial.robot);
            if let Ok(place) = place {
                trials[place].samples += 1;
            }
        }
    }

    fn report(mut self) -> PublishReport {
        let took_ns = clock::monotonic_ns().saturating_sub(self.started_ns);
        let report = &mut self.report;
        report.duration_s = took_ns as f64 / 1e9;
        report.held_up_s = self.held_up_ns as f64 / 1e9;
        report.speed = (took_ns > 0).then(|| self.played_ns as f64 / took_ns as f64);
        report.frames_unanswered = self.flow.as_ref().map_or(0, |flow| flow.unanswered);
        self.report
    }
}

fn report(args: &Args, config: &Config, trials: &[(u32, Trial)]) -> PublishReport {
    let mut shown: Vec<PlayedTrial> =
        trials.iter().map(|(robot, trial)| played(*robot, trial)).collect();
    shown.sort_by_key(|trial| trial.robot);
    PublishReport {
        fleet: config.fleet().to_owned(),
        source: args.source(trials),
        robots: trials.len(),
        trials: shown,
        ..PublishReport::default()
    }
}

fn played(robot: u32, trial: &Trial) -> PlayedTrial {
    PlayedTrial {
        robot,
        file: trial.path().display().to_string(),
        samples: 0,
        notes: trial.notes().to_string(),
        clean: trial.notes().is_clean(),
    }
}
